"""The widgets in front of the workbench: they set the knobs, and show what comes of it."""

import asyncio
import os
import warnings
from html import escape
from math import floor, log10

import ipywidgets as widgets
import numpy as np

from rodlib.ilc import load_law, save_law
from rodlib.ilc.law.io import law_notes
from rodlib.ilc.workbench.outcome import Outcome, try_out
from rodlib.ilc.workbench.picture import Picture
from rodlib.ilc.workbench.plants import Family, Plant, plant_of_file
from rodlib.ilc.workbench.settings import Settings

FILE = "a log or a table"
PAUSE = 0.01  # s; changes that follow each other faster are one


class Panel:
    """Knobs to the left, the picture to the right, or below where there is no room beside them.

    Its `widget` shows `outcome`, in gray the last filter `before` that; `designs` counts them.
    """

    def __init__(self, plants: dict[str, Plant | Family], log: str = ""):
        self.plants, self.picture = plants, Picture()
        self.outcome, self.before, self.designs = Outcome(None), None, 0
        self._plant, self._due, self._quiet = None, None, False
        self.choice, self.file, self.columns, self.knobs = _knobs([*plants, FILE], log)
        families = {
            name: plant for name, plant in plants.items() if isinstance(plant, Family)
        }
        self.parameters = {
            name: _parameters(family) for name, family in families.items()
        }
        self.image = widgets.Image(format="png", layout={"width": "100%"})
        self.line, self.python = (
            widgets.HTML(layout={"width": "98%"}) for _ in range(2)
        )
        self.remedy = widgets.Button(button_style="primary", layout={"width": "200px"})
        self.target = widgets.Text(
            "law.json", description="file", layout={"width": "300px"}
        )
        self.save = widgets.Button(description="save Q and L", layout={"width": "auto"})
        self.saved = widgets.HTML()
        self.widget = self._laid_out()
        self.remedy.on_click(self._remedy)
        self.save.on_click(self._save)
        for knob in (self.choice, self.file, self.columns):
            knob.observe(self._begin, "value")
        for knob in [
            knob for knobs in self.parameters.values() for knob in knobs.values()
        ]:
            knob.observe(self._another, "value")
        for knob in self.knobs.values():
            knob.observe(self._changed, "value")
        self._begin()

    def _laid_out(self):
        """All widgets in their places; `shown_with` has those that one plant alone needs."""
        self.shown_with = {
            name: widgets.Accordion(
                [widgets.VBox([*knobs.values()])], titles=[f"parameters of {name}"]
            )
            for name, knobs in self.parameters.items()
        } | {FILE: widgets.VBox([self.file, self.columns])}
        *families, file = self.shown_with.values()
        left = widgets.VBox(
            [self.choice, file, *self.knobs.values(), *families],
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

    @property
    def plant(self) -> Plant:
        """The plant that is chosen, made anew only after its own widgets have said another one."""
        if self._plant is None:
            with warnings.catch_warnings(
                action="ignore"
            ):  # they are in a measurement's findings
                self._plant = self._made(self.choice.value)
        return self._plant

    def _made(self, name):
        if name == FILE:
            path = os.path.expanduser(self.file.value.strip())
            return plant_of_file(path, self.columns.value)
        if name in self.parameters:
            values = {word: knob.value for word, knob in self.parameters[name].items()}
            return self.plants[name].make(**values)
        return self.plants[name]

    def _begin(self, change=None):
        """Another plant is chosen: begin with the paper's choices, carried over to it."""
        for name, widget in self.shown_with.items():
            widget.layout.display = "" if self.choice.value == name else "none"
        self._plant = None
        try:
            settings = Settings.of(self.plant)
        except (ValueError, OSError) as error:
            return self._show(Outcome(None, message=str(error)))
        self._quiet = True
        try:
            self._fit(settings)
        finally:
            self._quiet = False
        self.update()

    def _another(self, change):
        """The same kind of plant, with another parameter: the knobs stay."""
        self._plant = None
        self._changed(change)

    def _fit(self, settings):
        """Set all knobs, and what they can be set to, for the plant of the settings."""
        knobs, plant = self.knobs, settings.plant
        for name in ("L_max", "cutoff"):
            decade = floor(log10(getattr(settings, name)))
            _set_range(knobs[name], decade - 1, decade + 2, getattr(settings, name))
        _set_range(knobs["order"], 1, max(20, 2 * settings.order), settings.order)
        most = float(f"{np.abs(plant.reference).max():.1g}")
        knobs["noise"].step = most / 100
        _set_range(knobs["noise"], 0, most, settings.noise)
        knobs["noise"].description = f"noise ({plant.unit})" if plant.unit else "noise"
        knobs["uncertainty"].disabled = plant.measured
        knobs["low"].value, knobs["high"].value = settings.band
        for name in ("M_max", "Q_order", "structure", "uncertainty"):
            knobs[name].value = getattr(settings, name)

    def _said(self):
        """What the knobs say, rounded to what they show."""
        say = {name: knob.value for name, knob in self.knobs.items()}
        for name in ("L_max", "cutoff", "noise", "uncertainty"):
            say[name] = float(f"{say[name]:.3g}")
        say["M_max"] = round(say["M_max"], 3)
        return Settings(self.plant, band=(say.pop("low"), say.pop("high")), **say)

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

    def _remedy(self, button):
        self.knobs["M_max"].value = self.outcome.M_max

    def _save(self, button):
        """Save the filters that are shown, read them again, and say where they are, or why not."""
        settings, path = self.settings, self.target.value
        law = self.outcome.design.law(settings.plant.rest)
        try:
            save_law(path, law, settings.python)
            if law_notes(load_law(path)) != law_notes(law):
                raise ValueError(
                    f"{path} holds another law than was written to it: try again"
                )
            self.saved.value = f"saved: {escape(os.path.abspath(path))}"
        except (ValueError, OSError) as error:
            self.saved.value = f"not saved: {escape(str(error))}"


def _parameters(family):
    """The widgets of a family's parameters, by name."""
    look = {"layout": {"width": "95%"}, "style": {"description_width": "170px"}}
    return {
        name: widgets.FloatText(
            value,
            description=f"{name} ({unit})" if unit else name,
            continuous_update=False,
            **look,
        )
        for name, (value, unit) in family.parameters.items()
    }


def _knobs(plants, log):
    """The widgets to choose a plant, a file and its columns with; those of the design by name."""
    common = {"layout": {"width": "99%"}, "style": {"description_width": "120px"}}
    lazy = common | {"continuous_update": False}
    choice = widgets.Dropdown(options=plants, description="plant", **common)
    file = widgets.Text(
        log,
        description="path of the file",
        placeholder="from shake, record or others",
        **lazy,
    )
    columns = widgets.Text(
        description="its columns",
        placeholder='of a table: time="t", inputs={"Q1": "Heater 1"}, outputs={"T1": 3}',
        **lazy,
    )
    three = {"readout_format": ".3g", "step": 0.02} | lazy
    return choice, file, columns, {
        "M_max": widgets.FloatSlider(
            min=0.05, max=0.999, step=0.001, readout_format=".3f", description="M_max", **lazy
        ),
        "L_max": widgets.FloatLogSlider(description="L_max", **three),
        "cutoff": widgets.FloatLogSlider(description="cut-off (rad/s)", **three),
        "Q_order": widgets.IntSlider(min=1, max=6, description="order of Q", **lazy),
        "order": widgets.IntSlider(description="order of L", **lazy),
        "structure": widgets.Dropdown(
            options=["diagonal", "full"], description="structure", **common
        ),
        "low": widgets.FloatText(description="band from (rad/s)", **lazy),
        "high": widgets.FloatText(description="band to (rad/s)", **lazy),
        "uncertainty": widgets.FloatSlider(
            min=0, max=20, step=0.5, readout_format=".1f", description="uncertainty (%)", **lazy
        ),
        "noise": widgets.FloatSlider(description="noise", **three),
    }  # fmt: skip


def _set_range(slider, low, high, value):
    """Widen, set, narrow: at no time is the value out of range."""
    slider.min, slider.max = min(slider.min, low), max(slider.max, high)
    slider.value = value
    slider.min, slider.max = low, high
