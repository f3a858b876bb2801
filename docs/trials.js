// A slider below Fig. 9, through its trials: frames that `make pages` writes (docs/conf.py).
addEventListener("DOMContentLoaded", () => {
  const figure = document.querySelector('img[alt^="ILC signal, control, output and error"]');
  if (!figure) return;
  const whole = figure.src, root = document.documentElement.dataset.content_root;
  const frames = Array.from({length: 10}, (_, k) => `${root}_static/fig09-trial-${k + 1}.png`);
  const slider = Object.assign(document.createElement("input"),
    {type: "range", id: "trial", min: 0, max: frames.length, value: 0});
  const label = Object.assign(document.createElement("label"), {htmlFor: "trial"});
  const show = () => {
    const k = Number(slider.value);
    figure.src = k ? frames[k - 1] : whole;
    label.textContent = k ? `trial ${k}` : "all trials";
    slider.setAttribute("aria-valuetext", label.textContent);
  };
  slider.addEventListener("input", show);
  slider.addEventListener("pointerenter", () => {  // so that the first move does not flicker
    for (const frame of frames) new Image().src = frame;
  }, {once: true});
  const bar = Object.assign(document.createElement("div"), {className: "trials"});
  bar.append(slider, label);
  (figure.closest("a") ?? figure).after(bar);  // within the link, a click on the slider follows it
  show();
});
