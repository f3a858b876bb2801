"""A rig and its controller: ours, or the rig's; sample by sample."""

import numpy as np

from ilctools import arguments
from ilctools.errors import RigError, StoppedError
from ilctools.law.law import Law
from ilctools.law.limits import UNLIMITED, named_limits
from ilctools.loop.closed import CurrentTrialLoop, Loop, controller
from ilctools.rigs.interrupts import SAFE_TIME, Interrupts
from ilctools.rigs.limits import stop_limits
from ilctools.rigs.protocol import Rig
from ilctools.trials.learn import disturbances_of, joined

STILL = 0.1  # of a trial, for which outputs that are back must stand still
LONGEST = 2.0  # trials, that is waited for this


class Controller:
    """Observer and state feedback of a loop, sample by sample, as on hardware.

    u = N w - K_s x-hat - delta, with the estimates x-hat of the states and delta of the disturbance
    at the input, (16) and (18) of the paper, see :func:`current_trial_loop`.

    `command` and `observe` take loops side by side, too, by signals of shape (..., m).

    Parameters
    ----------
    loop : CurrentTrialLoop
    decimals : int, optional
        To which commands are rounded. Default: not at all.

    See Also
    --------
    record : what runs it
    current_trial_loop : its gains

    Examples
    --------
    >>> import control
    >>> A, B = [[1, 0.01], [0, 1]], [[0], [0.01]]  # a mass of 1 kg, F in N, x in m
    >>> stage = control.ss(A, B, [[1, 0]], 0, 0.01, inputs=["F"], outputs=["x"])
    >>> from ilctools import Controller, current_trial_loop
    >>> loop = current_trial_loop(stage, ["F"])
    >>> bool(Controller(loop).step(y=[0.0], w=[1.0]) == loop.N)
    True
    """

    def __init__(self, loop: CurrentTrialLoop, decimals: int | None = None):
        arguments.instance("loop", loop, CurrentTrialLoop)
        if decimals is not None:
            arguments.whole("decimals", decimals, 0, 300)
        self.loop, self.decimals = loop, decimals
        self._A, B, self._K = controller(loop)
        self._B = np.hstack([B, loop.KL])
        self._state, self._m = np.zeros(len(B)), len(loop.outputs)

    @property
    def delta(self) -> np.ndarray:
        """The estimate of the input disturbance."""
        return self._state[..., -self._m :]

    def step(self, y, w) -> np.ndarray:
        """The controls u(p) from the measured y(p) and w(p); advances the observer."""
        y = arguments.array("y", y, (self._m,))
        w = arguments.array("w", w, (self._m,))
        u = self.command(w)
        self.observe(y, u)
        return u

    def command(self, w) -> np.ndarray:
        """The controls u(p), from w(p) and what is estimated."""
        u = w @ self.loop.N.T - self._state @ self._K.T  # (18)
        return _rounded(u, self.decimals)

    def observe(self, y, applied) -> None:
        """Advance the observer by the measured y(p) and the controls that were applied."""
        inputs = np.concatenate([applied, y], axis=-1)
        self._state = self._state @ self._A.T + inputs @ self._B.T  # (16)


class ControlledRig:
    """A rig under its loop, by its methods read and apply: names, limits, decimals.

    Parameters
    ----------
    rig : Rig
    loop : CurrentTrialLoop or ClosedLoop
        The controller is ours, which sends u, or the rig's, which takes w.
    reference : ndarray, shape (trial, time, output)
        Of all trials, from which limits of `stop` follow.
    law : Law, optional
        Bound to the loop. Without limits (None), it takes those of the rig.
    stop, decimals : dict, optional
        As for :func:`ilctools.record`.
    goes_on : bool
        Whether a trial starts where the last one ended.
    """

    def __init__(
        self,
        rig,
        loop: Loop,
        reference,
        law: Law | None = None,
        stop: dict | None = None,
        decimals: dict[str, int] | None = None,
        goes_on: bool = False,
    ):
        if isinstance(arguments.instance("rig", rig, Rig), type):
            raise ValueError(f"rig = {rig.__name__} is a class: make one, as by {rig.__name__}()")
        self.rig, self.loop, self.goes_on = rig, loop, goes_on
        self.ours = isinstance(loop, CurrentTrialLoop)
        self.outputs, self.commands = loop.outputs, loop.commands  # once, not in every sample
        self.of_outputs = f"reading of {', '.join(self.outputs)}"  # as errors call it
        self.find_signals()
        self.Ts = arguments.sampling_period("rig.Ts", getattr(rig, "Ts", loop.Ts))
        self.decimals = arguments.by_name("decimals", decimals, ["v", "u", "delta", "disturbance"])
        for name, value in self.decimals.items():
            arguments.whole(f"decimals[{name!r}]", value, 0, 300)
        limits = named_limits("rig.limits", getattr(rig, "limits", None), self.inputs)
        self.limits = {name: limits[name] for name in self.commands if name in limits}
        if law is not None:
            law = law.on_rig(self.limits)
        self.law, self.actuators = law, law and law.actuators
        self.stop = stop_limits(stop, reference, loop, self.limits)
        self.size = reference.shape[:2]  # trials, samples
        self.clock, self.bring_back, self.leave_safe = (
            getattr(rig, name, None) for name in ("clock", "begin", "safe")
        )
        safe_time = arguments.positive("rig.safe_time", getattr(rig, "safe_time", SAFE_TIME))
        self.interrupts = Interrupts(self.make_safe, safe_time)
        self.late = []  # by how much each sample of the trial is off the rig's clock, s
        self.place = ""  # trial and sample, for errors
        self.reset()

    def find_signals(self) -> None:
        """Which signals are sent, measured and recorded beside commands and outputs."""
        loop, measured = self.loop, getattr(self.rig, "measured", {})
        self.inputs = list(getattr(self.rig, "inputs", self.commands))
        if missing := [name for name in self.commands if name not in self.inputs]:
            raise ValueError(f"rig.inputs = {self.inputs} must name the commands {missing}")
        self.reported = [] if self.ours else loop.controls  # u, by the rig
        if missing := [name for name in self.reported if name not in measured]:
            raise ValueError(f"rig.measured must have the controls {missing} of the loop")
        # disturbances of the loop that are inputs, and those that are known
        names = loop.disturbances
        self.disturbed = [name for name in names if name in self.inputs]
        self.recorded = [name for name in names if name in self.inputs or name in measured]
        # what is measured, and as what it is recorded
        self.signal_of = dict.fromkeys(set(self.recorded) - set(self.disturbed), "disturbance")
        self.signal_of |= dict.fromkeys(self.reported, "u")
        self.positions = [self.inputs.index(name) for name in self.commands + self.disturbed]

    def reset(self) -> None:
        """Forget what was before."""
        self.controller = Controller(self.loop, self.decimals.get("u")) if self.ours else None
        self.due = None  # when the next sample is due, by the rig's clock

    def rounded(self, name, values) -> np.ndarray:
        """A signal with as many digits as are recorded."""
        return _rounded(values, self.decimals.get(name))

    def commanded(self, disturbance) -> np.ndarray:
        """The commands to the disturbances that are inputs, shape (trial, time, them)."""
        names = self.loop.disturbances
        d = disturbances_of(self.loop, disturbance, *self.size)
        nonzero = [name for i, name in enumerate(names) if d[..., i].any()]
        if unknown := [name for name in nonzero if name not in self.recorded]:
            raise ValueError(f"disturbance is not zero for {unknown}, which are not rig.inputs")
        return d[..., [names.index(name) for name in self.disturbed]]

    def begin(self, trial) -> None:
        """Bring the rig to where trials begin, if it can."""
        self.place = f"trial {trial}"
        if self.bring_back:
            self.interrupts.call(self.bring_back, trial)
            self.reset()

    def pause(self, trial, samples, w, start) -> str:
        """Hold w before a trial for so many samples; None: until the rig stands at its start.

        Returns what there is to be warned of.
        """
        flows, length, still = np.zeros(len(self.disturbed)), self.size[1], 0
        longest = round(LONGEST * length) if samples is None else samples
        for p in range(longest):
            self.place = f"pause before trial {trial}, sample {p + 1}"
            y = self.sample(w, flows)["y"]
            still = still + 1 if start.near(y, w) else 0
            if samples is None and still >= STILL * length:
                return ""
        text = f"before trial {trial} the outputs were not back and still after {longest} samples"
        return text if samples is None else ""

    def run(self, trial, w, commanded, bar, first=0) -> dict[str, np.ndarray]:
        """Run one trial, from its sample `first` on; its signals but v, shape (time, channel)."""
        self.place = f"trial {trial}"
        if not self.goes_on:
            self.due = None
        if not first:
            self.late = []
        samples = []
        for p in range(len(w)):
            self.place = f"trial {trial}, sample {first + p + 1}"
            self.interrupts.call(self.check_clock)
            samples.append(self.sample(w[p], commanded[p]))
            bar.update()
        return joined(samples, np.array)

    def check_clock(self) -> None:
        """Note by how much a sample is off the clock of the rig, if it has one."""
        if self.clock:
            now = float(self.reading("clock", self.clock(), ()))
            due = now if self.due is None else self.due
            self.late.append(abs(now - due))
            self.due = due + self.Ts

    def sample(self, w, flows) -> dict[str, np.ndarray]:
        """Let one sampling period pass: read, check, then apply what the controller makes of it."""
        y, measured = self.interrupts.call(self.read)
        self.check_stop(self.outputs, y)
        signals, commands = {"y": y}, w
        if self.controller:
            signals["delta"] = self.rounded("delta", self.controller.delta)
            signals["u"] = commands = self.controller.command(w)
        elif self.reported:
            signals["u"] = np.array([measured[name] for name in self.reported])
        self.check_stop(self.commands, commands)
        if self.actuators is not None:
            commands = self.actuators.follow(commands)
            if self.controller:
                signals["applied"] = commands
        if self.controller:
            self.controller.observe(y, commands)
        inputs = np.zeros(len(self.inputs))
        inputs[self.positions] = np.concatenate([commands, flows])
        self.interrupts.call(self.rig.apply, inputs)
        if self.recorded:
            measured |= dict(zip(self.disturbed, flows, strict=True))
            signals["disturbance"] = np.array([measured[name] for name in self.recorded])
        return signals

    def read(self) -> tuple[np.ndarray, dict[str, float]]:
        """The outputs, and what else is measured; nothing is used before it is checked."""
        y, measured = self.rig.read(), self.rig.measured if self.signal_of else {}
        values = {
            name: self.rounded(signal, float(self.reading(name, measured.get(name), ())))
            for name, signal in self.signal_of.items()
        }
        return self.reading(self.of_outputs, y, (len(self.outputs),)), values

    def reading(self, name, values, shape) -> np.ndarray:
        """What the driver gave, as an array; a RigError that says when, if it is none.

        For one output a number is enough, as :meth:`.Law.next` takes signals (time,) for it.
        """
        try:
            if shape == (1,) and np.ndim(values) == 0:
                values = [values]
            return arguments.array(name, values, shape)
        except ValueError as error:
            raise RigError(f"{self.place}: {error}") from None

    def check_stop(self, names, values) -> None:
        """Stop at what is beyond the limits of `stop`."""
        for name, value in zip(names, values.tolist(), strict=True):
            low, high = self.stop.get(name, UNLIMITED)
            if not low <= value <= high:
                what = f"{name} = {value:.6g} is not from {low:.6g} to {high:.6g}"
                raise StoppedError(
                    f"{what}, the limits of stop: if units, signs and wires are right, learn less, "
                    "by a smaller gain or a lower cut-off, in another log; or go on with wider "
                    "ones. In trial 1 without v it is the reference that leads there"
                )

    def make_safe(self) -> None:
        """Leave the rig in a safe state; an error there says so."""
        try:
            if self.leave_safe:
                self.leave_safe()
            else:
                self.rig.apply(np.zeros(len(self.inputs)))
        except BaseException as error:  # also a signal, after safe_time
            error.add_note("THE RIG MAY NOT BE SAFE: what should leave it safe has failed")
            raise


def _rounded(values, decimals):
    if decimals is None:
        return values
    # numpy rounds some decimals up that are just below a half
    rounds = round if isinstance(values, float) else np.round
    return rounds(values, decimals)
