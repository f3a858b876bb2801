"""What trials say against convergence: *the error grows*, and *the plant is not the model*.

Without its ends a trial k obeys, with P of the loop and e_free the error without learning,

    e_{k+1} = M e_k + (1 - Q) e_free,    M = Q (I - P L),                                      (1)

so that in each band of frequencies ||e_{k+1}|| <= sigma_max(M) ||e_k|| + ||(1 - Q) e_free||. With
its ends, and with the v that was recorded, the model promises the error

    e_{k+1} = e_free - P v_{k+1},    e_free = e_k + P v_k.                                     (2)

The plant is not the model where errors exceed both, by more than noise explains; the error grows
where it rises by more than noise explains, or where v adds more to it than it removes. How large
noise is follows from the trials themselves: it is what does not repeat, however coloured, and what
v does not explain.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import factorial

import control
import numpy as np
import xarray as xr
from scipy.special import fdtrc

from ilctools.evidence.convergence import Convergence, convergence
from ilctools.evidence.finite import trial_norm
from ilctools.filters import LearningFilter
from ilctools.law.io import RESET
from ilctools.law.law import Law, Region
from ilctools.loop.closed import Loop
from ilctools.models import state_sequence
from ilctools.singular_values import largest_singular_values
from ilctools.units import by_unit

SIGNIFICANCE = 1e-4  # probability of a false warning by noise, in a test
GROWTH = 1.5  # ratio of RMS errors that is worth a warning,
RISES = 3  # if it rose so many times in succession,
JUMP = 3.0  # or at once, relative to the largest before: one new disturbance is no divergence
AMPLIFICATION = 5.0  # of white noise by learning: errors below it are no growth
EXCESS = 0.05  # smallest error beyond the promised one, relative to the first trial's
ROUNDING = 1e-9  # relative to the largest signal
TINY = np.finfo(float).tiny  # instead of a zero that divides
GRID = np.geomspace(1e-4, 1, 200) * np.pi  # omega Ts of the predicted rate


@dataclass(frozen=True, eq=False)
class History:
    """Trials in order, of the outputs in one unit; signals are (trial, time, channel)."""

    trials: xr.Dataset
    law: Law
    channels: list[int]
    e: np.ndarray
    v: np.ndarray  # of all outputs, as far as it was applied
    exact: bool = False  # whether simulated on the model of the law's loop

    @cached_property
    def rms(self) -> np.ndarray:
        """RMS of the error of each trial, summed over the channels."""
        return np.sqrt(np.sum(self.e**2, axis=2).mean(axis=1))

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
    def P(self) -> control.StateSpace | Region | None:
        """Model of the law's loop; without one, P of the law's design and its radius."""
        model = None if self.law.loop is None else self.law.loop.P
        return self.law.region if model is None else model

    @cached_property
    def convergence(self) -> Convergence:
        """The rate that P predicts, at most where it has a radius."""
        Q, L, omega, P, radius = self.law.Q, self.law.L, GRID / self.law.Ts, self.P, 0.0
        if isinstance(P, Region):
            P, radius = P.on(omega)
        nominal = convergence(P, Q, L, omega)
        _, Q, L = nominal.responses
        sigma = nominal.sigma + np.abs(Q) * radius * largest_singular_values(L)
        return replace(nominal, sigma=sigma, gamma=sigma.max())

    @cached_property
    def effect(self) -> np.ndarray:
        """P v, by which v lowers the error of each trial."""
        return outputs_of(self.P, self.v, self.trials)[..., self.channels]

    @cached_property
    def free(self) -> np.ndarray:
        """The error that each trial would have without v, by the model."""
        return self.e + self.effect

    @cached_property
    def at_ends(self) -> str:
        """What the ends of a trial do by the model, in words, if v need not converge there."""
        L, law = self.law.L, self.law
        known = isinstance(self.P, control.StateSpace) and isinstance(L, LearningFilter)
        known = known and not law.limits
        if not known or RESET in self.trials.attrs:
            return ""
        samples = self.trials.sizes["time"]
        norm, *_ = trial_norm(self.P, law.Q, L, samples, rest=law.rest)
        if norm < 1:
            return ""
        return (
            f". By the loop's model a trial of {samples} samples, with its ends, may multiply what "
            f"is wrong with v by {norm:.3g}, its trial_norm: bound L (L_max) so that it is below 1"
        )

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
    warnings = {}
    if law.L is None:
        return warnings
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # of 1e200
        for history in histories(trials, law, exact):
            for k in range(max(1, first - 1), len(history.e)):
                if "growth" not in warnings:
                    warnings["growth"] = error_grows(history, k)
                if "model" not in warnings and not exact:
                    warnings["model"] = breaks_promise(history, k)
                warnings = {kind: text for kind, text in warnings.items() if text}
    return warnings


def histories(trials: xr.Dataset, law: Law, exact: bool = False) -> list[History]:
    """The trials, split by the units of their outputs."""
    e, v = trials.e.values, trials.v.values
    if law.limits:  # then that for which the loop asks for what was applied
        asked = commands(trials, law.loop, law.actuators)
        v = law.loop.realised(v, **asked)
    groups = by_unit(trials.output_unit.values.tolist()).values()
    return [History(trials, law, group, e[..., group], v, exact) for group in groups]


def commands(trials: xr.Dataset, loop: Loop, actuators=None) -> dict[str, np.ndarray]:
    """What was asked of the actuators, u, and what was applied, shape (trial, time, m)."""
    recorded = trials.u.values if "u" in trials else None
    u = applied = loop.asked((trials.reference + trials.v).values, recorded)
    if "applied" in trials:
        applied = trials.applied.values
    elif actuators is not None:
        applied = actuators.follow(runs(u, trials)).reshape(u.shape)
    return {"u": u, "applied": applied}


def runs(signals, trials: xr.Dataset) -> np.ndarray:
    """Signals (trial, time, m) of trials; without reset, as of one trial."""
    return np.concatenate(signals)[None] if RESET in trials.attrs else signals


def outputs_of(model: control.StateSpace | Region, inputs, trials: xr.Dataset) -> np.ndarray:
    """Outputs of a model from rest, before each trial of inputs (trial, time, m) or the first."""
    if isinstance(model, Region):
        outputs = [model.outputs(run, trials.Ts)[0] for run in runs(inputs, trials)]
        return np.concatenate(outputs).reshape(inputs.shape)
    rest, outputs = np.zeros(model.nstates), []
    for run in runs(inputs, trials):
        x = state_sequence(model.A, run @ model.B.T, rest)
        outputs.append(x @ model.C.T + run @ model.D.T)
    return np.concatenate(outputs).reshape(*inputs.shape[:2], -1)


def error_grows(history: History, k: int) -> str:
    """Null hypothesis: errors of the trials with this reference are noise of one variance.

    It is tested where the error rose several times in succession, or to a multiple at once.
    """
    start = history.since[k]
    size = history.rms[start : k + 1]
    largest = np.abs(history.trials.reference.values[k, :, history.channels]).max()
    size = np.maximum(size, ROUNDING * max(largest, *size))
    lowest = np.flatnonzero(np.append(True, size[1:] <= size[:-1]))[-1]
    rises, growth = len(size) - 1 - lowest, size[-1] / size[lowest]
    noise = AMPLIFICATION * np.linalg.norm(noise_std(history.e[0]))
    if not rises or growth < GROWTH or size[-1] < noise:
        return ""
    freedom = degrees_of_freedom(spectrum(history.e[k] - history.e[k - 1])).item()
    jump = size[-1] / size[:-1].max()
    in_succession = rises >= RISES and chance(growth, freedom, rises + 1) < SIGNIFICANCE
    at_once = jump >= JUMP and chance(jump, freedom, 2) < SIGNIFICANCE
    if not (in_succession or at_once):
        return ""
    return (
        f"the error{history.of_outputs} grows, by more than noise explains: its RMS was "
        f"{size[lowest]:.3g} in trial {history.number(start + lowest)} and is "
        f"{size[-1]:.3g} in trial {history.number(k)}. {_where_and_why(history, k)}"
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


def _where_and_why(history, k):
    """At which end of the trial the error grows; or what the model predicts."""
    power = np.sum(history.e[k] ** 2, axis=1)
    tenth = max(1, len(power) // 10)
    for part, name in ((power[:tenth], "first"), (power[-tenth:], "last")):
        if RESET not in history.trials.attrs and part.sum() > power.sum() / 2:
            return (
                f"Most of it is in the {name} tenth of the trial, where the filters need "
                "signals beyond its ends: let reference or v rest there, or choose other "
                f"ends of Q and L{history.at_ends}"
            )
    predicted = ""
    if history.P is not None:
        predicted = f"By the model sigma_max(M) <= {history.convergence.gamma:.3g}"
        if history.exact and history.convergence.gamma < 1:
            return (
                f"{predicted}: unless there was a new disturbance, the ends of the trial are the "
                f"cause{history.at_ends}"
            )
        predicted += ". "
    return (
        f"{predicted}Unless there was a new disturbance, the law diverges, or the plant differs "
        "from the model: measure P (shake), or learn less, by a lower cut-off of Q or a smaller "
        f"learning gain{history.at_ends}"
    )


def breaks_promise(history: History, k: int) -> str:
    """F test, octave by octave, of errors against what an earlier one promises.

    Trial k is compared with the one before and with the best so far, and the second one with the
    first, from which most is to be learned. Null hypothesis: the trials differ from the model's
    prediction by noise alone, independent from trial to trial, by less than the promise allows, or
    by a disturbance that grows from trial to trial.
    """
    first = history.since[k]
    if history.P is None or k < first + 2:  # noise is known from two changes on
        return ""
    changes = np.diff(history.e[first : k + 1], axis=0)
    predicted = -np.diff(history.effect[first : k + 1], axis=0)
    noise, freedom = unexplained(changes, predicted)
    noise = noise + (ROUNDING * np.abs(history.e[k]).max()) ** 2
    best = first + history.rms[first:k].argmin()
    for before, trial in ((k - 1, k), (best, k), (first, first + 1)):
        table = error_by_octave(history, trial, before)
        promised = np.maximum(table["bound"], table["predicted"])
        excess = table["before"] * np.maximum(table["measured"] - promised, 0)
        drift = excess / (trial - before)  # of disturbances, if each trial adds as much
        p = chance_of_excess(drift, noise, freedom, k - first)
        significant = (p < SIGNIFICANCE) * excess
        worst = significant.argmax()
        if significant[worst] > EXCESS * history.rms[first]:
            row = {name: column[worst] for name, column in table.items()}
            return _broken_promise(history, trial, before, row, changes, predicted)
    return ""


def _broken_promise(history, trial, before, row, changes, predicted):
    """The warning, from a row of the errors by octave, and which share of the changes came."""
    power = np.maximum(np.sum(predicted**2, axis=(0, 1)), TINY)
    shares = np.sum(changes * predicted, axis=(0, 1)) / power
    pairs = zip(shares, history.names, strict=True)
    came = ", ".join(f"{share:.2g} in {name}" for share, name in pairs)
    return (
        f"the convergence rate is not the predicted one: up to {row['frequency']:.2g} rad/s, "
        f"trial {history.number(trial)} has {row['measured']:.2f} of the error"
        f"{history.of_outputs} of trial {history.number(before)}; the model predicts "
        f"{row['predicted']:.2f}, {row['bound']:.2f} at most, and noise is less. Unless there was "
        "a new disturbance, the plant differs from the model: of the changes that this predicts, "
        f"{came} came; is a sensor or an actuator at its limit, exchanged or reversed? Else "
        "measure P (shake), or expect this rate"
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
    gain = covariance / np.maximum(power, TINY)
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


def error_by_octave(history: History, k: int, before: int) -> dict[str, np.ndarray]:
    """The error of trial k relative to that of one before, by octaves up to `frequency`, rad/s.

    `before` is the RMS of that error. Relative to it, `bound` is sigma_max(M) and what Q leaves,
    by (1); `predicted` follows from (2), ends included; `measured` is the error of trial k, and
    `noise` its share of white noise, as large as differences between neighbours in time are.
    """
    samples, law, free = len(history.e[k]), history.law, history.free[before]
    first = octaves(samples)
    edges = np.append(first, samples // 2 + 1) * 2 * np.pi / samples
    sigma = np.maximum.reduceat(history.convergence.sigma, np.searchsorted(GRID, edges[:-1]))

    def size(signal):
        return np.sqrt(np.add.reduceat(spectrum(signal).sum(axis=-1), first))

    error = np.maximum(size(history.e[before]), TINY)
    kept = size(free - law.Q.apply(free))  # (1 - Q) e_free
    slack, P = 0.0, history.P
    if isinstance(P, Region):
        slack = size(P.outputs(history.v[k] - history.v[before], law.Ts)[1])
    noise = np.linalg.norm(noise_std(history.e[k])) * np.sqrt(np.diff(edges) / edges[-1])
    return {
        "frequency": edges[1:] / law.Ts,
        "before": error,
        "bound": 1 - law.gain + law.gain * (sigma + kept / error),  # (1)
        "predicted": (size(free - history.effect[k]) + slack) / error,  # (2)
        "measured": size(history.e[k]) / error,
        "noise": noise / error,
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
    if len(signals) < 3:
        return np.zeros(signals.shape[1])
    return np.sqrt(np.mean(np.diff(signals, 2, axis=0) ** 2, axis=0) / 6)
