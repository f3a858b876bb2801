"""The widgets in front of the workbench: they set the knobs, and show what comes of it."""

import asyncio
import os
import warnings
from contextlib import contextmanager
from html import escape
from math import floor, log10

import ipywidgets as widgets
import numpy as np

from rodlib.ilc.laboratory import load_law, save_law
from rodlib.ilc.laboratory.notes import notes_of_law
from rodlib.ilc.workbench.outcome import Outcome, try_out
from rodlib.ilc.workbench.picture import Picture
from rodlib.ilc.workbench.plants import Family, Plant, plant_of_file
from rodlib.ilc.workbench.settings import Settings

FILE = "a log"
PAUSE = 0.01  # s; changes that follow each other faster are one


class Panel:
    """Knobs to the left, the picture to the right, or below where there is no room beside them.

    Attributes
    ----------
    widget : ipywidgets.Widget
    outcome : Outcome
        What is shown.
    before : Outcome or None
        The filter before that, in gray.
    designs : int
        How many outcomes have been computed.
    """

    def __init__(self, plants: dict[str, Plant | Family], log: str = ""):
        self.plants, self.picture = plants, Picture()
        self.outcome, self.before, self.designs = Outcome(None), None, 0
        self._made = (None, None)  # the plant that was made last, and of what
        self._due, self._quiet = None, False
        self.choice, self.file, self.knobs = _knobs([*plants, FILE], log)
        families = {name: plant for name, plant in plants.items() if isinstance(plant, Family)}
        self.parameters = {name: _parameters(family) for name, family in families.items()}
        self.image = widgets.Image(format="png", layout={"width": "100%"})
        self.line, self.python = (widgets.HTML(layout={"width": "98%"}) for _ in range(2))
        self.remedy = widgets.Button(button_style="primary", layout={"width": "200px"})
        self.target = widgets.Text("law.json", description="file", layout={"width": "300px"})
        self.save = widgets.Button(description="save Q and L", layout={"width": "auto"})
        self.saved = widgets.HTML()
        self.widget = self._laid_out()
        self.remedy.on_click(lambda button: self._set(M_max=self.outcome.M_max))
        self.save.on_click(self._save)
        self.choice.observe(self._begin, "value")
        own = [knob for knobs in self.parameters.values() for knob in knobs.values()]
        for knob in (self.file, *own, *self.knobs.values()):
            knob.observe(self._changed, "value")
        self._begin()

    def _laid_out(self):
        self.families = {
            name: widgets.Accordion(
                [widgets.VBox([*knobs.values()])], titles=[f"parameters of {name}"]
            )
            for name, knobs in self.parameters.items()
        }
        left = widgets.VBox(
            [self.choice, self.file, *self.knobs.values(), *self.families.values()],
            layout={"flex": "1 1 320px", "min_width": "300px", "max_width": "400px"},
        )
        saving = [self.target, self.save, self.saved]
        right = widgets.VBox(
            [
                self.image, self.remedy, self.line, self.python,
                widgets.Box(saving, layout={"flex_flow": "row wrap"}),
            ],
            layout={
                "flex": "2 1 440px", "min_width": "300px", "max_width": "800px",
                "align_items": "flex-start", "padding": "0 0 0 12px",
            },
        )  # fmt: skip
        return widgets.Box([left, right], layout={"flex_flow": "row wrap"})

    @property
    def settings(self) -> Settings | None:
        """What is shown was made of these; None if there was not even a plant."""
        return self.outcome.settings

    def _plant(self):
        """The plant of the knobs, made anew only if they say another one."""
        name = self.choice.value
        if isinstance(self.plants.get(name), Plant):
            return self.plants[name]
        if name == FILE:
            path = os.path.expanduser(self.file.value.strip())
            of = (path, os.path.exists(path) and os.path.getmtime(path))
        else:
            of = (
                name,
                {parameter: knob.value for parameter, knob in self.parameters[name].items()},
            )
        if of != self._made[0]:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # a measurement's findings are in its certificate
                made = plant_of_file(of[0]) if name == FILE else self.plants[name].make(**of[1])
                self._made = (of, made)
        return self._made[1]

    def _begin(self, change=None):
        """Another plant: begin with the paper's choices, carried over to it."""
        self.file.layout.display = "" if self.choice.value == FILE else "none"
        for name, accordion in self.families.items():
            accordion.layout.display = "" if self.choice.value == name else "none"
        try:
            settings = Settings.of(self._plant())
        except (ValueError, OSError) as error:
            return self._show(Outcome(None, message=str(error)))
        with self._quietly():
            self._fit_ranges(settings)
        self.update()

    def _fit_ranges(self, settings):
        """Set all knobs, and what they can be set to, for a plant."""
        knobs, plant = self.knobs, settings.plant
        gain, cutoff = log10(settings.L_max), log10(settings.cutoff)
        _set_range(knobs["L_max"], floor(gain) - 1, floor(gain) + 2, settings.L_max)
        _set_range(knobs["cutoff"], floor(cutoff) - 1, floor(cutoff) + 2, settings.cutoff)
        _set_range(knobs["order"], 1, max(20, 2 * settings.order), settings.order)
        most = float(f"{np.abs(plant.reference).max():.1g}")
        knobs["noise"].step = most / 100
        _set_range(knobs["noise"], 0, most, 0)
        unit = " and ".join(sorted({plant.loop.units[name] for name in plant.loop.outputs} - {""}))
        knobs["noise"].description = f"noise ({unit})" if unit else "noise"
        knobs["uncertainty"].disabled = plant.measured
        (low, high), choices = settings.band, {"M_max": 0.9, "Q_order": 2, "uncertainty": 0}
        for name, value in {"low": low, "high": high, "structure": "diagonal", **choices}.items():
            knobs[name].value = value

    def _said(self):
        """What the knobs say, rounded to what they show."""
        say = {name: knob.value for name, knob in self.knobs.items()}
        for name in ("L_max", "cutoff", "noise", "uncertainty"):
            say[name] = float(f"{say[name]:.3g}")
        say["M_max"] = round(say["M_max"], 3)
        return Settings(self._plant(), band=(say.pop("low"), say.pop("high")), **say)

    @contextmanager
    def _quietly(self):
        self._quiet = True
        try:
            yield
        finally:
            self._quiet = False

    def _changed(self, change):
        """A knob was turned: update soon, unless another one follows; the newest setting counts."""
        if self._quiet:
            return
        if self._due is not None:
            self._due.cancel()
        try:
            self._due = asyncio.get_running_loop().call_later(PAUSE, self.update)
        except RuntimeError:  # nobody who would call later
            self.update()

    def update(self) -> None:
        """Show what the knobs say, unless that is what is shown."""
        try:
            settings = self._said()
        except (ValueError, OSError) as error:
            return self._show(Outcome(None, message=str(error)))
        if settings != self.settings:
            self.designs += 1
            self._show(try_out(settings))

    def _show(self, outcome):
        if self.outcome.design is not None:
            self.before = self.outcome
        self.outcome = outcome
        picture = self.picture.show(outcome, self.before).png()
        self.remedy.layout.display = "none" if outcome.M_max is None else ""
        if outcome.M_max is not None:
            self.remedy.description = f"set M_max to {outcome.M_max:.3f}"
        found = outcome.design is not None
        self.save.disabled, self.saved.value = not found, ""
        self.line.value = f"<b>Certificate:</b> {escape(outcome.line)}" if found else ""
        look = "user-select: all; white-space: pre-wrap; line-height: 1.3"  # one click marks all
        code = escape(outcome.settings.python) if found else ""
        self.python.value = f'<pre class="workbench-python" style="{look}">{code}</pre>'
        # last: who sees the new picture reads what belongs to it
        self.image.value = picture

    def _set(self, **values):
        for name, value in values.items():
            self.knobs[name].value = value

    def _save(self, button):
        """Save the filters that are shown, read them again, and say where they are, or why not."""
        settings, path = self.settings, self.target.value
        law = settings.Q, self.outcome.design.filter
        try:
            save_law(path, *law, settings.python)
            if notes_of_law(*load_law(path)) != notes_of_law(*law):
                raise ValueError(f"{path} holds another law than was written to it: try again")
            self.saved.value = f"saved: {escape(os.path.abspath(path))}"
        except (ValueError, OSError) as error:
            self.saved.value = f"not saved: {escape(str(error))}"


def _parameters(family):
    """The widgets of a family's parameters, by name."""
    look = {"layout": {"width": "95%"}, "style": {"description_width": "170px"}}
    return {
        name: widgets.FloatText(
            value, description=f"{name} ({unit})" if unit else name, continuous_update=False, **look
        )
        for name, (value, unit) in family.parameters.items()
    }


def _knobs(plants, log):
    """The widgets to choose a plant and a file with, and those of the design by name."""
    common = {"layout": {"width": "99%"}, "style": {"description_width": "120px"}}
    lazy = common | {"continuous_update": False}
    choice = widgets.Dropdown(options=plants, description="plant", **common)
    file = widgets.Text(
        log, description="path of the log", placeholder="from shake or record", **lazy
    )
    three = {"readout_format": ".3g", "step": 0.02} | lazy
    return choice, file, {
        "M_max": widgets.FloatSlider(
            0.9, min=0.05, max=0.999, step=0.001, readout_format=".3f", description="M_max", **lazy
        ),
        "L_max": widgets.FloatLogSlider(50, description="L_max", **three),
        "cutoff": widgets.FloatLogSlider(
            0.1, min=-2, max=1, description="cut-off (rad/s)", **three
        ),
        "Q_order": widgets.IntSlider(2, min=1, max=6, description="order of Q", **lazy),
        "order": widgets.IntSlider(10, min=1, max=20, description="order of L", **lazy),
        "structure": widgets.Dropdown(
            options=["diagonal", "full"], description="structure", **common
        ),
        "low": widgets.FloatText(1e-4, description="band from (rad/s)", **lazy),
        "high": widgets.FloatText(0.02, description="band to (rad/s)", **lazy),
        "uncertainty": widgets.FloatSlider(
            0, min=0, max=20, step=0.5, readout_format=".1f", description="uncertainty (%)", **lazy
        ),
        "noise": widgets.FloatSlider(0, min=0, max=10, description="noise", **three),
    }  # fmt: skip


def _set_range(slider, low, high, value):
    """Widen, set, narrow: at no time is the value out of range."""
    slider.min, slider.max = min(slider.min, low), max(slider.max, high)
    slider.value = value
    slider.min, slider.max = low, high
