"""The widgets in front of the workbench: they set the knobs, and show the outcome."""

import asyncio
import warnings
from html import escape
from math import floor, log10

import ipywidgets as widgets
import numpy as np

from ilctools import arguments, save_law
from rodlib.workbench.outcome import Outcome, try_out
from rodlib.workbench.picture import Picture
from rodlib.workbench.plant import Plant, plant_of_file
from rodlib.workbench.settings import Settings

LOG = "a log"
PAUSE = 0.01  # s, in which further turns are awaited
LEFT = {"flex": "1 1 320px", "min_width": "300px", "max_width": "400px"}
RIGHT = {
    "flex": "2 1 440px",
    "min_width": "300px",
    "max_width": "800px",
    "align_items": "flex-start",
    "padding": "0 0 0 12px",
}
LOOK = {"layout": {"width": "99%"}, "style": {"description_width": "120px"}}


class Panel:
    """Knobs to the left, the picture to the right, or below where there is no room beside them.

    Its `widget` shows `outcome`, and in gray the last filter `before` that.
    """

    def __init__(self, plants: dict[str, Plant], log: str = ""):
        self.plants, self.picture = plants, Picture()
        self.outcome, self.before = Outcome(None), None
        self.plant, self.knobs = None, {}
        self.choice = _choice("plant", [*plants, LOG])
        self.file = _knob(widgets.Text, "path of the log", log)
        self.knob_box = widgets.VBox()
        self.image = widgets.Image(format="png", layout={"width": "100%"})
        self.remedy = widgets.Button(button_style="primary", layout={"width": "200px"})
        self.certificate = widgets.HTML(layout={"width": "98%"})
        self.python = widgets.HTML(layout={"width": "98%"})
        self.target = widgets.Text("law.json", description="file", layout={"width": "300px"})
        self.save = widgets.Button(description="save Q and L", layout={"width": "auto"})
        self.saved = widgets.HTML()
        self.widget = self._layout()
        self.remedy.on_click(self._apply_remedy)
        self.save.on_click(self._save)
        self.choice.observe(self._choose, "value")
        self.file.observe(self._choose, "value")
        self._choose()

    def _layout(self):
        left = widgets.VBox([self.choice, self.file, self.knob_box], layout=LEFT)
        saving = widgets.Box([self.target, self.save, self.saved], layout={"flex_flow": "row wrap"})
        right = [self.image, self.remedy, self.certificate, self.python, saving]
        return widgets.Box(
            [left, widgets.VBox(right, layout=RIGHT)], layout={"flex_flow": "row wrap"}
        )

    @property
    def settings(self) -> Settings | None:
        """The settings of the outcome; None if there is not even a plant."""
        return self.outcome.settings

    def _choose(self, change=None):
        """Another plant: begin with its choices."""
        self.file.layout.display = "" if self.choice.value == LOG else "none"
        try:
            with warnings.catch_warnings(action="ignore"):  # they are in the line
                self.plant = self._plant()
            self.knobs = knobs_of(Settings.of(self.plant))
        except (ValueError, OSError) as error:
            self.plant, self.knobs = None, {}
            self.knob_box.children = ()
            return self._show(Outcome(None, message=str(error)))
        self.knob_box.children = tuple(self.knobs.values())
        for knob in self.knobs.values():
            knob.observe(self._turn, "value")
        self.update()

    def _plant(self):
        if self.choice.value == LOG:
            return plant_of_file(self.file.value.strip())
        return self.plants[self.choice.value]

    def _turn(self, change):
        """A knob was turned: update soon, with those that are turned until then."""
        try:
            loop = asyncio.get_running_loop()
        except RuntimeError:  # outside a notebook
            self.update()
        else:
            loop.call_later(PAUSE, self.update)

    def update(self) -> None:
        """Show the outcome of the knobs' settings, unless it is shown."""
        if self.plant is None:
            return
        values = {name: _value(knob) for name, knob in self.knobs.items()}
        band = values.pop("low"), values.pop("high")
        settings = Settings(self.plant, band=band, **values)
        if settings != self.settings:
            self._show(try_out(settings))

    def _show(self, outcome):
        if self.outcome.design is not None:
            self.before = self.outcome
        self.outcome = outcome
        feasible, remedy = outcome.design is not None, outcome.M_max is not None
        self.remedy.layout.display = "" if remedy else "none"
        if remedy:
            self.remedy.description = f"set M_max to {outcome.M_max:.3f}"
        self.save.disabled, self.saved.value = not feasible, ""
        self.certificate.value = _as_html("certificate", outcome.text)
        python = outcome.settings.python if feasible else ""
        self.python.value = _as_html("python", python, "user-select: all")
        # Last: the lines beside a new picture are those that belong to it.
        self.image.value = self.picture.show(outcome, self.before).png()

    def _apply_remedy(self, button):
        self.knobs["M_max"].value = self.outcome.M_max

    def _save(self, button):
        """Save the law of the outcome, and say where it is, or why it is not."""
        try:
            path = arguments.path("file", self.target.value.strip())
            save_law(path, self.outcome.law, self.settings.python)
            self.saved.value = f"saved: {escape(str(path.absolute()))}"
        except (ValueError, OSError) as error:
            self.saved.value = f"not saved: {escape(str(error))}"


def _as_html(name, text, style=""):
    """A text as it stands; with `user-select: all` one click marks all."""
    style = f"white-space: pre-wrap; line-height: 1.3; {style}"
    return f'<pre class="workbench-{name}" style="{style}">{escape(text)}</pre>'


def knobs_of(settings: Settings) -> dict[str, widgets.DOMWidget]:
    """The knobs by name, at the settings and with ranges for their plant."""
    plant, (low, high) = settings.plant, settings.band
    orders, largest = max(20, 2 * settings.order), np.abs(plant.reference).max()
    noise = f"noise ({plant.unit})" if plant.unit else "noise"
    return {
        "M_max": _slider("M_max", settings.M_max, 0.05, 0.999, 0.001),
        "L_max": _log_slider("L_max", settings.L_max),
        "cutoff": _log_slider("cut-off (rad/s)", settings.cutoff),
        "Q_order": _knob(widgets.IntSlider, "order of Q", settings.Q_order, min=1, max=6),
        "order": _knob(widgets.IntSlider, "order of L", settings.order, min=1, max=orders),
        "structure": _choice("structure", ["full", "diagonal"], settings.structure),
        "low": _knob(widgets.FloatText, "band from (rad/s)", low),
        "high": _knob(widgets.FloatText, "band to (rad/s)", high),
        "uncertainty": _slider("uncertainty (%)", settings.uncertainty, 0, 20, 0.5, plant.measured),
        "noise": _slider(noise, settings.noise, 0, largest, largest / 100),
    }


def _slider(name, value, low, high, step, disabled=False):
    options = {"min": low, "max": high, "step": step, "disabled": disabled}
    return _knob(widgets.FloatSlider, name, value, readout_format=".3g", **options)


def _log_slider(name, value):
    """From a tenth of the value's decade to a hundred times."""
    low = floor(log10(value)) - 1
    options = {"min": low, "max": low + 3, "step": 0.02, "readout_format": ".3g"}
    return _knob(widgets.FloatLogSlider, name, value, **options)


def _choice(name, options, value=None):
    first = options[0] if value is None else value
    return widgets.Dropdown(options=options, value=first, description=name, **LOOK)


def _knob(kind, name, value, **options):
    """A widget that changes when the slider is let go, or the number confirmed."""
    return kind(value=value, description=name, continuous_update=False, **LOOK, **options)


def _value(knob):
    """The value of a knob; that of a slider in three digits, as it is shown."""
    if isinstance(knob, widgets.FloatSlider | widgets.FloatLogSlider):
        return float(f"{knob.value:.3g}")
    return knob.value
