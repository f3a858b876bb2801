"""A rig and its controller: ours, sample by sample; the rig's; or a rig that runs whole trials."""

import math
import reprlib
import warnings
from contextlib import contextmanager

import numpy as np

from ilctools import arguments
from ilctools.law.limits import named_limits
from ilctools.loop.closed import CurrentTrialLoop, Loop
from ilctools.rigs.protocol import RigError, StoppedError

NOT_APPLIED = ". Nothing was applied after it"
UNLIMITED = (-math.inf, math.inf)


class Controller:
    """Observer (16) and state feedback (18), sample by sample as on hardware.

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
        A, B, C = loop.plant.A, loop.plant.B, loop.plant.C
        m, n = C.shape
        # (16), (18) for the state (x-hat, delta), each as one product
        extended = np.block([[A, B[:, :m]], [np.zeros((m, n)), np.eye(m)]])
        self._A = extended - np.pad(loop.KL @ C, [(0, 0), (0, m)])
        self._B = np.hstack([np.pad(B[:, :m], [(0, m), (0, 0)]), loop.KL])
        self._K = np.hstack([loop.Ks, np.eye(m)])
        self._state, self._m = np.zeros(n + m), m

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
    """What the three kinds have in common: names, limits, decimals, a safe end."""

    disturbed: tuple[str, ...] = ()  # disturbances of the loop that are inputs
    recorded: tuple[str, ...] = ()  # disturbances of the loop that are known
    waits = True  # whether the rig can be held before a trial

    def __init__(self, rig, loop: Loop, decimals):
        self.rig, self.loop = rig, loop
        # looked up once, not in every sample
        self.outputs, self.commands = loop.outputs, loop.commands
        # the controller: it sends u, not w
        self.ours = isinstance(loop, CurrentTrialLoop)
        names = ["v", "u", "delta", "disturbance"]
        self.decimals = arguments.by_name("decimals", decimals, names)
        for name, value in self.decimals.items():
            arguments.whole(f"decimals[{name!r}]", value, 0, 300)
        self.inputs = list(getattr(rig, "inputs", self.commands))
        missing = [name for name in self.commands if name not in self.inputs]
        if missing:
            raise ValueError(f"rig.inputs = {self.inputs} must name the commands {missing}")
        limits = getattr(rig, "limits", None)
        limits = named_limits("rig.limits", limits, self.inputs, slew=True)
        self.limits = {name: limits[name] for name in self.commands if name in limits}
        self.Ts = arguments.sampling_period("rig.Ts", getattr(rig, "Ts", loop.Ts))
        self.actuators = None  # of a law with limits
        self.goes_on = False  # whether a trial starts where the last one ended
        self.late = []  # by how much each sample of the trial is off the rig's clock, s
        self.stop = {}  # limits of outputs and commands, by name

    def rounded(self, name, values) -> np.ndarray:
        """A signal with as many digits as are recorded."""
        return _rounded(values, self.decimals.get(name))

    def commanded(self, disturbance, trials, samples) -> np.ndarray:
        """The commands to the disturbances that are inputs, shape (trial, time, them)."""
        names = self.loop.disturbances
        d = np.zeros((samples, len(names))) if disturbance is None else disturbance
        d = arguments.each_trial("disturbance", d, trials, samples, names)
        nonzero = [name for i, name in enumerate(names) if d[..., i].any()]
        unknown = [name for name in nonzero if name not in self.recorded]
        if unknown:
            raise ValueError(f"disturbance is not zero for {unknown}, which are not rig.inputs")
        return d[..., [names.index(name) for name in self.disturbed]]

    def begin(self, trial) -> None:
        """Bring the rig to where trials begin, if it can."""
        if hasattr(self.rig, "begin"):
            self.rig.begin(trial)
            self.reset()

    def reset(self) -> None:
        """Forget what was before."""

    def check_stop(self, names, values) -> None:
        """Stop at what is beyond the limits of `stop`."""
        if not self.stop:
            return
        for name, value in zip(names, values.tolist(), strict=True):
            low, high = self.stop.get(name, UNLIMITED)
            if not low <= value <= high:
                what = f"{name} = {value:.6g} is not from {low:.6g} to {high:.6g}"
                raise StoppedError(f"{what}, the limits of stop")

    def beyond(self, names, values) -> np.ndarray:
        """Which samples of a signal (time, channel) are beyond the limits of `stop`."""
        low, high = np.array([self.stop.get(name, UNLIMITED) for name in names]).T
        return np.any((values < low) | (values > high), axis=1)

    @contextmanager
    def safe_in_the_end(self):
        """Leave the rig in a safe state on every way out."""
        try:
            yield
        finally:
            if hasattr(self.rig, "safe"):
                self.rig.safe()
            elif hasattr(self.rig, "apply"):
                self.rig.apply(np.zeros(len(self.inputs)))


class SampledRig(ControlledRig):
    """A rig of two methods, read and apply, whose controller is its own: it takes w."""

    def __init__(self, rig, loop, decimals):
        super().__init__(rig, loop, decimals)
        measured = getattr(rig, "measured", {})
        self.reported = [] if self.ours else loop.controls  # u, by the rig
        missing = [name for name in self.reported if name not in measured]
        if missing:
            raise ValueError(f"rig.measured must have the controls {missing} of the loop")
        names = loop.disturbances
        self.disturbed = [name for name in names if name in self.inputs]
        self.recorded = [n for n in names if n in self.disturbed or n in measured]
        self.measured = [n for n in self.recorded if n not in self.disturbed]
        self.also = self.measured + self.reported
        commands = self.commands + self.disturbed
        self.positions = np.array([self.inputs.index(name) for name in commands])
        self.reset()

    def reset(self):
        self.applied = None  # the last commands
        self.due = None  # when the next sample is due, by the rig's clock

    def pause(self, trial, samples, w, start) -> None:
        """Hold w before a trial for so many samples; None: until all is back and still."""
        flows, y = np.zeros(len(self.disturbed)), []
        where = f"pause before trial {trial}"
        with _located(where, lambda: len(y) + 1, NOT_APPLIED):
            for p in range(start.longest if samples is None else samples):
                y.append(self.sample(w, flows)["y"])
                asked = samples is None and p % max(1, start.window // 10) == 0
                if asked and start.back(y, w):
                    return
        if samples is None:
            warnings.warn(
                f"before trial {trial} the outputs were not back and still after {len(y)} samples",
                stacklevel=6,
            )

    def run(self, trial, w, commanded, bar, first=0) -> dict[str, np.ndarray]:
        """Run one trial, from its sample `first` on; its signals but v, shape (time, channel)."""
        clock = getattr(self.rig, "clock", None)
        if not self.goes_on:
            self.due = None
        if not first:
            self.late = []
        samples = []
        with _located(f"trial {trial}", lambda: first + len(samples) + 1, NOT_APPLIED):
            for p in range(len(w)):
                if clock:
                    now = clock()
                    due = now if self.due is None else self.due
                    self.late.append(abs(now - due))
                    self.due = due + self.Ts
                samples.append(self.sample(w[p], commanded[p]))
                bar.update()
        return {name: np.array([s[name] for s in samples]) for name in samples[0]}

    def sample(self, w, flows) -> dict[str, np.ndarray]:
        """Let one sampling period pass: read, check, then apply what the controller makes of it."""
        y, measured = self.read()
        self.check_stop(self.outputs, y)
        signals = self.control(y, w, measured)
        sent = np.concatenate([self.applied, flows]) if self.disturbed else self.applied
        inputs = np.zeros(len(self.inputs))
        inputs[self.positions] = sent
        self.rig.apply(inputs)
        if self.recorded:
            measured |= dict(zip(self.disturbed, flows, strict=True))
            disturbance = [measured[name] for name in self.recorded]
            signals["disturbance"] = np.array(disturbance)
        signals["y"] = y
        return signals

    def control(self, y, w, measured) -> dict[str, np.ndarray]:
        """Set `applied`, the commands of this sample; the signals that this makes."""
        self.send(w)
        u = [self.rounded("u", measured[name]) for name in self.reported]
        return {"u": np.array(u)} if u else {}

    def send(self, commands) -> None:
        """Set `applied`: the commands of a sample, cut off at the limits of the law."""
        self.check_stop(self.commands, commands)
        if self.actuators is not None:
            commands = self.actuators.next(commands, self.applied)
        self.applied = commands

    def read(self) -> tuple[np.ndarray, dict[str, float]]:
        """The outputs, and what else is measured; nothing is used before it is checked."""
        y, measured = self.rig.read(), self.rig.measured if self.also else {}
        y = _reading("reading", y, (len(self.outputs),))
        values = {n: float(_reading(n, measured.get(n), ())) for n in self.also}
        for name in self.measured:
            values[name] = self.rounded("disturbance", values[name])
        return y, values


class ControllerOnRig(SampledRig):
    """A rig of two methods, with our controller."""

    def reset(self):
        super().reset()
        self.controller = Controller(self.loop, self.decimals.get("u"))

    def control(self, y, w, measured):
        controller = self.controller
        signals = {"delta": self.rounded("delta", controller.delta)}
        signals["u"] = controller.command(w)
        self.send(signals["u"])
        controller.observe(y, self.applied)
        if self.actuators is not None:
            signals["applied"] = self.applied
        return signals


class WholeTrialRig(ControlledRig):
    """A rig that runs whole trials by itself, whoever's the controller is."""

    waits = False

    def run(self, trial, w, commanded, bar) -> dict[str, np.ndarray]:
        """Upload w, let the trial run, download and check it."""
        names, actuators, signals = self.loop.controls, self.actuators, {}
        cut_off = actuators is not None and not self.ours
        with _located(f"trial {trial}"):
            result = self.rig.run(actuators.follow(w) if cut_off else w.copy())
            pair = names and isinstance(result, tuple) and len(result) == 2
            y, u = result if pair else (result, None)
            signals["y"] = _reading("y", y, w.shape)
            if names:
                signals["u"] = self.rounded("u", _reading("u", u, w.shape))
        checked = [(self.outputs, signals["y"])]
        if self.ours:
            checked.append((self.commands, signals["u"]))
        p = 0
        with _located(f"trial {trial}", lambda: p + 1):
            for p in np.flatnonzero(np.any([self.beyond(*c) for c in checked], axis=0)):
                for names, values in checked:
                    self.check_stop(names, values[p])
        if actuators is not None and self.ours:
            signals["applied"] = actuators.follow(signals["u"])
        bar.update(len(w))
        return signals


def controlled(rig, loop: Loop, decimals) -> ControlledRig:
    """A rig with the controller of its loop, of one of the three kinds."""
    if isinstance(rig, type):
        raise ValueError(f"rig = {rig!r} is a class: make one")
    arguments.instance("loop", loop, Loop)
    methods = {name for name in ("read", "apply", "run") if callable(getattr(rig, name, None))}
    if {"read", "apply"} <= methods:
        kind = ControllerOnRig if isinstance(loop, CurrentTrialLoop) else SampledRig
    elif "run" in methods:
        kind = WholeTrialRig
    else:
        raise ValueError(f"rig = {reprlib.repr(rig)} has no methods read and apply: see Rig")
    return kind(rig, loop, decimals)


def _reading(name, values, shape):
    """A reading as an array; a RigError if it is none."""
    try:
        return arguments.array(name, values, shape)
    except ValueError as error:
        raise RigError(str(error)) from None


@contextmanager
def _located(where, sample=None, more=""):
    """Say in an error where it arose; `sample` gives the number of the sample."""
    try:
        yield
    except Exception as error:
        if sample is not None:
            where = f"{where}, sample {sample()}"
        if not isinstance(error, RigError):
            error.add_note(f"in {where}")
            raise
        raise type(error)(f"{where}: {error}{more}") from None


def _rounded(values, decimals):
    if decimals is None:
        return values
    # numpy rounds some decimals up that are just below a half
    rounds = round if isinstance(values, float) else np.round
    return rounds(values, decimals)
