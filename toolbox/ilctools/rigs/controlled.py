"""Run a rig under its controller, sample by sample: read, check, command, limit, observe, apply."""

import numpy as np

from ilctools import arguments
from ilctools.errors import RigError, StoppedError
from ilctools.law.limits import UNLIMITED
from ilctools.loop.closed import CurrentTrialLoop
from ilctools.rigs.controller import Controller
from ilctools.rigs.description import RigDescription
from ilctools.rigs.interrupts import Interrupts
from ilctools.trials.learn import Part, joined
from ilctools.trials.start import Start

STANDSTILL = 0.1  # fraction of a trial for which outputs must stand still to end a pause
LONGEST_PAUSE = 2.0  # longest pause, in lengths of a trial


class ControlledRig:
    """A running rig: its description, its state, and the signals that interrupt it."""

    def __init__(self, about: RigDescription):
        self.about = about
        self.interrupts = Interrupts(self.make_safe, about.safe_time)
        self.controller = self.new_controller()
        self.due: float | None = None  # clock time of the next sample; None: any time
        self.late: list[float] = []  # by how much each sample of a trial is early or late, s
        self.pause_warning = ""  # of the last pause
        self.place = ""  # trial and sample, as errors state them

    def new_controller(self) -> Controller | None:
        """Make a controller in its initial state; return None if the rig has its own controller."""
        about = self.about
        ours = isinstance(about.loop, CurrentTrialLoop)
        return Controller(about.loop, about.decimals.get("u")) if ours else None

    def begin(self, trial: int) -> None:
        """If the rig can do so, bring it to where trials begin; then reset the controller."""
        self.place = f"trial {trial}"
        if self.about.begin:
            self.interrupts.call(self.about.begin, trial)
            self.controller = self.new_controller()

    def pause(self, trial: int, samples: int | None, reference, start: Start) -> str:
        """Hold a reference before a trial for `samples` samples.

        If `samples` is None, the pause ends when the outputs stand still at the start. Returns the
        text of a warning, or "".
        """
        flows, length, still = np.zeros(len(self.about.signals.commanded)), self.about.samples, 0
        longest = round(LONGEST_PAUSE * length) if samples is None else samples
        loop = self.about.loop
        w = loop.w(reference, np.zeros(len(loop.learned)))
        for p in range(longest):
            self.place = f"pause before trial {trial}, sample {p + 1}"
            y = self.sample(w, flows)["y"]
            still = still + 1 if start.near(y, reference) else 0
            if samples is None and still >= STANDSTILL * length:
                return ""
        text = (
            f"before trial {trial} the outputs had not returned and settled after {longest} samples"
        )
        return text if samples is None else ""

    def drive(self, trial: int, w, flows, bar, first: int = 0) -> Part:
        """Drive the rig by w (time, channel) in a trial, from sample `first` of the trial on.

        Returns the signals of these samples, except v and the reference, shape (time, channel).
        """
        if not first:
            self.late = []
        if not self.about.goes_on:
            self.due = None
        samples = []
        for p in range(len(w)):
            self.place = f"trial {trial}, sample {first + p + 1}"
            self.interrupts.call(self.check_clock)
            samples.append(self.sample(w[p], flows[p]))
            bar.update()
        return joined(samples, np.array)

    def check_clock(self) -> None:
        """If the rig has a clock, note by how much a sample is early or late."""
        if self.about.clock:
            now = float(self.reading("clock", self.about.clock(), ()))
            due = now if self.due is None else self.due
            self.late.append(abs(now - due))
            self.due = due + self.about.Ts

    def sample(self, w, flows) -> Part:
        """Run one sampling period; return its signals, except v and the reference."""
        about, controller = self.about, self.controller
        signals = self.interrupts.call(self.read, flows)
        self.check_stop(about.outputs, signals["y"])
        if controller:
            signals["delta"] = about.rounded("delta", controller.delta)
            signals["u"] = applied = controller.command(w)  # (18)
        else:
            applied = w
        self.check_stop(about.signals.commands, applied)
        if about.actuators:
            applied = about.actuators.follow(applied)
        if controller:
            controller.observe(signals["y"], applied)  # (16)
            if about.actuators:
                signals["applied"] = applied
        self.apply(applied, flows)
        return signals

    def read(self, flows) -> Part:
        """Read and check y, the known disturbances, and u if the rig has its own controller."""
        names, driver = self.about.signals, self.about.driver
        y, measured = driver.read(), driver.measured if names.measured_as else {}
        outputs = self.about.outputs
        part = {"y": self.reading(f"reading of {', '.join(outputs)}", y, (len(outputs),))}
        known = dict(zip(names.commanded, flows, strict=True))
        for name, signal in names.measured_as.items():
            value = float(self.reading(name, measured.get(name), ()))
            known[name] = self.about.rounded(signal, value)
        for signal, listed in (("u", names.controls), ("disturbance", names.disturbances)):
            if listed:
                part[signal] = np.array([known[name] for name in listed])
        return part

    def reading(self, name: str, values, shape: tuple) -> np.ndarray:
        """Return the driver's values as an array.

        If the values are not valid, a RigError is raised.

        For one output a number is enough, as :meth:`.Law.next` takes signals (time,) for one
        output.
        """
        try:
            if shape == (1,) and np.ndim(values) == 0:
                values = [values]
            return arguments.array(name, values, shape)
        except ValueError as error:
            raise RigError(f"{self.place}: {error}") from None

    def check_stop(self, names: list[str], values: np.ndarray) -> None:
        """Stop the experiment if a value is beyond the limits of `stop`."""
        for name, value in zip(names, values.tolist(), strict=True):
            low, high = self.about.stop.get(name, UNLIMITED)
            if not low <= value <= high:
                what = f"{name} = {value:.6g} is not from {low:.6g} to {high:.6g}"
                raise StoppedError(
                    f"{what}, the limits of stop. If units, signs and wires are right, learn "
                    "less, by a smaller gain or a lower cut-off, in a new log; or continue "
                    "with wider limits. In trial 1 without v, the reference alone leads there"
                )

    def apply(self, applied, flows) -> None:
        """Send the commands and the commanded disturbances; set all other inputs to zero."""
        inputs = np.zeros(len(self.about.signals.inputs))
        inputs[self.about.signals.places] = np.concatenate([applied, flows])
        self.interrupts.call(self.about.driver.apply, inputs)

    def make_safe(self) -> None:
        """Leave the rig in a safe state.

        If this fails, the error says that the rig may be unsafe.
        """
        try:
            if self.about.safe:
                self.about.safe()
            else:
                self.about.driver.apply(np.zeros(len(self.about.signals.inputs)))
        except BaseException as error:  # also a signal, after safe_time
            error.add_note("THE RIG MAY NOT BE SAFE: the call that should leave it safe has failed")
            raise
