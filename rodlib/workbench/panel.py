"""The widgets in front of the workbench: they set the knobs, and show the outcome."""

import asyncio
from html import escape
from math import floor, isnan, log10

import ipywidgets as widgets
import numpy as np

from ilctools import arguments, save_law
from rodlib.workbench.outcome import try_out
from rodlib.workbench.picture import png
from rodlib.workbench.plant import Plant
from rodlib.workbench.settings import Settings

PAUSE = 0.01  # s, in which further turns are awaited
LEFT = {"flex": "1 1 320px", "min_width": "300px", "max_width": "400px"}
RIGHT = {"flex": "2 1 440px", "min_width": "300px", "max_width": "800px"}
RIGHT |= {"align_items": "flex-start", "padding": "0 0 0 12px"}
LOOK = {"layout": {"flex": "1 1 auto"}, "style": {"description_width": "120px"}}
FOCUS = "<style>.noUi-handle:focus {outline: 2px solid #0072B2; outline-offset: 1px}</style>"


class Panel:
    """Knobs to the left, the picture to the right, or below where there is no room beside them.

    Its `widget` shows `outcome`, of the `settings` of the knobs.
    """

    def __init__(self, plant: Plant):
        self.plant, self.outcome = plant, None
        self.knobs = knobs_of(Settings.of(plant))
        self.image = widgets.Image(format="png", layout={"width": "100%"})
        self.certificate = widgets.HTML(layout={"width": "98%"})
        self.python = widgets.HTML(layout={"width": "98%"})
        self.target = widgets.Text("law.json", description="file", layout={"width": "300px"})
        self.save = widgets.Button(description="save Q and L", layout={"width": "auto"})
        self.saved, self.misread = widgets.HTML(), widgets.HTML()
        row = {"flex_flow": "row wrap"}
        saving = widgets.Box([self.target, self.save, self.saved], layout=row)
        rows = [self._row(knob) for knob in self.knobs.values()]
        left = widgets.VBox([*rows, self.misread, widgets.HTML(FOCUS)], layout=LEFT)
        right = widgets.VBox([self.image, self.certificate, self.python, saving], layout=RIGHT)
        self.widget = widgets.Box([left, right], layout=row)
        self.save.on_click(self._save)
        for knob in self.knobs.values():
            knob.observe(self._turn, "value")
        self.update()

    @property
    def settings(self) -> Settings:
        """The settings of the outcome."""
        return self.outcome.settings

    def _row(self, knob):
        """A knob, and beside a slider its number, to type: a comma is a point."""
        if isinstance(knob, widgets.Dropdown):
            return widgets.HBox([knob])
        number = widgets.Text(continuous_update=False, layout={"width": "72px"})
        kind = type(knob.value)

        def show(change=None):
            number.value = f"{_value(knob):.3g}"

        def read(change):
            if number.value == f"{_value(knob):.3g}":
                return
            self.misread.value, typed = "", number.value
            try:
                value = kind(typed.strip().replace(",", "."))
                if isnan(value):
                    raise ValueError(typed)
                knob.value = value
            except ValueError:
                what = "number" if kind is float else "whole number"
                self.misread.value = f"{knob.description}: {escape(repr(typed))} is no {what}"
            show()

        show()
        knob.observe(show, "value")
        number.observe(read, "value")
        return widgets.HBox([knob, number])

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
        values = {name: _value(knob) for name, knob in self.knobs.items()}
        band = values.pop("low"), values.pop("high")
        settings = Settings(self.plant, band=band, **values)
        if self.outcome is not None and settings == self.settings:
            return
        self.outcome = try_out(settings)
        feasible = self.outcome.design is not None
        self.save.disabled, self.saved.value = not feasible, ""
        self.certificate.value = _as_html("certificate", self.outcome.text)
        python = settings.python if feasible else ""
        self.python.value = _as_html("python", python, "user-select: all")
        self.image.layout.display = None if feasible else "none"  # the text says why
        # Last: the lines beside a new picture are those that belong to it.
        self.image.value = png(self.outcome)

    def _save(self, button):
        """Save the law of the outcome, and say where it is, or why it is not."""
        try:
            path = arguments.path("file", self.target.value.strip())
            law = self.outcome.design.law(rest=self.plant.rest)
            save_law(path, law, self.settings.python)
            self.saved.value = f"saved: {escape(str(path.absolute()))}"
        except (ValueError, OSError) as error:
            self.saved.value = f"not saved: {escape(str(error))}"


def _as_html(name, text, style=""):
    """A text as it stands; with `user-select: all` one click marks all."""
    style = f"white-space: pre-wrap; word-break: normal; line-height: 1.3; {style}"
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
        "structure": widgets.Dropdown(
            options=["full", "diagonal"], value=settings.structure, description="structure", **LOOK
        ),
        "low": _log_slider("band from (rad/s)", low, 5),
        "high": _log_slider("band to (rad/s)", high),
        "uncertainty": _slider("uncertainty (%)", settings.uncertainty, 0, 20, 0.5),
        "noise": _slider(noise, settings.noise, 0, largest, largest / 100),
    }


def _slider(name, value, low, high, step):
    return _knob(widgets.FloatSlider, name, value, min=low, max=high, step=step)


def _log_slider(name, value, decades=3):
    """From a tenth of the value's decade upwards."""
    low = floor(log10(value)) - 1
    return _knob(widgets.FloatLogSlider, name, value, min=low, max=low + decades, step=0.02)


def _knob(kind, name, value, **options):
    """A slider whose value changes when it is let go."""
    options |= LOOK | {"readout": False, "continuous_update": False}
    return kind(value=value, description=name, **options)


def _value(knob):
    """The value of a knob; that of a slider in three digits, as it is shown."""
    if isinstance(knob, widgets.FloatSlider | widgets.FloatLogSlider):
        return float(f"{knob.value:.3g}")
    return knob.value
