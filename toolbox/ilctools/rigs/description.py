"""The checked description of a rig, its loop and its law, made before the first sample."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ilctools import arguments
from ilctools.law.law import Law
from ilctools.law.limits import Actuators, named_limits
from ilctools.loop.closed import CurrentTrialLoop, Loop
from ilctools.rigs.controller import rounded
from ilctools.rigs.interrupts import SAFE_TIME
from ilctools.rigs.limits import stop_limits
from ilctools.rigs.protocol import Rig
from ilctools.trials.learn import disturbances_of

ROUNDED_SIGNALS = ["v", "u", "delta", "disturbance"]  # the signals that `decimals` can be about


@dataclass(frozen=True)
class RigSignals:
    """Names of the signals that a rig takes and measures, and that are recorded."""

    commands: list[str]  # u if our controller runs, w if the rig has its own
    inputs: list[str]  # of the rig, in the order of the numbers that `apply` takes
    controls: list[str]  # u, which a rig reports if the controller is its own; else empty
    commanded: list[str]  # disturbances of the loop that are inputs of the rig
    disturbances: list[str]  # known disturbances of the loop, which are commanded or measured

    @cached_property
    def measured_as(self) -> dict[str, str]:
        """What the rig measures besides y, and as which signal each quantity is recorded."""
        signals = dict.fromkeys(self.disturbances, "disturbance") | dict.fromkeys(
            self.controls, "u"
        )
        return {name: signal for name, signal in signals.items() if name not in self.commanded}

    @cached_property
    def places(self) -> list[int]:
        """Positions of the commands, and then of the commanded disturbances, among the inputs."""
        return [self.inputs.index(name) for name in self.commands + self.commanded]


@dataclass(frozen=True)
class RigDescription:
    """A rig with its loop, its law and its limits, as one object that :func:`described` makes."""

    driver: Rig
    loop: Loop  # the controller is ours if it is a CurrentTrialLoop, else the rig's
    signals: RigSignals
    Ts: float  # s
    decimals: dict[str, int]  # number of decimals of signals that are rounded
    limits: dict[str, tuple[float, float]]  # limits of the rig, by the name of the command
    law: Law | None  # the law on this rig: within its limits, unless the law has no limits
    actuators: Actuators | None  # saturate commands at the limits of the law, if it has limits
    stop: dict[str, tuple[float, float]]  # limits beyond which the experiment stops, by name
    begin: Callable | None  # brings the rig to where trials begin, if the rig can
    clock: Callable | None  # gives the time in s, if the rig has a clock
    safe: Callable | None  # leaves the rig safe, if the rig has this method
    safe_time: float  # s, the longest time of `safe` before a signal ends it
    trials: int
    samples: int  # of a trial
    goes_on: bool  # whether a trial starts where the last one ended

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs y, in the order of the numbers that `read` returns."""
        return self.loop.outputs

    def rounded(self, signal: str, values) -> np.ndarray:
        """Round a signal to the decimals that are recorded."""
        return rounded(values, self.decimals.get(signal))

    def flows_of(self, disturbance) -> np.ndarray:
        """Select the commanded disturbances, shape (trial, time, commanded disturbance)."""
        names, known = self.loop.disturbances, self.signals.disturbances
        d = disturbances_of(self.loop, disturbance, self.trials, self.samples)
        nonzero = d.any(axis=(0, 1))
        unknown = [name for i, name in enumerate(names) if nonzero[i] and name not in known]
        if unknown:
            raise ValueError(
                f"disturbance is not zero for {unknown}, which are not among "
                "rig.inputs: set these to zero, or add them to rig.inputs"
            )
        return d[..., [names.index(name) for name in self.signals.commanded]]


def described(
    rig: Rig,
    loop: Loop,
    reference: np.ndarray,
    law: Law | None = None,
    stop: dict | None = None,
    decimals: dict[str, int] | None = None,
    goes_on: bool = False,
) -> RigDescription:
    """Describe a rig under its loop.

    If rig, loop and arguments do not fit together, a ValueError is raised.

    Parameters
    ----------
    rig, stop, decimals
        As for :func:`ilctools.record`.
    loop : CurrentTrialLoop or ClosedLoop
        With a CurrentTrialLoop our controller runs and sends u. With a ClosedLoop the controller of
        the rig takes w.
    reference : ndarray, shape (trial, time, output)
        The reference of all trials, from which the limits of `stop` follow.
    law : Law, optional
        The law, bound to the loop. If the law states no limit for a command, the limit of the rig
        counts.
    goes_on : bool
        Whether a trial starts where the last one ended.
    """
    if isinstance(arguments.instance("rig", rig, Rig), type):
        raise ValueError(
            f"rig = {rig.__name__} is a class: pass an instance, such as {rig.__name__}()"
        )
    signals = _signals(rig, loop)
    limits = named_limits("rig.limits", getattr(rig, "limits", None), signals.inputs)
    limits = {name: limits[name] for name in signals.commands if name in limits}
    law = law and law.on_rig(limits)
    trials, samples = reference.shape[:2]
    optional = {name: getattr(rig, name, None) for name in ("begin", "clock", "safe")}
    return RigDescription(
        driver=rig,
        loop=loop,
        signals=signals,
        Ts=arguments.sampling_period("rig.Ts", getattr(rig, "Ts", loop.Ts)),
        decimals=_checked_decimals(decimals),
        limits=limits,
        law=law,
        actuators=law and law.actuators,
        stop=stop_limits(stop, reference, loop, limits),
        **optional,
        safe_time=arguments.positive("rig.safe_time", getattr(rig, "safe_time", SAFE_TIME)),
        trials=trials,
        samples=samples,
        goes_on=goes_on,
    )


def _checked_decimals(decimals):
    """Check the numbers of decimals, by the signal that is rounded."""
    asked = arguments.by_name("decimals", decimals, ROUNDED_SIGNALS)
    return {
        signal: arguments.whole(f"decimals[{signal!r}]", number, 0, 300)
        for signal, number in asked.items()
    }


def _signals(driver, loop):
    """Find which signals are sent, measured and recorded besides commands and outputs."""
    commands, measured = loop.commands, getattr(driver, "measured", {})
    inputs = list(getattr(driver, "inputs", commands))
    if missing := [name for name in commands if name not in inputs]:
        raise ValueError(f"rig.inputs = {inputs} must contain the commands {missing}")
    controls = [] if isinstance(loop, CurrentTrialLoop) else loop.controls
    if missing := [name for name in controls if name not in measured]:
        raise ValueError(f"rig.measured must contain the controls {missing} of the loop")
    commanded = [name for name in loop.disturbances if name in inputs]
    known = [name for name in loop.disturbances if name in inputs or name in measured]
    return RigSignals(commands, inputs, controls, commanded, known)
