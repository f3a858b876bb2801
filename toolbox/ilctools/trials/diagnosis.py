"""What trials say against convergence: *the error grows*, and *the plant is not the model*.

Without its ends a trial k obeys, with P of the loop and e_free the error without learning,

    e_{k+1} = M e_k + (1 - Q) e_free,    M = Q (I - P L),                                      (1)

so that in each band of frequencies ||e_{k+1}|| <= sigma_max(M) ||e_k|| + ||(1 - Q) e_free||. With
its ends, and with the v that was recorded, the model promises the error

    e_{k+1} = e_free - P v_{k+1},    e_free = e_k + P v_k.                                     (2)

The plant is not the model where errors exceed both, by more than noise explains; the error grows
where its RMS rises by more than noise explains. How large noise is follows from the trials
themselves: it is what does not repeat, however coloured, and what v does not explain.
"""

from functools import partial
from math import factorial

import control
import numpy as np
import xarray as xr
from scipy.special import fdtrc

from ilctools.evidence.convergence import convergence
from ilctools.law.law import Law, Region
from ilctools.law.notes import RESET
from ilctools.singular_values import largest_singular_values
from ilctools.trials.dataset import commands, outputs_of, rms_of, runs
from ilctools.units import by_unit

SIGNIFICANCE = 1e-4  # probability of a false warning by noise, in a test
GROWTH = 1.5  # ratio of RMS errors that is worth a warning,
RISES = 3  # if it rose so many times in succession,
JUMP = 3.0  # or at once, relative to the largest before: one new disturbance is no divergence
AMPLIFICATION = 5.0  # of white noise by learning: errors below it are no growth
EXCESS = 0.05  # smallest error beyond the promised one, relative to the first trial's
ROUNDING = 1e-9  # relative to the largest signal
TINY = np.finfo(float).tiny  # instead of a zero that divides
AXES = ("trial", "time", "channel")
GRID = np.geomspace(1e-4, 1, 200) * np.pi  # omega Ts of the predicted rate


def diagnose(trials: xr.Dataset, law: Law, first: int = 2, exact: bool = False) -> dict[str, str]:
    """What the signals of trials say against the convergence of the law that made them.

    Parameters
    ----------
    trials : xarray.Dataset
        Successive trials, as from :func:`ilctools.run_trials`.
    law : Law
        If its loop has a model P, or else its design a P with a radius, the trials are compared
        with that.
    first : int
        The first trial to be judged, counted from 1.
    exact : bool
        Whether the trials were simulated on the model itself: then it is not checked.

    Returns
    -------
    dict
        The first warning of each kind: "growth" and "model".
    """
    if law.L is None:
        return {}
    warnings, groups = {}, by_unit(trials.output_unit.values.tolist()).values()
    tests = {"growth": error_grows}
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # of 1e200
        if not exact and (P := known_P(law)) is not None:
            trials, sigma = trials.assign(predicted(trials, law, P)), largest_M(law, P)
            tests["model"] = partial(breaks_promise, law, sigma)
        for channels in groups:
            group = trials.isel(channel=channels)
            names = f"{', '.join(group.output.values)}: " if len(groups) > 1 else ""
            for k, since in enumerate(successions(group)):
                alike = group.isel(trial=slice(since, k + 1))
                for kind, test in tests.items() if first - 1 <= k > since else ():
                    text = "" if kind in warnings else test(alike)
                    warnings |= {kind: names + text} if text else {}
    return warnings


def successions(trials: xr.Dataset) -> np.ndarray:
    """Index of the first of the trials in succession that have each trial's reference.

    Without reset, not of the first: it is the only one that starts from rest.
    """
    changes = np.any(np.diff(trials.reference.values, axis=0), axis=(1, 2))
    changes[:1] |= RESET in trials.attrs
    first = np.arange(trials.sizes["trial"]) * np.append(True, changes)
    return np.maximum.accumulate(first)


def applied_v(trials: xr.Dataset, law: Law) -> np.ndarray:
    """v (trial, time, m) as far as it was applied."""
    if not law.limits:
        return trials.v.values
    v, _ = law.applied(trials.v.values, **commands(trials, law.loop, law.actuators))
    return v


def error_grows(trials: xr.Dataset) -> str:
    """Null hypothesis: errors of trials with one reference are noise of one variance.

    It is tested where the error rose several times in succession up to the last trial, or to a
    multiple at once.
    """
    e, numbers = trials.e.values, trials.trial.values
    size = rms_of(trials.e).values
    size = np.maximum(size, ROUNDING * max(np.abs(trials.reference.values).max(), *size))
    before = np.flatnonzero(np.append(True, size[1:] <= size[:-1]))[-1]  # since then it rises
    rises, least = len(size) - 1 - before, GROWTH
    if rises < RISES:
        before, rises, least = size[:-1].argmax(), 1, JUMP
    growth, noise = size[-1] / size[before], AMPLIFICATION * np.linalg.norm(noise_std(e[0]))
    freedom = degrees_of_freedom(spectrum(e[-1] - e[-2])).item()
    if growth < least or size[-1] < noise or chance(growth, freedom, rises + 1) >= SIGNIFICANCE:
        return ""
    return (
        "the error grows, by more than noise explains: its RMS was "
        f"{size[before]:.3g} in trial {numbers[before]} and is {size[-1]:.3g} in trial "
        f"{numbers[-1]}. Unless there was a new disturbance, the law diverges, or the plant "
        "differs from the model: measure P (shake), or learn less, by a lower cut-off of Q or a "
        "smaller learning gain. With sigma_max(M) below 1 the ends of a trial may be the cause: "
        "bound L (L_max) so that trial_norm is below 1, too, or let reference and v rest there"
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


def known_P(law: Law) -> control.StateSpace | Region | None:
    """The model of the law's loop; without one, P of its design and the radius."""
    model = None if law.loop is None else law.loop.P
    return law.region if model is None else model


def predicted(trials: xr.Dataset, law: Law, P: control.StateSpace | Region) -> dict:
    """P v, by which v lowers the error, and by how much it may be off where P has a radius."""
    v = applied_v(trials, law)
    if isinstance(P, Region):
        effect, spread = P.outputs(runs(v, trials), law.Ts).reshape(2, *v.shape)
    else:
        effect, spread = outputs_of(P, v, trials), np.zeros_like(v)
    return {"effect": (AXES, effect), "spread": (("trial", "time", "input"), spread)}


def largest_M(law: Law, P: control.StateSpace | Region) -> np.ndarray:
    """sigma_max(M) on GRID, at most where P has a radius."""
    omega, radius = GRID / law.Ts, 0.0
    if isinstance(P, Region):
        P, radius = P.on(omega)
    rate = convergence(P, law.Q, law.L, omega)
    _, Q, L = rate.responses
    return rate.sigma + np.abs(Q) * radius * largest_singular_values(L)


def breaks_promise(law: Law, sigma, trials: xr.Dataset) -> str:
    """F test, octave by octave, of errors against what an earlier one promises.

    The last trial is compared with the one before and with the best so far, and the second one with
    the first, from which most is to be learned. Null hypothesis: the trials differ from the model's
    prediction by noise alone, independent from trial to trial, by less than the promise allows, or
    by a disturbance that grows from trial to trial.
    """
    e, size, last = trials.e.values, rms_of(trials.e).values, trials.sizes["trial"] - 1
    if last < 2:  # noise is known from two changes on
        return ""
    changes, predicted = np.diff(e, axis=0), -np.diff(trials.effect.values, axis=0)
    noise, freedom = unexplained(changes, predicted)
    noise = noise + (ROUNDING * np.abs(e[last]).max()) ** 2
    for before, trial in ((last - 1, last), (size[:last].argmin(), last), (0, 1)):
        errors = errors_by_octave(law, sigma, trials, trial, before)
        promised = np.maximum(errors["bound"], errors["predicted"])
        excess = errors["before"] * np.maximum(errors["measured"] - promised, 0)
        drift = excess / (trial - before)  # of disturbances, if each trial adds as much
        p = chance_of_excess(drift, noise, freedom, last)
        significant = (p < SIGNIFICANCE) * excess
        worst = significant.argmax()
        if significant[worst] > EXCESS * size[0]:
            numbers = trials.trial.values[[before, trial]]
            octave = {name: values[worst] for name, values in errors.items()}
            return _broken(*numbers, octave, _came(changes, predicted, trials.output.values))
    return ""


def _came(changes, predicted, names):
    """Which share of the predicted changes came, in words."""
    pairs = zip(changes.T, predicted.T, names, strict=True)
    return ", ".join(
        f"{np.vdot(p, change) / max(TINY, np.vdot(p, p)):.2g} in {name}"
        for change, p, name in pairs
    )


def _broken(before, trial, octave, came):
    """The warning, of the errors of two trials in one octave."""
    return (
        f"the convergence rate is not the predicted one: up to {octave['frequency']:.2g} rad/s, "
        f"trial {trial} has {octave['measured']:.2f} of the error of trial "
        f"{before}; the model predicts {octave['predicted']:.2f}, {octave['bound']:.2f} at "
        "most, and noise is less. Unless there was a new disturbance, the plant differs from the "
        f"model: of the changes that this predicts, {came} came; is a sensor or an actuator at its "
        "limit, exchanged or reversed? Else measure P (shake), or expect this rate"
    )


def unexplained(changes, predicted) -> tuple[np.ndarray, np.ndarray]:
    """What a gain and a phase for each octave and output cannot explain of changes between trials.

    Signals are (trial, time, channel). Returns the mean square in a trial, by octaves, with its
    degrees of freedom.
    """
    samples = changes.shape[1]
    edges = octaves(samples)
    Y, X = np.fft.rfft(changes, axis=1), np.fft.rfft(predicted, axis=1)
    XY, XX = (np.add.reduceat(np.sum(X.conj() * Z, axis=0), edges) for Z in (Y, X))
    gain = np.repeat(XY / np.maximum(XX.real, TINY), np.diff(edges, append=Y.shape[1]), axis=0)
    power = spectrum(np.fft.irfft(Y - gain * X, samples, axis=1)).mean(axis=0)
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


def errors_by_octave(
    law: Law, sigma, trials: xr.Dataset, k: int, before: int
) -> dict[str, np.ndarray]:
    """The error of trial k relative to that of one before, by octaves up to `frequency`, rad/s.

    `before` is the RMS of that error. Relative to it, `bound` is sigma_max(M) and what Q leaves,
    by (1); `predicted` follows from (2), ends included; `measured` is the error of trial k.
    """
    e, effect, spread = (trials[name].values for name in ("e", "effect", "spread"))
    samples = e.shape[1]
    first = octaves(samples)
    edges = np.append(first, samples // 2 + 1) * 2 * np.pi / samples
    sigma = np.maximum.reduceat(sigma, np.searchsorted(GRID, edges[:-1]))

    def size(signal):
        return np.sqrt(np.add.reduceat(spectrum(signal).sum(axis=-1), first))

    free = e[before] + effect[before]  # the error without v
    error = np.maximum(size(e[before]), TINY)
    kept = size(free - law.Q.apply(free))  # (1 - Q) e_free
    return {
        "frequency": edges[1:] / law.Ts,
        "before": error,
        "bound": 1 - law.gain + law.gain * (sigma + kept / error),  # (1)
        "predicted": (size(free - effect[k]) + size(spread[k] - spread[before])) / error,  # (2)
        "measured": size(e[k]) / error,
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
    return np.maximum(2, 2 * total**2 / np.maximum(squares, TINY))


def noise_std(signals) -> np.ndarray:
    """Standard deviation of white noise in signals (time, channel), from neighbours in time."""
    bends = np.diff(signals, 2, axis=0)
    return np.sqrt(np.sum(bends**2, axis=0) / (6 * max(1, len(bends))))
