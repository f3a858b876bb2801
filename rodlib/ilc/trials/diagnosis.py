"""Do trials converge as predicted? Warnings that their signals give, after each trial.

Four checks, each against noise: the error must not grow; v must not keep growing while the error
stagnates; the outputs must follow v as the loop's model predicts; the convergence rate must be the
predicted one. How large noise is follows from the trials themselves: in a converged experiment
their errors are independent and of equal variance.
"""

from dataclasses import dataclass
from functools import cached_property
from math import factorial

import control
import numpy as np
import xarray as xr
from scipy.special import fdtrc, stdtr

from rodlib.ilc.evidence.convergence import Convergence, convergence
from rodlib.ilc.law.law import Law
from rodlib.ilc.law.limits import realised
from rodlib.ilc.loop.closed import ClosedLoop, Loop
from rodlib.ilc.models import state_sequence
from rodlib.ilc.units import by_unit

SIGNIFICANCE = 1e-4  # probability of a false warning by noise, in a test
GROWTH = 1.5  # ratio of RMS errors that is worth a warning
RISES = 3  # in succession,
JUMP = 3.0  # or in one trial, relative to the largest RMS before
AMPLIFICATION = 5.0  # largest effect of learning on the noise of a trial
STAGNATION = 0.97  # ratio of RMS errors from which on the error counts as not falling
STEPS = 3  # of v, from which on it may be said to keep growing
STRAIGHT, STEADY = 0.95, 0.9  # its distance relative to its path, last step to first
RELEVANT = 0.2  # smallest change of v or y, relative to the error
FOLLOWED = 0.5  # share of a predicted change of y; with less, the model does not hold
EXCESS = 0.05  # smallest error beyond the predicted one, of an octave, relative to it
ROUNDING = 1e-9  # relative to the largest signal
GRID = np.geomspace(1e-4, 1, 200) * np.pi  # omega Ts of the predicted rate


@dataclass(frozen=True, eq=False)
class History:
    """Trials in order, of the outputs in one unit; signals are (trial, time, channel)."""

    trials: xr.Dataset
    law: Law
    channels: list[int]
    e: np.ndarray
    reference: np.ndarray
    w: np.ndarray  # reference + v of all outputs, as far as it was applied

    @cached_property
    def rms(self) -> np.ndarray:
        """RMS of the error of each trial, summed over the channels."""
        return rms(self.e)

    @cached_property
    def since(self) -> np.ndarray:
        """Index of the first of the trials in succession that have each trial's reference."""
        changes = np.any(np.diff(self.reference, axis=0) != 0, axis=(1, 2))
        first = np.arange(len(self.e)) * np.append(True, changes)
        return np.maximum.accumulate(first)

    @property
    def names(self) -> list[str]:
        """Names of the outputs."""
        return self.trials.output.values[self.channels].tolist()

    @property
    def of_outputs(self) -> str:
        """These names in words; empty if they are all."""
        others = len(self.names) < self.trials.sizes["channel"]
        return f" of {', '.join(self.names)}" if others else ""

    @property
    def P(self) -> control.StateSpace | None:
        """Model of the law's loop."""
        return None if self.law.loop is None else self.law.loop.P

    @cached_property
    def convergence(self) -> Convergence:
        """The rate that the model predicts."""
        return convergence(self.P, self.law.Q, self.law.L, GRID / self.law.Ts)

    def predicted(self, k: int) -> np.ndarray:
        """Error of trial k by the model: e_{k-1} + r_k - r_{k-1} - P (w_k - w_{k-1})."""
        P, change = self.P, self.w[k] - self.w[k - 1]
        states = state_sequence(P.A, change @ P.B.T, np.zeros(P.nstates))
        moved = (states @ P.C.T + change @ P.D.T)[:, self.channels]
        return self.e[k - 1] + self.reference[k] - self.reference[k - 1] - moved

    def number(self, k: int) -> int:
        """Number of trial k."""
        return int(self.trials.trial[k])


def diagnose(
    trials: xr.Dataset, law: Law, first: int = 2, exact: bool = False
) -> dict[str, str]:
    """What the signals of trials say against the convergence of the law that made them.

    Parameters
    ----------
    trials : xarray.Dataset
        Successive trials, as from :func:`rodlib.run_trials`.
    law : Law
        If it is bound to a loop with a model P, predictions are checked, too.
    first : int
        The first trial to be judged, counted from 1.
    exact : bool
        Whether the trials were simulated on the model itself: then it is not checked.

    Returns
    -------
    dict
        The first warning of each kind: "error", "v", "model", "rate".
    """
    warnings = {}
    if law.L is None:
        return warnings
    checks = CHECKS if exact else CHECKS | MODEL_CHECKS
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # of 1e200
        for history in histories(trials, law):
            for k in range(max(1, first - 1), len(history.e)):
                for kind, check in checks.items():
                    text = None if kind in warnings else check(history, k)
                    if text:
                        warnings[kind] = text
    return warnings


def histories(trials: xr.Dataset, law: Law) -> list[History]:
    """The trials, split by the units of their outputs."""
    e, reference = trials.e.values, trials.reference.values
    w = reference + trials.v.values
    if law.limits:  # then that for which the loop asks for what was applied
        w = realised(law.loop, w, **commands(trials, law.loop, law.actuators))
    return [
        History(trials, law, channels, e[..., channels], reference[..., channels], w)
        for channels in by_unit(trials.output_unit.values.tolist()).values()
    ]


def commands(trials: xr.Dataset, loop: Loop, actuators=None) -> dict[str, np.ndarray]:
    """What was asked of the actuators, u, and what was applied, shape (trial, time, m)."""
    closed = isinstance(loop, ClosedLoop)
    u = (trials.reference + trials.v if closed else trials.u).values
    applied = actuators.follow(u) if actuators else u
    return {
        "u": u,
        "applied": trials.applied.values if "applied" in trials else applied,
    }


def error_grows(history: History, k: int) -> str | None:
    """Null hypothesis: errors of the trials with this reference are noise of one variance.

    It is tested where the error rose several times in succession, or to a multiple at once.
    """
    start = history.since[k]
    size = history.rms[start : k + 1]
    size = np.maximum(size, ROUNDING * max(np.abs(history.reference[k]).max(), *size))
    lowest = np.flatnonzero(np.append(True, size[1:] <= size[:-1]))[-1]
    rises = len(size) - 1 - lowest
    noise = AMPLIFICATION * np.linalg.norm(noise_std(history.e[0]))
    if not rises or size[-1] < max(GROWTH * size[lowest], noise):
        return None
    freedom = degrees_of_freedom(spectrum(history.e[k] - history.e[k - 1])).item()
    growth, jump = size[-1] / size[lowest], size[-1] / size[:-1].max()
    in_succession = rises >= RISES and chance(growth, freedom, rises + 1) < SIGNIFICANCE
    at_once = jump >= JUMP and chance(jump, freedom, 2) < SIGNIFICANCE
    if not (in_succession or at_once):
        return None
    return (
        f"the error{history.of_outputs} grows, by more than noise explains: its RMS was "
        f"{size[lowest]:.3g} in trial {history.number(start + lowest)} and is "
        f"{size[-1]:.3g} in trial {history.number(k)}. {_cause(history, k)}"
    )


def chance(ratio: float, freedom: float, trials: int) -> float:
    """Probability that so many errors of equal variance are in increasing order, and rise so far.

    Two mean squares with so many degrees of freedom have an F-distributed ratio; the largest and
    the smallest are one of n (n - 1) ordered pairs (Bonferroni). Whatever their sizes are, n errors
    are in increasing order with probability 1 / n!.
    """
    pairs = trials * (trials - 1)
    exceeds = pairs * fdtrc(freedom, freedom, min(ratio, 1e100) ** 2)
    return min(1.0, exceeds) / factorial(min(trials, 100))


def _cause(history, k):
    """Where the error grows, and what the model predicts."""
    power = np.sum(history.e[k] ** 2, axis=1)
    tenth = max(1, len(power) // 10)
    for part, name in ((power[:tenth], "first"), (power[-tenth:], "last")):
        if part.sum() > power.sum() / 2:
            return (
                f"Most of it is in the {name} tenth of the trial, where the filters need "
                "signals beyond its ends: let reference or v rest there, or choose other "
                "ends of Q and L"
            )
    remedy = "learn less, by a lower cut-off of Q or a smaller learning gain"
    if history.P is None:
        return f"Unless there was a new disturbance, the law diverges: {remedy}"
    gamma = history.convergence.gamma
    if gamma >= 1:
        return f"By the loop's model, too, sigma_max(M) reaches {gamma:.3g}: {remedy}"
    return (
        f"By the loop's model sigma_max(M) <= {gamma:.3g}: unless there was a new disturbance, "
        f"the plant differs from the model. Measure P (shake), or {remedy}"
    )


def v_grows(history: History, k: int) -> str | None:
    """v keeps growing, straight on and as fast as before, while the error stagnates."""
    start = k - STEPS
    if start < history.since[k]:
        return None
    error = history.rms[start : k + 1]
    v = (history.w[..., history.channels] - history.reference)[start : k + 1]
    steps = rms(np.diff(v, axis=0))
    (distance,) = rms(v[-1:] - v[:1])
    straight = distance >= STRAIGHT * steps.sum()
    steady = steps[-1] >= STEADY * steps[0] > ROUNDING * rms(v).max()
    stagnates = STAGNATION <= error[-1] / error[0] < GROWTH
    if not (straight and steady and stagnates and distance >= RELEVANT * error[-1]):
        return None
    return (
        f"v{history.of_outputs} keeps growing while the error stagnates: by {steps[-1]:.3g} a "
        f"trial, in one direction, and the RMS of the error is {error[0]:.3g} in trial "
        f"{history.number(start)} and {error[-1]:.3g} in trial {history.number(k)}. Is an "
        "actuator at its limit? Pass the limits to the law"
    )


def model_contradicted(history: History, k: int) -> str | None:
    """Outputs do not follow v, in two successive trials: one may have a new disturbance."""
    if history.P is None or k < 2:
        return None
    names = [
        name
        for i, name in enumerate(history.names)
        if _ignores_v(history, k - 1, i) and _ignores_v(history, k, i)
    ]
    if not names:
        return None
    return (
        f"{', '.join(names)} of trials {history.number(k - 1)} and {history.number(k)} "
        "contradict the loop's model: not half of the change that it predicts came, and the "
        "error does not fall. Is a sensor or an actuator at its limit, exchanged or reversed? "
        "Else measure P (shake)"
    )


def _ignores_v(history, k, i):
    """t test of the share of its predicted change that output i made, if its error did not fall.

    The share is the regression coefficient of the change on its prediction. Null hypothesis: it is
    FOLLOWED or more. Of two trials, both are rejected by chance with the square of the probability.
    """
    error, before = history.e[k, :, i], history.e[k - 1, :, i]
    shift = history.reference[k, :, i] - history.reference[k - 1, :, i]
    change = shift - error + before
    predicted = shift - history.predicted(k)[:, i] + before
    size = np.linalg.norm(predicted)
    share = change @ predicted / size**2
    residual = change - share * predicted
    freedom = degrees_of_freedom(spectrum(residual[:, None])).item()
    standard_error = np.linalg.norm(residual) / size / np.sqrt(freedom)
    p = stdtr(freedom, (share - FOLLOWED) / standard_error)
    rest = np.linalg.norm(error)
    falls = rest <= STAGNATION * np.linalg.norm(before)
    return p < np.sqrt(SIGNIFICANCE) and not falls and size > RELEVANT * rest


def converges_slowly(history: History, k: int) -> str | None:
    """F test, octave by octave, of the first two trials with this reference.

    Null hypothesis: the error of the second one is at most the predicted one, plus noise with the
    variance of the last three trials about their mean.
    """
    i = history.since[k]
    if history.P is None or k < i + 4:
        return None
    table = error_by_octave(history, i + 1)
    bound = np.maximum(table["bound"], table["predicted"])
    excess = table["before"] * np.maximum(table["measured"] - bound, 0)

    last = history.e[k - 2 : k + 1]
    power = spectrum(last - last.mean(axis=0)).sum(axis=0) / 2
    edges = octaves(len(history.e[k]))
    variance = np.add.reduceat(power.sum(axis=1), edges)
    variance += (ROUNDING * np.abs(last).max()) ** 2
    freedom = degrees_of_freedom(power, edges)
    p = chance_of_excess(excess, variance, freedom)

    falls, relevant = table["measured"] < 1, excess > EXCESS * history.rms[i]
    slow = falls & relevant & (p < SIGNIFICANCE)
    if not slow.any():
        return None
    worst = np.argmax(slow * excess)
    row = {name: column[worst] for name, column in table.items()}
    return (
        f"the convergence rate is not the predicted one: up to {row['frequency']:.2g} rad/s, "
        f"trial {history.number(i + 1)} has {row['measured']:.2f} of the error"
        f"{history.of_outputs} of the one before; the loop's model predicts "
        f"{row['predicted']:.2f}, sigma_max(M) is {row['bound']:.2f} at most, and noise is "
        "less. Unless there was a new disturbance, the plant differs from the model: measure P "
        "(shake), or expect this rate"
    )


def chance_of_excess(excess, variance, freedom) -> np.ndarray:
    """Probability that noise exceeds the prediction so far, in each octave, in any of them.

    The square of the excess has the n degrees of freedom of one trial in this octave; the variance
    of three trials about their mean has 2 n. Bonferroni corrects for the number of octaves.
    """
    return len(excess) * fdtrc(freedom, 2 * freedom, excess**2 / variance)


CHECKS = {"error": error_grows, "v": v_grows}
MODEL_CHECKS = {"model": model_contradicted, "rate": converges_slowly}


def error_by_octave(history: History, k: int) -> dict[str, np.ndarray]:
    """The error of trial k relative to that of the one before, by octaves up to `frequency`, rad/s.

    `before` is the RMS of the error of the trial before. Relative to it, `bound` is sigma_max(M),
    for trials without ends; `predicted` follows from the model and the v that was recorded, ends
    included; `measured` is the error of trial k, and `noise` its share of white noise, as large as
    differences between neighbours in time are.
    """
    samples, convergence = len(history.e[k]), history.convergence
    first = octaves(samples)
    edges = np.append(first, samples // 2 + 1) * 2 * np.pi / (samples * history.law.Ts)
    inside = np.geomspace(np.maximum(edges[:-1], convergence.omega[0]), edges[1:], 9)
    sigma = np.interp(inside, convergence.omega, convergence.sigma).max(axis=0)
    signals = np.stack([history.e[k - 1], history.predicted(k), history.e[k]])
    power = np.add.reduceat(spectrum(signals).sum(axis=-1), first, axis=-1)
    before, predicted, measured = np.sqrt(power)
    before = np.maximum(before, np.finfo(float).tiny)
    white = np.linalg.norm(noise_std(history.e[k]))
    return {
        "frequency": edges[1:],
        "before": before,
        "bound": 1 - history.law.gain * (1 - sigma),
        "predicted": predicted / before,
        "measured": measured / before,
        "noise": white * np.sqrt(np.diff(edges) / edges[-1]) / before,
    }


def octaves(samples: int) -> np.ndarray:
    """The first harmonic of each octave of a trial's spectrum: 0, 2, 4, 8, ..."""
    return np.append(0, 2 ** np.arange(1, (samples // 2).bit_length()))


def spectrum(signals) -> np.ndarray:
    """Mean square of signals (..., time, channel) at each harmonic, (..., harmonic, channel)."""
    samples = signals.shape[-2]
    power = np.abs(np.fft.rfft(signals, axis=-2) / samples) ** 2
    power[..., 1 : (samples + 1) // 2, :] *= 2
    return power


def degrees_of_freedom(power, edges=(0,)) -> np.ndarray:
    """Degrees of freedom of a mean square, by its spectrum (harmonic, channel), in each octave."""
    total, squares = (
        np.add.reduceat(values.sum(axis=1), edges) for values in (power, power**2)
    )
    return np.maximum(2, 2 * total**2 / np.maximum(squares, np.finfo(float).tiny))


def rms(signals) -> np.ndarray:
    """RMS of each of the signals (trial, time, channel), summed over the channels."""
    return np.sqrt(np.sum(signals**2, axis=2).mean(axis=1))


def noise_std(signals) -> np.ndarray:
    """Standard deviation of white noise in signals (time, channel), from neighbours in time."""
    if len(signals) < 3:
        return np.zeros(signals.shape[1])
    return np.sqrt(np.mean(np.diff(signals, 2, axis=0) ** 2, axis=0) / 6)
