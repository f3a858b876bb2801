"""A rig and its controller: ours, sample by sample; the rig's; or a rig that runs whole trials."""

import math
import reprlib
import warnings
from contextlib import contextmanager

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.law.limits import commands_beyond, named_limits
from rodlib.ilc.loop.closed import CurrentTrialLoop, Loop, check_loop
from rodlib.ilc.rigs.protocol import RigError, StoppedError

LATE = 0.1  # sampling periods that a sample may be off the clock


class Controller:
    """Observer (16) and state feedback (18), sample by sample as on hardware.

    Parameters
    ----------
    loop : CurrentTrialLoop
    decimals : int, optional
        To which commands are rounded. Default: not at all.
    """

    def __init__(self, loop: CurrentTrialLoop, decimals: int | None = None):
        arguments.instance("loop", loop, CurrentTrialLoop)
        if decimals is not None:
            arguments.whole("decimals", decimals, 0, 300)
        m = loop.plant.noutputs
        self.loop, self.decimals = loop, decimals
        self._B = loop.plant.B[:, :m]
        self._x_hat, self.delta = np.zeros(loop.plant.nstates), np.zeros(m)

    def step(self, y, w) -> np.ndarray:
        """The controls u(p) from the measured y(p) and w(p); advances the observer."""
        shape = self.delta.shape
        y, w = arguments.array("y", y, shape), arguments.array("w", w, shape)
        u = self.command(w)
        self.observe(y, u)
        return u

    def command(self, w) -> np.ndarray:
        """The controls u(p), from w(p) and what is estimated."""
        u = self.loop.N @ w - self.loop.Ks @ self._x_hat - self.delta  # (18)
        return _rounded(u, self.decimals)

    def observe(self, y, applied) -> None:
        """Advance the observer by the measured y(p) and the controls that were applied."""
        A, C, n = self.loop.plant.A, self.loop.plant.C, len(self._x_hat)
        correction = self.loop.KL @ (y - C @ self._x_hat)
        forcing = self._B @ (applied + self.delta)
        self._x_hat = A @ self._x_hat + forcing + correction[:n]  # (16)
        self.delta = self.delta + correction[n:]


class ControlledRig:
    """What the three kinds have in common: names, limits, decimals, a safe end."""

    disturbed: tuple[str, ...] = ()  # disturbances of the loop that are inputs
    recorded: tuple[str, ...] = ()  # disturbances of the loop that are known
    waits = True  # whether the rig can be held before a trial

    def __init__(self, rig, loop: Loop, decimals):
        self.rig, self.loop = rig, loop
        # looked up once, not in every sample
        self.outputs, self.commands = loop.outputs, loop.commands
        names = ["v", "u", "delta", "disturbance"]
        self.decimals = arguments.by_name("decimals", decimals, names)
        for name, value in self.decimals.items():
            arguments.whole(f"decimals[{name!r}]", value, 0, 300)
        self.inputs = list(getattr(rig, "inputs", loop.commands))
        missing = [name for name in loop.commands if name not in self.inputs]
        if missing:
            raise ValueError(
                f"rig.inputs = {self.inputs} must name the commands {missing}"
            )
        limits = getattr(rig, "limits", None)
        self.limits = named_limits("rig.limits", limits, self.inputs, slew=True)
        self.Ts = arguments.sampling_period("rig.Ts", getattr(rig, "Ts", loop.Ts))
        self.actuators = None  # of a law with limits
        self.stop = {}  # limits of outputs and commands, by name

    @property
    def ours(self) -> bool:
        """Whether the loop's controller is ours, so that its commands are u, and not w."""
        return isinstance(self.loop, CurrentTrialLoop)

    def rounded(self, name, values) -> np.ndarray:
        """A signal with as many digits as are recorded."""
        return _rounded(values, self.decimals.get(name))

    def commanded(self, disturbance, trials, samples) -> np.ndarray:
        """The commands to the disturbances that are inputs, shape (trial, time, them)."""
        names = self.loop.disturbances
        if disturbance is None:
            return np.zeros((trials, samples, len(self.disturbed)))
        shape = (..., samples, len(names))
        d = arguments.in_columns("disturbance", disturbance, shape, names)
        if d.ndim == 2:
            d = np.broadcast_to(d, (trials, *d.shape))
        d = arguments.array("disturbance", d, ("trial", *shape[1:]))
        if len(d) < trials:
            raise ValueError(f"disturbance has {len(d)} trials, but trials = {trials}")
        nonzero = [name for i, name in enumerate(names) if d[..., i].any()]
        unknown = [name for name in nonzero if name not in self.recorded]
        if unknown:
            raise ValueError(
                f"disturbance is not zero for {unknown}, which are not rig.inputs"
            )
        return d[:trials][..., [names.index(name) for name in self.disturbed]]

    def begin(self, trial) -> None:
        """Bring the rig to where trials begin, if it can."""
        if hasattr(self.rig, "begin"):
            self.rig.begin(trial)

    def run(self, trial, reference, v, commanded, bar) -> dict[str, np.ndarray]:
        """Run one trial; its signals, shape (time, channel)."""
        v = self.rounded("v", v)
        signals = self.run_trial(trial, reference, reference + v, commanded, bar)
        commands = signals["u"] if self.ours else reference + v
        if self.actuators is None:
            beyond = commands_beyond(commands, self.loop.commands, self.limits)
            if beyond:
                warnings.warn(
                    f"trial {trial}: {beyond}; what the rig cuts off, the law does not know",
                    stacklevel=6,
                )
        return {"v": v} | signals

    def check_stop(self, names, values) -> None:
        """Stop at what is beyond the limits of `stop`."""
        if not self.stop:
            return
        for name, value in zip(names, values.tolist(), strict=True):
            low, high = self.stop.get(name, (-math.inf, math.inf))
            if not low <= value <= high:
                what = f"{name} = {value:.6g} is not from {low:.6g} to {high:.6g}"
                raise StoppedError(f"{what}, the limits of stop")

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
            raise ValueError(
                f"rig.measured must have the controls {missing} of the loop"
            )
        names = loop.disturbances
        self.disturbed = [name for name in names if name in self.inputs]
        self.recorded = [n for n in names if n in self.disturbed or n in measured]
        self.measured = [n for n in self.recorded if n not in self.disturbed]
        commands = loop.commands + self.disturbed
        self.positions = np.array([self.inputs.index(name) for name in commands])
        self.applied = None  # the last commands

    def begin(self, trial):
        super().begin(trial)
        if hasattr(self.rig, "begin"):
            self.applied = None

    def pause(self, trial, samples, w, start, bar) -> None:
        """Hold w before a trial for so many samples; None: until all is back and still."""
        wait = samples is None
        flows, y = np.zeros(len(self.disturbed)), []
        for p in range(start.longest if wait else samples):
            where = f"pause before trial {trial}, sample {p + 1}"
            y.append(self.sample(w, flows, where)["y"])
            bar.update(0 if wait else 1)
            if wait and p % max(1, start.window // 10) == 0 and start.back(y, w):
                return
        if wait:
            warnings.warn(
                f"before trial {trial} the outputs were not back and still after {len(y)} samples",
                stacklevel=6,
            )

    def run_trial(self, trial, reference, w, commanded, bar) -> dict[str, np.ndarray]:
        """Run the samples of a trial."""
        clock = getattr(self.rig, "clock", None)
        start = clock() if clock else 0.0
        samples, lateness, squares = [], [], 0.0
        for p in range(len(w)):
            if clock:
                lateness.append(clock() - start - p * self.Ts)
            where = f"trial {trial}, sample {p + 1}"
            samples.append(self.sample(w[p], commanded[p], where))
            if not bar.disable:
                squares += float(np.sum((reference[p] - samples[p]["y"]) ** 2))
                rms = math.sqrt(squares / (p + 1))
                bar.set_postfix_str(f"RMS {rms:.3g}", refresh=False)
                bar.update()
        late = np.abs(lateness) > LATE * self.Ts
        if late.any():
            worst = np.abs(lateness).argmax()
            warnings.warn(
                f"trial {trial}: {late.sum()} samples were not on time, the worst, sample "
                f"{worst + 1}, by {lateness[worst]:.3g} s",
                stacklevel=7,
            )
        return {name: np.array([s[name] for s in samples]) for name in samples[0]}

    def sample(self, w, flows, where) -> dict[str, np.ndarray]:
        """Let one sampling period pass: read, check, then apply what the controller makes of it."""
        with _located(where, ". Nothing was applied after it"):
            y, measured = self.read()
            self.check_stop(self.outputs, y)
            signals = self.control(y, w, measured)
            inputs = np.zeros(len(self.inputs))
            inputs[self.positions] = np.concatenate([self.applied, flows])
            self.rig.apply(inputs)
        measured |= dict(zip(self.disturbed, flows, strict=True))
        disturbance = [measured[name] for name in self.recorded]
        if self.recorded:
            signals["disturbance"] = np.array(disturbance)
        return signals | {"y": y}

    def control(self, y, w, measured) -> dict[str, np.ndarray]:
        """Set `applied`, the commands of this sample; the signals that this makes."""
        self.check_stop(self.commands, w)
        self.applied = self.limited(w)
        u = [self.rounded("u", measured[name]) for name in self.reported]
        return {"u": np.array(u)} if u else {}

    def limited(self, commands) -> np.ndarray:
        """What the limits of the law leave of the commands of a sample."""
        if self.actuators is None:
            return commands
        return self.actuators.next(commands, self.applied)

    def read(self) -> tuple[np.ndarray, dict[str, float]]:
        """The outputs, and what else is measured; nothing is used before it is checked."""
        names = self.measured + self.reported
        y, measured = self.rig.read(), self.rig.measured if names else {}
        try:
            y = arguments.array("reading", y, (len(self.outputs),))
            values = {
                name: float(arguments.array(name, measured.get(name), ()))
                for name in names
            }
        except ValueError as error:
            raise RigError(str(error)) from None
        for name in self.measured:
            values[name] = self.rounded("disturbance", values[name])
        return y, values


class ControllerOnRig(SampledRig):
    """A rig of two methods, with our controller."""

    controller = None

    def begin(self, trial):
        super().begin(trial)
        if self.controller is None or hasattr(self.rig, "begin"):
            self.controller = Controller(self.loop, self.decimals.get("u"))

    def control(self, y, w, measured):
        controller = self.controller
        signals = {"delta": self.rounded("delta", controller.delta)}
        u = signals["u"] = controller.command(w)
        self.check_stop(self.commands, u)
        self.applied = self.limited(u)
        controller.observe(y, self.applied)
        if self.actuators is not None:
            signals["applied"] = self.applied
        return signals


class WholeTrialRig(ControlledRig):
    """A rig that runs whole trials by itself, whoever's the controller is."""

    waits = False

    def run_trial(self, trial, reference, w, commanded, bar) -> dict[str, np.ndarray]:
        """Upload w, let the trial run, download and check it."""
        loop, signals = self.loop, {}
        cut_off = self.actuators is not None and not self.ours
        with _located(f"trial {trial}"):
            result = self.rig.run(self.actuators.follow(w) if cut_off else w.copy())
            pair = loop.controls and isinstance(result, tuple) and len(result) == 2
            y, u = result if pair else (result, None)
            try:
                signals["y"] = arguments.array("y", y, w.shape)
                if loop.controls:
                    u = arguments.array("u", u, w.shape)
                    signals["u"] = self.rounded("u", u)
            except ValueError as error:
                raise RigError(str(error)) from None
        for p in range(len(w)):
            with _located(f"trial {trial}, sample {p + 1}"):
                self.check_stop(loop.outputs, signals["y"][p])
                if self.ours:
                    self.check_stop(loop.commands, signals["u"][p])
        if self.actuators is not None and self.ours:
            signals["applied"] = self.actuators.follow(signals["u"])
        bar.update(len(w))
        return signals


def controlled(rig, loop: Loop, decimals) -> ControlledRig:
    """A rig with the controller of its loop, of one of the three kinds."""
    if isinstance(rig, type):
        raise ValueError(f"rig = {rig!r} is a class: make one")
    check_loop(loop)
    methods = {
        name for name in ("read", "apply", "run") if callable(getattr(rig, name, None))
    }
    if {"read", "apply"} <= methods:
        kind = ControllerOnRig if isinstance(loop, CurrentTrialLoop) else SampledRig
    elif "run" in methods:
        kind = WholeTrialRig
    else:
        raise ValueError(
            f"rig = {reprlib.repr(rig)} has no methods read and apply: see Rig"
        )
    return kind(rig, loop, decimals)


@contextmanager
def _located(where, more=""):
    """Say in an error where it arose."""
    try:
        yield
    except RigError as error:
        raise type(error)(f"{where}: {error}{more}") from None
    except Exception as error:
        error.add_note(f"in {where}")
        raise


def _rounded(values, decimals):
    if decimals is None:
        return values
    # numpy rounds some decimals up that are just below a half
    rounds = round if isinstance(values, float) else np.round
    return rounds(values, decimals)
