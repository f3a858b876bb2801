// The slider of notebook 0: RMS over the trials, and |M| over frequency, for one gamma at a time.
// The notebook puts these lines below its numbers, so that they work on the pages and in JupyterLab.
for (const box of document.querySelectorAll(".gamma:empty")) {
  const data = JSON.parse(box.dataset.numbers), [wide, high, left, low] = [340, 220, 44, 36];
  const make = (name, attributes, parent, text = "") => {
    const spaces = {svg: 1, g: 1, path: 1, line: 1, text: 1};
    const node = name in spaces ? document.createElementNS("http://www.w3.org/2000/svg", name)
      : document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.textContent = text;
    return parent.appendChild(node);
  };
  // axes of one picture: returns a function that draws a curve there
  const axes = (title, label, [x0, x1], [y0, y1], xticks, yticks, log) => {
    const svg = make("svg", {viewBox: `0 0 ${wide} ${high}`, role: "img", "aria-label": title,
      style: "flex: 1 1 300px; min-width: 0; max-width: 480px", "font-size": 11}, pictures);
    const at = (log, a, b, value) => log ? Math.log(value / a) / Math.log(b / a) : (value - a) / (b - a);
    const X = x => left + (wide - left - 10) * at(log[0], x0, x1, x);
    const Y = y => high - low - (high - low - 24) * at(log[1], y0, y1, y);
    make("text", {x: left, y: 14, fill: "currentColor"}, svg, title);
    make("text", {x: wide / 2, y: high - 4, fill: "currentColor"}, svg, label);
    const line = (a, b, c, d, opacity) =>
      make("line", {x1: a, x2: b, y1: c, y2: d, stroke: "currentColor", opacity}, svg);
    for (const x of xticks) {
      line(X(x), X(x), Y(y0), Y(y1), 0.15);
      make("text", {x: X(x), y: high - low + 14, fill: "currentColor", "text-anchor": "middle"}, svg, x);
    }
    for (const y of yticks) {
      line(X(x0), X(x1), Y(y), Y(y), 0.15);
      make("text", {x: left - 4, y: Y(y) + 4, fill: "currentColor", "text-anchor": "end"}, svg, y);
    }
    const curve = make("path", {fill: "none", stroke: "#D55E00", "stroke-width": 2}, svg);
    return {line: y => line(X(x0), X(x1), Y(y), Y(y), 0.8), draw: (x, y) => curve.setAttribute("d",
      x.map((value, k) => `${k ? "L" : "M"}${X(value).toFixed(1)} ` +
        Y(Math.min(y1, Math.max(y0, y[k]))).toFixed(1)).join(""))};
  };
  const bar = make("div", {class: "trials", style: "display: flex; flex-wrap: wrap; gap: 1em"}, box);
  const pictures = make("div", {style: "display: flex; flex-wrap: wrap; gap: 1em"}, box);
  const slider = make("input", {type: "range", min: 0, max: data.gamma.length - 1, id: "gamma",
    value: data.start, style: "flex: auto; min-width: 0; max-width: 40em"}, bar);
  const label = make("label", {for: "gamma"}, bar);
  const filtered = make("input", {type: "checkbox", id: "with-Q"}, make("span", {}, bar));
  make("label", {for: "with-Q"}, filtered.parentNode, "\u00a0with Q");
  const trials = data.rms[0][0].map((_, k) => k + 1);
  const rms = axes("RMS of the error (mm)", "trial", [1, trials.length], [0.1, 100],
    [1, 5, 10, 15, 20, 30, 40, 50, 60].filter(k => k <= trials.length), [0.1, 1, 10, 100], [0, 1]);
  const M = axes("|M|: above 1 the error grows", "rad/s", [data.omega[0], data.omega.at(-1)],
    [0, 3], [1, 10, 100], [0, 1, 2, 3], [1, 0]);
  M.line(1);
  const show = () => {
    const k = Number(slider.value), gamma = data.gamma[k], q = Number(filtered.checked);
    label.textContent = `γ = ${gamma.toFixed(1)}`;
    slider.setAttribute("aria-valuetext", label.textContent);
    rms.draw(trials, data.rms[q][k]);
    M.draw(data.omega, data.re.map((re, i) =>
      Math.hypot(1 - gamma * re, gamma * data.im[i]) * (q ? data.Q[i] : 1)));
  };
  for (const input of [slider, filtered]) input.addEventListener("input", show);
  show();
}
