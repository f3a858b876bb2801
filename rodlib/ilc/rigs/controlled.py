"""A rig with the controller on it: the loop, sample by sample as on hardware."""

import math
import reprlib
import warnings
from contextlib import contextmanager

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.law.limits import named_limits
from rodlib.ilc.loop.closed import CurrentTrialLoop, check_loop
from rodlib.ilc.rigs.limits import commands_beyond, stop_limits
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
        n, m = loop.plant.nstates, loop.plant.noutputs
        self.loop, self.decimals = loop, decimals
        self._B = loop.plant.B[:, :m]
        self._x_hat, self.delta = np.zeros(n), np.zeros(m)
        self.follow = (
            np.asarray
        )  # what the actuators make of u, which the observer is told

    def step(self, y, w) -> np.ndarray:
        """The controls u(p) from the measured y(p) and w(p); advances the observer."""
        shape = self.delta.shape
        return self._advance(
            arguments.array("y", y, shape), arguments.array("w", w, shape)
        )

    def _advance(self, y, w) -> np.ndarray:
        """As `step`, of what was checked."""
        loop = self.loop
        u = _rounded(
            loop.N @ w - loop.Ks @ self._x_hat - self.delta, self.decimals
        )  # (18)
        surprise = loop.KL @ (y - loop.plant.C @ self._x_hat)
        n, forced = len(self._x_hat), self._B @ (self.follow(u) + self.delta)
        self._x_hat = loop.plant.A @ self._x_hat + forced + surprise[:n]  # (16)
        self.delta = self.delta + surprise[n:]
        return u


class ControlledRig:
    """A rig with the controller on it: signals by name, no reading used before it is checked."""

    def __init__(self, rig, loop, decimals):
        if isinstance(rig, type):
            raise ValueError(f"rig = {rig!r} is a class: make one")
        missing = [
            name for name in ("read", "apply") if not callable(getattr(rig, name, None))
        ]
        self.whole = bool(missing) and callable(getattr(rig, "run", None))
        if missing and not self.whole:
            raise ValueError(
                f"rig = {reprlib.repr(rig)} has no {', '.join(missing)}: see Rig"
            )
        self.rig, self.loop = rig, check_loop(loop)
        self.ours = isinstance(
            loop, CurrentTrialLoop
        )  # the controller, if it is not on the rig
        self.outputs, self.commands = loop.outputs, loop.commands
        decimals = arguments.by_name(
            "decimals", decimals, ["v", "u", "delta", "disturbance"]
        )
        for name, value in decimals.items():
            arguments.whole(f"decimals[{name!r}]", value, 0, 300)
        self.decimals = decimals
        self.inputs = list(getattr(rig, "inputs", self.commands))
        missing = [name for name in self.commands if name not in self.inputs]
        if missing:
            what = "controls" if self.ours else "references"
            raise ValueError(
                f"rig.inputs = {self.inputs} must name the {what} {missing}"
            )
        given = getattr(rig, "limits", None)
        self.limits = named_limits("rig.limits", given, self.inputs, slew=True)
        self.actuators = None  # of a law with limits
        self.applied = None  # the last commands
        heard = {} if self.whole else getattr(rig, "measured", {})
        self.told = (
            [] if self.ours or self.whole else loop.controls
        )  # u, by who commands it
        missing = [name for name in self.told if name not in heard]
        if missing:
            raise ValueError(
                f"rig.measured must have the controls {missing} of the loop"
            )
        moved = [] if self.whole else loop.disturbances
        self.moved = [name for name in moved if name in self.inputs]
        self.heard = [
            n for n in loop.disturbances if n in heard and n not in self.moved
        ]
        self.recorded = [n for n in loop.disturbances if n in self.moved + self.heard]
        self.positions = [
            self.inputs.index(name) for name in self.commands + self.moved
        ]
        self.Ts = arguments.sampling_period("rig.Ts", getattr(rig, "Ts", loop.Ts))
        self.controller = None
        self.stop = {}  # limits of outputs and commands, by name
        self.samples, self.w = [], None  # of the trial that runs, or ran last

    def stop_at(self, stop, reference):
        """Set the limits of outputs and commands beyond which a trial stops."""
        self.stop = stop_limits(stop, reference, self.loop, self.limits)

    @property
    def recorded_signals(self) -> list[str]:
        """Which signals a trial has."""
        names = {"v": True, "u": self.loop.controls, "y": True}
        names |= {"applied": self.ours and self.actuators}
        names |= {"delta": self.ours and not self.whole, "disturbance": self.recorded}
        return [name for name, there in names.items() if there]

    def commanded(self, disturbance, trials, samples) -> np.ndarray:
        """The commands to the disturbances that are inputs, shape (trial, time, them)."""
        names = self.loop.disturbances
        if disturbance is None:
            return np.zeros((trials, samples, len(self.moved)))
        d = arguments.in_columns(
            "disturbance", disturbance, (..., samples, len(names)), names
        )
        d = d if d.ndim != 2 else np.broadcast_to(d, (trials, *d.shape))
        d = arguments.array("disturbance", d, ("trial", samples, len(names)))
        if len(d) < trials:
            raise ValueError(
                f"disturbance has {len(d)} trials, but trials = {trials} are asked for"
            )
        unknown = [
            n for i, n in enumerate(names) if n not in self.recorded and d[..., i].any()
        ]
        if unknown:
            raise ValueError(
                f"disturbance is not zero for {unknown}, which are no rig.inputs"
            )
        return d[:trials][..., [names.index(name) for name in self.moved]]

    def begin(self, trial):
        """Bring the rig to where trials begin, if it can; without a past, the controller, too."""
        restarts = hasattr(self.rig, "begin")
        if restarts:
            self.rig.begin(trial)
            self.applied = None
        if self.ours and (restarts or self.controller is None):
            self.controller = Controller(self.loop, self.decimals.get("u"))
            self.controller.follow = self.follow

    def pause(self, trial, samples, w, start, bar):
        """Hold the start of the reference before a trial, if samples is None until all is back."""
        held, y, wait = np.zeros(len(self.moved)), [], samples is None
        for p in range(start.longest if wait else samples):
            y.append(
                self.sample(w, held, f"pause before trial {trial}, sample {p + 1}")["y"]
            )
            bar.update(0 if wait else 1)
            if wait and p % max(1, start.window // 10) == 0 and start.back(y, w):
                return
        if wait:
            warnings.warn(
                f"before trial {trial} the outputs were not back and still after {len(y)} samples",
                stacklevel=5,
            )

    def rounded_v(self, v) -> np.ndarray:
        """An ILC signal with as many digits as are recorded."""
        return _rounded(v, self.decimals.get("v"))

    def run(self, trial, reference, v, commanded, bar) -> dict[str, np.ndarray]:
        """Run one trial; its signals, shape (time, channel)."""
        v = self.rounded_v(v)
        self.samples, self.w, squares, off = [], reference + v, 0.0, []
        if self.whole:
            self.download(trial)
            bar.update(len(v))
            return {"v": v} | self.followed(trial)
        clock = getattr(self.rig, "clock", None)
        start = clock() if clock else 0.0
        for p, (r, w, flows) in enumerate(
            zip(reference, self.w, commanded, strict=True)
        ):
            if clock:
                off.append(clock() - start - p * self.loop.Ts)
            self.samples.append(self.sample(w, flows, f"trial {trial}, sample {p + 1}"))
            if not bar.disable:
                squares += float(np.sum((r - self.samples[-1]["y"]) ** 2))
                bar.set_postfix_str(
                    f"RMS {math.sqrt(squares / (p + 1)):.3g}", refresh=False
                )
                bar.update()
        off = np.array(off)
        late = np.flatnonzero(np.abs(off) > LATE * self.loop.Ts)
        if late.size:
            worst = np.abs(off).argmax()
            many = f"{late.size} samples were not on time, the worst, sample {worst + 1}, by"
            warnings.warn(f"trial {trial}: {many} {off[worst]:.3g} s", stacklevel=5)
        return {"v": v} | self.followed(trial)

    def followed(self, trial):
        """The signals of the trial that ran, with a warning of commands that were not followed."""
        signals = self.signals()
        commands = signals["u"] if self.ours else self.w
        if self.actuators:
            if self.ours and self.whole:
                signals["applied"] = self.actuators.follow(commands)
            return signals
        cut_off = commands_beyond(commands, self.commands, self.limits)
        if cut_off:
            learned = "what the actuators cannot do, no learning will do for them"
            warnings.warn(f"trial {trial}: {cut_off}; {learned}", stacklevel=6)
        return signals

    def download(self, trial):
        """Let the rig run a whole trial by itself; its samples."""
        with_u, shape = bool(self.loop.controls), self.w.shape
        cut_off = self.actuators and not self.ours
        with _told(f"trial {trial}"):
            result = self.rig.run(
                self.actuators.follow(self.w) if cut_off else self.w.copy()
            )
            y, *more = result if with_u and isinstance(result, tuple) else (result,)
            try:
                downloaded = {"y": arguments.array("y", y, shape)}
                if with_u:
                    u = arguments.array("u", more[0] if more else None, shape)
                    downloaded["u"] = _rounded(u, self.decimals.get("u"))
            except ValueError as error:
                raise RigError(str(error)) from None
        samples = zip(*downloaded.values(), strict=True)
        self.samples = [
            dict(zip(downloaded, sample, strict=True)) for sample in samples
        ]
        for p, sample in enumerate(self.samples):
            with _told(f"trial {trial}, sample {p + 1}"):
                self.check(sample["y"], self.outputs)
                if self.ours:
                    self.check(sample["u"], self.commands)

    def signals(self) -> dict[str, np.ndarray]:
        """What was sampled of the trial that runs, or ran last."""
        return {
            name: np.array([s[name] for s in self.samples]) for name in self.samples[0]
        }

    def sample(self, w, flows, where) -> dict[str, np.ndarray]:
        """Let one sampling period pass: read, check, then apply what the controller makes of it."""
        with _told(where, ". Nothing was applied after it"):
            y, heard = self.readings()
            self.check(y, self.outputs)
            if self.ours:
                found = {
                    "delta": _rounded(self.controller.delta, self.decimals.get("delta"))
                }
                commands = found["u"] = self.controller._advance(y, w)
            else:
                u = np.array([heard.pop(name) for name in self.told])
                found, commands = {"u": u} if self.told else {}, w
                self.follow(w)
            self.check(commands, self.commands)
            command = np.zeros(len(self.inputs))
            command[self.positions] = np.concatenate([self.applied, flows])
            if self.ours and self.actuators:
                found["applied"] = self.applied
            self.rig.apply(command)
        known = heard | dict(zip(self.moved, flows, strict=True))
        disturbance = np.array([known[name] for name in self.recorded])
        return found | {"y": y, "disturbance": disturbance}

    def follow(self, commands) -> np.ndarray:
        """What is applied of the commands of a sample."""
        if self.actuators:
            commands = self.actuators.next(commands, self.applied)
        self.applied = commands
        return commands

    def check(self, values, names):
        """Stop at what is beyond the limits."""
        for name, value in zip(names, values, strict=True):
            low, high = self.stop.get(name, (-math.inf, math.inf))
            if not low <= value <= high:
                what = f"{name} = {value:.6g} is not from {low:.6g} to {high:.6g}"
                raise StoppedError(f"{what}, the limits of stop")

    def readings(self) -> tuple[np.ndarray, dict[str, float]]:
        """The outputs, and what else is measured: disturbances, and u if it is not ours."""
        names = self.heard + self.told
        y, heard = self.rig.read(), self.rig.measured if names else {}
        try:
            y = arguments.array("reading", y, (len(self.outputs),))
            heard = {
                name: float(arguments.array(name, heard.get(name), ()))
                for name in names
            }
        except ValueError as error:
            raise RigError(str(error)) from None
        for name, value in heard.items():
            decimals = self.decimals.get("u" if name in self.told else "disturbance")
            heard[name] = value if decimals is None else round(value, decimals)
        return y, heard

    @contextmanager
    def in_the_end_safe(self):
        """Leave the rig in a safe state on every way out."""
        try:
            yield
        finally:
            if hasattr(self.rig, "safe"):
                self.rig.safe()
            elif not self.whole:
                self.rig.apply(np.zeros(len(self.inputs)))


@contextmanager
def _told(where, more=""):
    """Say in an error where it arose."""
    try:
        yield
    except RigError as error:
        raise type(error)(f"{where}: {error}{more}") from None
    except Exception as error:
        error.add_note(f"in {where}")
        raise


def _rounded(values, decimals):
    return values if decimals is None else values.round(decimals)
