"""Do trials converge as predicted? Warnings that their signals give, after each trial.

Four checks, each against noise: the error must not grow; v must not keep growing while the error
stagnates; the error must fall from trial to trial as the loop's model promises; learning must not
add to what trials without it would leave. How large noise is follows from the trials themselves: it
is what does not repeat, however coloured, and what v does not explain.
"""

from dataclasses import dataclass
from functools import cached_property
from math import factorial

import control
import numpy as np
import xarray as xr
from scipy.special import fdtrc, stdtr

from ilctools.evidence.convergence import Convergence, convergence
from ilctools.law.io import RESET
from ilctools.law.law import Law
from ilctools.law.limits import realised
from ilctools.loop.closed import ClosedLoop, Loop
from ilctools.models import state_sequence
from ilctools.units import by_unit

# Probability of a false warning by noise, in a test; and where learning adds what it removes.
SIGNIFICANCE, SIGNIFICANCE_OF_HARM = 1e-4, 1e-3
GROWTH = 1.5  # ratio of RMS errors that is worth a warning
RISES = 3  # in succession,
JUMP = 3.0  # or in one trial, relative to the largest RMS before
AMPLIFICATION = 5.0  # largest effect of learning on the noise of a trial
STAGNATION = 0.97  # ratio of RMS errors from which on the error does not fall
STEPS = 3  # of v, from which on it may be said to keep growing
STEADY = 0.9  # share of the first of these steps that each of the others repeats
RELEVANT = 0.2  # smallest change of v, relative to the error
FOLLOWED = 0.5  # share of a predicted change of y; with less, it does not follow w
EXCESS = 0.05  # smallest error beyond the promised one, relative to the first trial's
HARMLESS = 0.5  # share of v, and of the error without it, that repeats
WORSE = 1.1  # ratio of RMS errors with learning and without it, worth a warning
SETTLED = 1.2  # RMS of a trial, relative to that of the last ones, that is the same
ROUNDING = 1e-9  # relative to the largest signal
GRID = np.geomspace(1e-4, 1, 200) * np.pi  # omega Ts of the predicted rate


@dataclass(frozen=True, eq=False)
class History:
    """Trials in order, of the outputs in one unit; signals are (trial, time, channel)."""

    trials: xr.Dataset
    law: Law
    channels: list[int]
    e: np.ndarray
    v: np.ndarray  # of all outputs, as far as it was applied

    @cached_property
    def rms(self) -> np.ndarray:
        """RMS of the error of each trial, summed over the channels."""
        return rms(self.e)

    @cached_property
    def since(self) -> np.ndarray:
        """Index of the first of the trials in succession that have each trial's reference.

        Without reset, not of the first: it is the only one that starts from rest.
        """
        reference = self.trials.reference.values[..., self.channels]
        changes = np.any(np.diff(reference, axis=0) != 0, axis=(1, 2))
        changes[:1] |= RESET in self.trials.attrs
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

    @cached_property
    def effect(self) -> np.ndarray:
        """P v by the model, by which v lowers the error of each trial."""
        return outputs_of(self.P, self.v, self.trials)[..., self.channels]

    @cached_property
    def free(self) -> np.ndarray:
        """The error that each trial would have without v, by the model."""
        return self.e + self.effect

    def number(self, k: int) -> int:
        """Number of trial k."""
        return int(self.trials.trial[k])


def diagnose(trials: xr.Dataset, law: Law, first: int = 2, exact: bool = False) -> dict[str, str]:
    """What the signals of trials say against the convergence of the law that made them.

    Parameters
    ----------
    trials : xarray.Dataset
        Successive trials, as from :func:`ilctools.run_trials`.
    law : Law
        If it is bound to a loop with a model P, predictions are checked, too.
    first : int
        The first trial to be judged, counted from 1.
    exact : bool
        Whether the trials were simulated on the model itself: then it is not checked.

    Returns
    -------
    dict
        The first warning of each kind: "error", "v", "rate", and without these "repetition".
    """
    warnings = {}
    if law.L is None:
        return warnings
    skipped = {"rate"} if exact else set()
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # of 1e200
        for history in histories(trials, law):
            for k in range(max(1, first - 1), len(history.e)):
                for kind, check in CHECKS.items():
                    # learning adds errors for any of the other reasons, too
                    known = warnings if kind == "repetition" else {*warnings} & {kind}
                    text = None if known or kind in skipped else check(history, k)
                    if text:
                        warnings[kind] = text
    return warnings


def histories(trials: xr.Dataset, law: Law) -> list[History]:
    """The trials, split by the units of their outputs."""
    e, reference, v = (trials[name].values for name in ("e", "reference", "v"))
    if law.limits:  # then that for which the loop asks for what was applied
        asked = commands(trials, law.loop, law.actuators)
        v = realised(law.loop, reference + v, **asked) - reference
    groups = by_unit(trials.output_unit.values.tolist()).values()
    return [History(trials, law, group, e[..., group], v) for group in groups]


def commands(trials: xr.Dataset, loop: Loop, actuators=None) -> dict[str, np.ndarray]:
    """What was asked of the actuators, u, and what was applied, shape (trial, time, m)."""
    closed = isinstance(loop, ClosedLoop)
    u = (trials.reference + trials.v if closed else trials.u).values
    applied = u
    if actuators:
        applied = actuators.follow(runs(u, trials)).reshape(u.shape)
    return {"u": u, "applied": trials.applied.values if "applied" in trials else applied}


def runs(signals, trials: xr.Dataset) -> np.ndarray:
    """Signals (trial, time, m) of trials; without reset, as of one trial."""
    return np.concatenate(signals)[None] if RESET in trials.attrs else signals


def outputs_of(model: control.StateSpace, inputs, trials: xr.Dataset) -> np.ndarray:
    """Outputs of a model from rest, before each trial of inputs (trial, time, m) or the first."""
    rest, outputs = np.zeros(model.nstates), []
    for run in runs(inputs, trials):
        x = state_sequence(model.A, run @ model.B.T, rest)
        outputs.append(x @ model.C.T + run @ model.D.T)
    return np.concatenate(outputs).reshape(*inputs.shape[:2], -1)


def error_grows(history: History, k: int) -> str | None:
    """Null hypothesis: errors of the trials with this reference are noise of one variance.

    It is tested where the error rose several times in succession, or to a multiple at once.
    """
    start = history.since[k]
    size = history.rms[start : k + 1]
    largest = np.abs(history.trials.reference.values[k, :, history.channels]).max()
    size = np.maximum(size, ROUNDING * max(largest, *size))
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
        if RESET not in history.trials.attrs and part.sum() > power.sum() / 2:
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
    v = history.v[start : k + 1, :, history.channels]
    steps = np.diff(v, axis=0).reshape(STEPS, -1)
    products = steps @ steps.T / v.shape[1]
    straight_on = products.min() >= STEADY * products[0, 0]
    stagnates = STAGNATION <= error[-1] / error[0] < GROWTH
    relevant = np.sqrt(products.sum()) >= RELEVANT * error[-1]
    if not (straight_on and stagnates and relevant):
        return None
    return (
        f"v{history.of_outputs} keeps growing while the error stagnates: by "
        f"{np.sqrt(products[-1, -1]):.3g} a trial, in one direction, and the RMS of the error is "
        f"{error[0]:.3g} in trial {history.number(start)} and {error[-1]:.3g} in trial "
        f"{history.number(k)}. Is an actuator at its limit? Pass the limits to the law"
    )


def breaks_promise(history: History, k: int) -> str | None:
    """F test, octave by octave, of errors against what an earlier one promises.

    Trial k is compared with the one before and with the best so far, and the second one with the
    first, from which most is to be learned. Null hypothesis: the trials differ from the model's
    prediction by noise alone, independent from trial to trial, by less than the promise allows, or
    by a disturbance that grows from trial to trial.
    """
    first = history.since[k]
    if history.P is None or k < first + 2:
        return None
    changes = np.diff(history.e[first : k + 1], axis=0)
    predicted = -np.diff(history.effect[first : k + 1], axis=0)
    noise, freedom = unexplained(changes, predicted)
    noise = noise + (ROUNDING * np.abs(history.e[k]).max()) ** 2
    best = first + int(history.rms[first:k].argmin())
    for before, trial in ((k - 1, k), (best, k), (first, first + 1)):
        table = error_by_octave(history, trial, before)
        promised = np.maximum(table["bound"], table["predicted"])
        excess = table["before"] * np.maximum(table["measured"] - promised, 0)
        drift = excess / (trial - before)  # of disturbances, if each trial adds as much
        p = chance_of_excess(drift, noise, freedom, k - first)
        worst = np.argmax((p < SIGNIFICANCE) * excess)
        if p[worst] < SIGNIFICANCE and excess[worst] > EXCESS * history.rms[first]:
            break
    else:
        return None
    row = {name: column[worst] for name, column in table.items()}
    power = np.maximum(np.sum(predicted**2, axis=(0, 1)), np.finfo(float).tiny)
    shares = np.sum(changes * predicted, axis=(0, 1)) / power
    moved = ", ".join(map("{1:.2g} in {0}".format, history.names, shares))
    remedy = "measure P (shake), or expect this rate"
    if min(shares) < FOLLOWED:
        limit = "is a sensor or an actuator at its limit, exchanged or reversed?"
        remedy = f"{limit} Else {remedy}"
    return (
        f"the convergence rate is not the predicted one: up to {row['frequency']:.2g} rad/s, "
        f"trial {history.number(trial)} has {row['measured']:.2f} of the error"
        f"{history.of_outputs} of trial {history.number(before)}; the loop's model predicts "
        f"{row['predicted']:.2f}, {row['bound']:.2f} at most, and noise is less. Unless there was "
        "a new disturbance, the plant differs from the model: of the changes that this predicts, "
        f"{moved} came; {remedy}"
    )


def unexplained(changes, predicted) -> tuple[np.ndarray, np.ndarray]:
    """What a gain and a phase for each octave and output cannot explain of changes between trials.

    Signals are (trial, time, channel). Returns the mean square in a trial, by octaves, with its
    degrees of freedom.
    """
    samples = changes.shape[1]
    change, regressor = np.fft.rfft(changes, axis=1), np.fft.rfft(predicted, axis=1)
    edges, harmonics = octaves(samples), change.shape[1]
    covariance = np.sum(regressor.conj() * change, axis=0)
    power = np.sum(np.abs(regressor) ** 2, axis=0)
    covariance, power = (np.add.reduceat(x, edges) for x in (covariance, power))
    gain = covariance / np.maximum(power, np.finfo(float).tiny)
    widths = np.diff(edges, append=harmonics)
    residual = change - np.repeat(gain, widths, axis=0) * regressor
    power = spectrum(np.fft.irfft(residual, samples, axis=1)).mean(axis=0)
    return np.add.reduceat(power.sum(axis=1), edges), degrees_of_freedom(power, edges)


def chance_of_excess(excess, variance, freedom, trials: int) -> np.ndarray:
    """Probability that noise exceeds the prediction so far, in each octave, in any of them.

    The square of the excess has the n degrees of freedom of one trial in this octave; the variance
    from so many changes between trials has that many times n, but for the 2 of a gain and a phase.
    Bonferroni corrects for the number of octaves.
    """
    others = trials * freedom - 2
    F = excess**2 / variance * others / (trials * freedom)
    return len(excess) * fdtrc(freedom, others, F)


def adds_errors(history: History, k: int) -> str | None:
    """t test of the share of what v corrects, by the model, that was there to be corrected.

    It is the regression coefficient, on P v, of what the error would be without v. Null hypothesis:
    it is a half or more, so that learning does not leave more than it removes.
    """
    first = history.since[k]
    if history.P is None or k < first + 2:
        return None
    e, corrected, free = (
        signal[first + 1 : k + 1] for signal in (history.e, history.effect, history.free)
    )
    size = np.linalg.norm(corrected)
    varying = np.linalg.norm(free - free.mean(axis=0)) / np.linalg.norm(free)
    if varying**2 < HARMLESS or mean_rms(e) < WORSE * mean_rms(free):
        return None
    share = np.sum(corrected * free) / size**2
    residual = free - share * corrected
    freedom = len(e) * degrees_of_freedom(spectrum(residual).mean(axis=0)).item()
    deviation = np.linalg.norm(residual) / size / np.sqrt(freedom)
    if stdtr(freedom, (share - HARMLESS) / deviation) >= SIGNIFICANCE_OF_HARM:
        return None
    return (
        f"learning adds to the error{history.of_outputs}: its RMS is {mean_rms(e):.3g} in trials "
        f"{history.number(first + 1)} to {history.number(k)}, and would be {mean_rms(free):.3g} "
        "with v = 0. What disturbs the trials does not repeat: start each at the same phase of it "
        "(pause), or learn less, by a smaller learning gain or a lower cut-off of Q"
    )


CHECKS = {"error": error_grows, "v": v_grows, "rate": breaks_promise, "repetition": adds_errors}


def error_by_octave(history: History, k: int, before: int) -> dict[str, np.ndarray]:
    """The error of trial k relative to that of one before, by octaves up to `frequency`, rad/s.

    `before` is the RMS of that error. Relative to it, `bound` is sigma_max(M) and what Q leaves,
    by e_{k+1} = M e_k + (1 - Q) e_free, for trials without ends; `predicted` follows from the model
    and the v that was recorded, ends included; `measured` is the error of trial k, and `noise` its
    share of white noise, as large as differences between neighbours in time are.
    """
    samples, law, free = len(history.e[k]), history.law, history.free[before]
    first = octaves(samples)
    edges = np.append(first, samples // 2 + 1) * 2 * np.pi / samples
    sigma = history.convergence.sigma
    sigma = np.maximum.reduceat(sigma, np.searchsorted(GRID, edges[:-1]))
    signals = [history.e[before], free - history.effect[k], history.e[k]]
    signals.append(free - law.Q.apply(free))
    power = np.add.reduceat(spectrum(np.array(signals)).sum(axis=-1), first, axis=-1)
    before, predicted, measured, rest = np.sqrt(power)
    before = np.maximum(before, np.finfo(float).tiny)
    white = np.linalg.norm(noise_std(history.e[k]))
    return {
        "frequency": edges[1:] / law.Ts,
        "before": before,
        "bound": 1 - law.gain * (1 - sigma - rest / before),
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
    total, squares = (np.add.reduceat(values.sum(axis=1), edges) for values in (power, power**2))
    return np.maximum(2, 2 * total**2 / np.maximum(squares, np.finfo(float).tiny))


def mean_rms(signals) -> float:
    """Root of the mean square of signals (trial, time, channel), summed over the channels."""
    return np.sqrt(np.mean(rms(signals) ** 2))


def settled(e) -> tuple[int, float, float] | None:
    """From which trial on (index) the error (trial, time, channel) stays, where, and its noise.

    The level is the RMS of the last quarter of the trials, or of three, none of which is SETTLED
    times larger; noise is what differs between successive trials. None if it does not stay.
    """
    size, last = rms(e), max(3, len(e) // 4)
    level = mean_rms(e[-last:])
    outside = np.flatnonzero(size > SETTLED * level)
    first = outside.max(initial=-1) + 1
    if first > len(e) - last:
        return None
    noise = mean_rms(np.diff(e[first:], axis=0)) / np.sqrt(2)
    return first, level, noise


def rms(signals) -> np.ndarray:
    """RMS of each of the signals (trial, time, channel), summed over the channels."""
    return np.sqrt(np.sum(signals**2, axis=2).mean(axis=1))


def noise_std(signals) -> np.ndarray:
    """Standard deviation of white noise in signals (time, channel), from neighbours in time."""
    if len(signals) < 3:
        return np.zeros(signals.shape[1])
    return np.sqrt(np.mean(np.diff(signals, 2, axis=0) ** 2, axis=0) / 6)
