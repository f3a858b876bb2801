"""A rig under its controller, sample by sample: read, check, command, limit, observe, apply."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ilctools import arguments
from ilctools.errors import RigError, StoppedError
from ilctools.law.limits import UNLIMITED
from ilctools.rigs.controller import Controller
from ilctools.rigs.description import RigDescription
from ilctools.rigs.interrupts import Interrupts
from ilctools.trials.learn import Part, joined
from ilctools.trials.start import Start

STANDSTILL = 0.1  # of a trial, for which outputs that are back must stand still
LONGEST_PAUSE = 2.0  # trials, that is waited for this


class Reading(NamedTuple):
    """What a rig gave in a sample, checked."""

    y: np.ndarray
    measured: dict[str, float]  # what else, by name


@dataclass
class RigState:
    """What changes from sample to sample."""

    controller: Controller | None  # ours; None if the rig has its own
    due: float | None = None  # when the next sample is due, by the rig's clock; None: when it comes
    late: list[float] = field(default_factory=list)  # by how much each sample is not on time, s
    place: str = ""  # trial and sample, as errors say it


class ControlledRig:
    """A rig that runs: what is known of it, its state, and the signals that interrupt it."""

    def __init__(self, about: RigDescription):
        self.about = about
        self.state = RigState(self.new_controller())
        self.interrupts = Interrupts(self.make_safe, about.methods.safe_time)

    def new_controller(self) -> Controller | None:
        """A controller that knows nothing of what was before."""
        about = self.about
        return Controller(about.loop, about.decimals.get("u")) if about.controller_is_ours else None

    def begin(self, trial: int) -> None:
        """Bring the rig to where trials begin, if it can; the controller then starts afresh."""
        self.state.place = f"trial {trial}"
        if self.about.methods.begin:
            self.interrupts.call(self.about.methods.begin, trial)
            self.state.controller, self.state.due = self.new_controller(), None

    def pause(self, trial: int, samples: int | None, w, start: Start) -> str:
        """Hold w before a trial for so many samples; None: until the rig stands at its start.

        Returns what there is to be warned of.
        """
        flows, length, still = np.zeros(len(self.about.signals.commanded)), self.about.samples, 0
        longest = round(LONGEST_PAUSE * length) if samples is None else samples
        for p in range(longest):
            self.state.place = f"pause before trial {trial}, sample {p + 1}"
            y = self.sample(w, flows)["y"]
            still = still + 1 if start.near(y, w) else 0
            if samples is None and still >= STANDSTILL * length:
                return ""
        text = f"before trial {trial} the outputs were not back and still after {longest} samples"
        return text if samples is None else ""

    def drive(self, trial: int, w, flows, bar, first: int = 0) -> Part:
        """Drive the rig by w (time, channel) in a trial, from its sample `first` on.

        Returns the signals of these samples but v and the reference, shape (time, channel).
        """
        self.state.place = f"trial {trial}"
        if not self.about.goes_on:
            self.state.due = None
        if not first:
            self.state.late = []
        samples = []
        for p in range(len(w)):
            self.state.place = f"trial {trial}, sample {first + p + 1}"
            self.interrupts.call(self.check_clock)
            samples.append(self.sample(w[p], flows[p]))
            bar.update()
        return joined(samples, np.array)

    def check_clock(self) -> None:
        """Note by how much a sample is not on time by the clock of the rig, if it has one."""
        state, clock = self.state, self.about.methods.clock
        if clock:
            now = float(self.reading("clock", clock(), ()))
            due = now if state.due is None else state.due
            state.late.append(abs(now - due))
            state.due = due + self.about.Ts

    def sample(self, w, flows) -> Part:
        """Let one sampling period pass; its signals but v and the reference."""
        signals = self.about.signals
        reading = self.interrupts.call(self.read)
        self.check_stop(signals.outputs, reading.y)
        delta, asked = self.command(w)
        self.check_stop(signals.commands, asked)
        applied = self.limit(asked)
        self.observe(reading.y, applied)
        self.apply(applied, flows)
        return self.signals_of(reading, delta, asked, applied, flows)

    def read(self) -> Reading:
        """The outputs, and what else is measured; nothing is used before it is checked."""
        signals, driver = self.about.signals, self.about.driver
        y, measured = driver.read(), driver.measured if signals.measured_as else {}
        values = {
            name: self.about.rounded(signal, float(self.reading(name, measured.get(name), ())))
            for name, signal in signals.measured_as.items()
        }
        return Reading(self.reading(signals.of_outputs, y, (len(signals.outputs),)), values)

    def reading(self, name: str, values, shape: tuple) -> np.ndarray:
        """What the driver gave, as an array; a RigError that says when, if it is none.

        For one output a number is enough, as :meth:`.Law.next` takes signals (time,) for it.
        """
        try:
            if shape == (1,) and np.ndim(values) == 0:
                values = [values]
            return arguments.array(name, values, shape)
        except ValueError as error:
            raise RigError(f"{self.state.place}: {error}") from None

    def check_stop(self, names: list[str], values: np.ndarray) -> None:
        """Stop at what is beyond the limits of `stop`."""
        for name, value in zip(names, values.tolist(), strict=True):
            low, high = self.about.stop.get(name, UNLIMITED)
            if not low <= value <= high:
                what = f"{name} = {value:.6g} is not from {low:.6g} to {high:.6g}"
                raise StoppedError(
                    f"{what}, the limits of stop: if units, signs and wires are right, learn less, "
                    "by a smaller gain or a lower cut-off, in another log; or go on with wider "
                    "ones. In trial 1 without v it is the reference that leads there"
                )

    def command(self, w) -> tuple[np.ndarray | None, np.ndarray]:
        """The estimate delta of the disturbance, and what is asked for: u by (18), or w itself.

        A rig that has a controller of its own is asked for w; there is no delta then.
        """
        controller = self.state.controller
        if controller is None:
            return None, w
        return self.about.rounded("delta", controller.delta), controller.command(w)

    def limit(self, asked) -> np.ndarray:
        """What actuators make of the commands asked for, if the law has limits."""
        actuators = self.about.actuators
        return asked if actuators is None else actuators.follow(asked)

    def observe(self, y, applied) -> None:
        """Inform our observer (16) of the outputs and of what is applied."""
        if self.state.controller is not None:
            self.state.controller.observe(y, applied)

    def apply(self, applied, flows) -> None:
        """Send the commands and the commanded disturbances; inputs that are neither are zero."""
        inputs = np.zeros(len(self.about.signals.inputs))
        inputs[self.about.signals.places] = np.concatenate([applied, flows])
        self.interrupts.call(self.about.driver.apply, inputs)

    def signals_of(self, reading: Reading, delta, asked, applied, flows) -> Part:
        """The signals of a sample, as far as there are some."""
        names, ours = self.about.signals, self.about.controller_is_ours
        known = reading.measured | dict(zip(names.commanded, flows, strict=True))
        reported = _values(known, names.controls)  # by a rig that has its own controller
        signals = {
            "y": reading.y,
            "delta": delta,
            "u": asked if ours else reported,
            "applied": applied if ours and self.about.actuators is not None else None,
            "disturbance": _values(known, names.disturbances),
        }
        return {name: values for name, values in signals.items() if values is not None}

    def make_safe(self) -> None:
        """Leave the rig in a safe state; an error there says so."""
        try:
            if self.about.methods.safe:
                self.about.methods.safe()
            else:
                self.about.driver.apply(np.zeros(len(self.about.signals.inputs)))
        except BaseException as error:  # also a signal, after safe_time
            error.add_note("THE RIG MAY NOT BE SAFE: what should leave it safe has failed")
            raise


def _values(known: dict[str, float], names: list[str]) -> np.ndarray | None:
    """The values of these names; None if there are no names."""
    return np.array([known[name] for name in names]) if names else None
