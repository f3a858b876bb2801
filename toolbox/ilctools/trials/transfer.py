"""Another task tomorrow: the first ILC signal of a new reference, from the trials of others.

By (30), y_k = P (r + v_k) + P~ d in any trial, converged or not, so that with e_k = r - y_k

    v_k + e_k = F y_k + c,    F = P^-1 - I,    c = -P^-1 P~ d:

what v would have to be if y_k were the reference. F is the plant's; c compensates a repeating
disturbance; any reference r needs v = F r + c. No model of P enters.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from operator import attrgetter
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import fdtrc

from ilctools import arguments
from ilctools.signals import Signals, check_match, period_of
from ilctools.trials.diagnosis import degrees_of_freedom, spectrum

GROWTH = 1.5  # from one lag of F to the next
DECAY = 2.0  # a priori, entries of F fall as 1 / |lag|^DECAY
WEIGHTS = 10.0 ** np.arange(-10, 1)  # of this prior, in mean squares of the regressors
STATIC = 1e6  # times the weight of F(0), for F(0) = 0, as if P(0) = I
PENALTY = 2.0  # by which F(0) /= 0 must improve the likelihood of each trial
ROUNDING = 1e-14  # of the power
BLOCKS = 5  # of time, for cross-validation
RATIOS = 10.0 ** -np.arange(0, 7)  # candidates for the ratio of variances
AXES = ("trial", "time", "channel")
# When to warn:
PREDICTED = 0.9  # least share of v + e
UNCERTAIN = 0.2  # largest share of v
SIGNIFICANCE = 1e-3  # probability that one plant seems to be two, by noise
CONTRADICTS = 0.1  # smallest error of v in hold-out, relative to v + e, that is said
UNSEEN = 1e3  # power of a reference, relative to that of all earlier ones, in a band
UNSEEN_SHARE = 0.1  # of the power of a reference, in such bands
BANDS = 25


@dataclass(frozen=True, eq=False)
class Transfer:
    """Where to begin with another reference. Signals have the shape (time, m).

    The uncertainty is the jackknife's, by fits without one block of time each, together with the
    distance to the fit by differences between trials alone.
    """

    v: np.ndarray  # ILC signal of the first trial, feedforward + compensation
    feedforward: np.ndarray  # F r
    compensation: np.ndarray  # c, of a repeating disturbance
    F: np.ndarray  # (m, m, 2 R + 1): impulse response, from R samples ahead to R back
    predicted: np.ndarray  # (m,): share of v_k + e_k, in cross-validation
    uncertainty: np.ndarray  # (m,): RMS by which v may be off
    # (K, m): RMS by which F and c of the other trials miss v + e, relative
    held_out: np.ndarray


def transfer(trials: xr.Dataset | Sequence[xr.Dataset], reference) -> Transfer:
    """Compute the first ILC signal of another task from trials of one task or of several.

    Parameters
    ----------
    trials : xarray.Dataset or list of them
        From :func:`run_trials`, :func:`record` or :func:`load_log`, of one loop, under the same
        disturbance, of the same length. All count, the first most of all. Where actuators cut off,
        with v as :func:`ilctools.law.limits.realised` has it.
    reference : array_like, shape (time, m)
        Of the new task, of any length; beyond the end of the trials the compensation is zero.

    Warns
    -----
    UserWarning
        If F and c predict little of the trials; if one plant does not explain all of them; if v
        may be worse than zero; if the trials leave v uncertain, as one alone does; if the reference
        has power where the earlier ones had little.

    See Also
    --------
    run_trials : what takes its v
    record : trials on a rig

    Notes
    -----
    Each row of F is a ridge regression. Lags grow geometrically up to half a trial, with straight
    lines between, and are weighted as slopes, (y(p - l) - y(p)) / l^2. c is a random effect: the
    mean over K trials has the variance s_w^2 / K + s_c^2, deviations from it have s_w^2 (P.
    Balestra and M. Nerlove, Econometrica 34 (1966) 585-612). So differences between trials
    distinguish c from F r: v within a task, and the reference between tasks. With one plant, the
    residuals of two trials are independent; with another they are alike, by an F test of their sum
    against their difference, with one false alarm in 1,000 calls for each output. The weight, the
    ratio of the variances, and whether F(0) = 0, as if P(0) = I, have the largest likelihood in
    cross-validation over blocks of time. By kernels, with one trial: L. Blanken and T. Oomen,
    Automatica 114 (2020) 108830.

    Examples
    --------
    >>> import control
    >>> A, B = [[1, 0.01], [0, 1]], [[0], [0.01]]  # a mass of 1 kg, F in N, x in m
    >>> stage = control.ss(A, B, [[1, 0]], 0, 0.01, inputs=["F"], outputs=["x"])
    >>> import numpy as np
    >>> from ilctools import current_trial_loop, rms, run_trials
    >>> from ilctools import synthesise, transfer, zero_phase_butterworth
    >>> loop = current_trial_loop(stage, ["F"])
    >>> law = synthesise(loop, zero_phase_butterworth(2, 10.0, 0.01)).law(rest=15)
    >>> up = np.sin(np.pi * np.clip(np.arange(400)[:, None] / 300, 0, 1)) ** 4
    >>> trials, new = run_trials(loop, law, up, trials=5), up[::-1]  # the task, backwards
    >>> v = transfer(trials, new).v
    >>> first, zero = (run_trials(loop, law, new, trials=1, v=u) for u in (v, 0 * v))
    >>> bool(rms(first.e) < 0.1 * rms(zero.e))
    True
    """
    v, y, references, outputs, Ts, labels = _signals(trials)
    K, N, m = y.shape
    reference = arguments.in_columns("reference", reference, ("time", m), outputs)
    size = np.sqrt(np.mean(y**2, axis=(0, 1)))
    size[size == 0] = 1.0
    basis = _basis(max(1, N // 2))
    targets = references + v - y
    columns = [
        np.hstack([_taps(output / size, basis), target])
        for output, target in zip(y, targets, strict=True)
    ]
    products = [_products(trial) for trial in columns]
    regression = _Regression(columns, products, m)
    without_one = [
        _Regression(columns[:k] + columns[k + 1 :], products[:k] + products[k + 1 :], m)
        for k in range(K)
        if K > 1
    ]

    X = _taps(reference / size, basis)
    p = X.shape[1]
    past = np.zeros((len(reference), p + m))
    past[:N] = regression.center[: len(reference)]
    X_past = past[:, :p]
    rows, compensation = np.zeros((m, p)), np.zeros_like(reference)
    predicted, uncertainty = np.zeros((2, m))
    held_out, messages = np.zeros((K, m)), []
    fits = regression.fits(RATIOS if K > 1 else RATIOS[:1])
    by_differences = regression.fits([0.0])  # between trials, alone
    for i, (fit, differences) in enumerate(zip(fits, by_differences, strict=True)):
        rows[i], predicted[i] = fit.row, fit.predicted
        target, weight = past[:, p + i], 1 - fit.ratio
        compensation[:, i] = weight * (target - X_past @ fit.row)
        deviations = (X - weight * X_past) @ (fit.without - fit.row).T
        jackknife = (1 - 1 / BLOCKS) * np.sum(deviations**2, axis=1)
        other_v = target + (X - X_past) @ differences.row
        distance = other_v - X @ fit.row - compensation[:, i]
        uncertainty[i] = np.sqrt(np.mean(jackknife + distance**2))
        for k, others in enumerate(without_one):
            row = others.row(i, fit)
            missed = np.linalg.norm(others.missed(columns[k], i, row, fit.ratio))
            of_target = np.linalg.norm(targets[k, :, i])
            held_out[k, i] = missed / max(of_target, np.finfo(float).tiny)
        residuals = np.array([regression.missed(trial, i, fit.row, fit.ratio) for trial in columns])
        messages += _contradictions(residuals, held_out[:, i], outputs[i], labels)

    feedforward, v = X @ rows.T, X @ rows.T + compensation
    F = (rows.reshape(m, m, -1) / size[:, None]) @ basis.T
    result = Transfer(v, feedforward, compensation, F, predicted, uncertainty, held_out)
    for i, name in enumerate(outputs):
        unseen = _unseen(reference[:, i], references[:, :, i], Ts)
        messages += _warnings(result, i, name, *unseen)
    for message in messages:
        warnings.warn(message, stacklevel=2)
    return result


def _signals(trials):
    """v, y and reference of all trials, names of the outputs, Ts, and names of the trials."""
    tasks = trials if isinstance(trials, list | tuple) and trials else [trials]
    signals, periods, labels = {"v": [], "y": [], "reference": []}, {}, []
    for i, task in enumerate(tasks):
        task = arguments.instance("trials", task, xr.Dataset)
        task = task if "trial" in task.dims else task.expand_dims("trial")
        if not all(name in task and {*task[name].dims} == {*AXES} for name in signals):
            raise ValueError(f"trials lack one of {[*signals]}, or its axes: see run_trials")
        period = period_of(task)
        periods[f"trials[{i}]"] = Signals(period)
        numbers = np.arange(1, task.sizes["trial"] + 1)
        where = f" of trials[{i}]" if len(tasks) > 1 else ""
        labels += [f"{k}{where}" for k in task.get("trial", numbers).values]
        if not i:
            outputs = arguments.names_of(task.y) or [*task.channel.values]
            shape = "trial", task.sizes["time"], task.sizes["channel"]
        for name, arrays in signals.items():
            array = task[name].transpose(*AXES)
            arrays.append(arguments.in_columns(f"trials.{name}", array, shape, outputs))
    check_match(**periods)
    v, y, references = (np.concatenate(arrays) for arrays in signals.values())
    return v, y, references, outputs, period, labels


def _basis(reach):
    """Taps of F, shape (lags, taps): slopes between lag 0 and others, and lag 0 by itself."""
    knots = [0, 1]
    while knots[-1] < reach:
        knots.append(min(reach, max(knots[-1] + 1, round(GROWTH * knots[-1]))))
    knots = np.array([-k for k in knots[:0:-1]] + knots)
    lags, middle = np.arange(-reach, reach + 1), len(knots) // 2
    hats = np.array([np.interp(lags, knots, one) for one in np.eye(len(knots))]).T
    hats /= hats.sum(axis=0)
    slopes = (hats - hats[:, [middle]]) / np.maximum(np.abs(knots), 1) ** DECAY
    slopes[:, middle] = hats[:, middle] / reach
    return slopes


def _taps(signal, basis):
    """A signal (time, m) by each tap, shape (time, m taps); constant beyond its ends."""
    ends = len(basis) // 2
    extended = np.pad(signal, [(ends, ends), (0, 0)], mode="edge")
    count = next_fast_len(len(extended), real=True)  # the ends that wrap are not kept
    by_tap = rfft(extended, count, axis=0)[..., None] * rfft(basis, count, axis=0)[:, None]
    taps = irfft(by_tap, count, axis=0)[2 * ends :][: len(signal)]
    return taps.reshape(len(signal), -1)


class _Fit(NamedTuple):
    without: np.ndarray  # (blocks, p): rows of F by taps, without each block of time
    ratio: float = 1.0  # of variances, s_w^2 / (s_w^2 + K s_c^2)
    predicted: float = 1.0  # share of the target, in cross-validation
    chosen: tuple = (1.0, 1.0, 1.0)  # ratio, factor and weight of the prior
    likelihood: float = 0.0  # its logarithm
    row: np.ndarray | None = None  # (p,): of all blocks


class _Regression:
    """Products of p regressors and m targets in each block, shape (blocks, p + m, p + m)."""

    def __init__(self, columns, products, m):
        self.K, self.m = len(columns), m
        self.center = sum(columns) / self.K  # the mean of the trials' columns
        self.mean = self.K * _products(self.center)
        # of the deviations of K trials from their mean
        self.within = sum(products) - self.mean

    def missed(self, trial, i, row, ratio):
        """What a row of F and c of these trials miss of v + e in the columns of a trial."""
        p = len(row)
        own, common = (x[:, p + i] - x[:, :p] @ row for x in (trial, self.center))
        return own - (1 - ratio) * common

    def row(self, i, fit):
        """Row i of F, with the prior that was chosen in a fit, to these trials or to others."""
        ratio, static, weight = fit.chosen
        return self._ridge(ratio, static, np.array([weight]), slice(1))[0, 0, :, i]

    def fits(self, ratios) -> list[_Fit]:
        """The most likely rows of F: their weights, their F(0), and the ratio of the variances."""
        fits = [[] for _ in range(self.m)]
        for ratio, static in product(ratios, (1.0, STATIC)):
            without = self._ridge(ratio, static, WEIGHTS, slice(1, None))  # of all outputs
            for i, found in enumerate(fits):
                found.append(self._likeliest(i, without[..., i], ratio, static))
        best = [max(found, key=attrgetter("likelihood")) for found in fits]
        return [fit._replace(row=self.row(i, fit)) for i, fit in enumerate(best)]

    def _likeliest(self, i, without, ratio, static):
        """The most likely weight, by rows i of F without each block, (weights, blocks, p)."""
        p = without.shape[-1]
        power = (self.within + self.mean)[:, p + i, p + i].sum()
        if not power > 0:
            return _Fit(np.zeros((BLOCKS, p)))
        within, mean = (
            _squares(products, without, i) + ROUNDING * power
            for products in (self.within, self.mean)
        )
        likelihood = -(self.K - 1) * np.log(within) - np.log(mean)
        if static == 1:
            likelihood -= self.K * np.log(PENALTY)
        best = likelihood.argmax()
        chosen, within, mean = (ratio, static, WEIGHTS[best]), within[best], mean[best]
        ratio = min(1.0, within / (self.K - 1) / mean) if self.K > 1 else 1.0
        total = (self.within + ratio * self.mean)[:, p + i, p + i].sum()
        predicted = 1 - (within + ratio * mean) / total
        return _Fit(without[best], ratio, predicted, chosen, likelihood[best])

    def _ridge(self, ratio, static, weights, kept):
        """Rows of F by weights, (weights, kept, p, m); of 1 + blocks: of all, without each."""
        p = self.mean.shape[1] - self.m
        products = self.within + ratio * self.mean
        total = products.sum(axis=0)
        sums = np.concatenate([total[None], total - products])[kept]
        floor = ROUNDING * np.trace(self.mean.sum(axis=0)[:p, :p]) / p or 1.0
        prior = np.ones((self.m, p // self.m))
        prior[:, prior.shape[1] // 2] = static
        size = floor + weights * np.trace(total[:p, :p]) / p
        normal = np.repeat(sums[None, :, :p, :p], len(weights), axis=0)
        diagonals = np.einsum("wbpp->wbp", normal)
        diagonals += np.multiply.outer(size, prior.ravel())[:, None]
        return np.linalg.solve(normal, sums[:, :p, p:])


def _contradictions(residuals, held_out, name, labels):
    """Trials that one plant does not explain, and whether v = 0 would do as well."""
    freedom = degrees_of_freedom(spectrum(residuals[..., None]).mean(axis=0)).item()
    one, other = np.triu_indices(len(residuals), 1)
    sums, differences = (
        np.sum((residuals[one] + sign * residuals[other]) ** 2, axis=1) for sign in (1, -1)
    )
    F = sums / np.maximum(differences, np.finfo(float).tiny)
    alike = len(one) * fdtrc(freedom, freedom, F) < SIGNIFICANCE
    alike &= np.minimum(held_out[one], held_out[other]) > CONTRADICTS
    if alike.any():
        trials = np.unique([one[alike], other[alike]])
        words = ", ".join(f"{labels[k]} (by {held_out[k]:.0%})" for k in trials)
        yield (
            "one plant does not explain all trials, nor does one repeating disturbance: for "
            f"{name}, the others miss v + e of trials {words}, with errors that are alike. Leave "
            "out those of another plant, loop or disturbance, by isel"
        )
    if held_out.max(initial=0) >= 1:
        worst = labels[held_out.argmax()]
        yield (
            f"v for {name} may be worse than zero: of trial {worst} the others predict v + e with "
            f"an error of {held_out.max():.0%}"
        )


def _products(signals):
    """Inner products of the columns in each block of time, shape (blocks, columns, columns)."""
    return np.array([block.T @ block for block in np.array_split(signals, BLOCKS)])


def _squares(products, without, i):
    """Sums of squares of the residuals in all blocks, by the rows (n, blocks, p) without them."""
    n, blocks, p = without.shape
    residual = np.zeros((blocks, n, products.shape[1]))
    residual[..., :p], residual[..., p + i] = -without.swapaxes(0, 1), 1
    return np.sum(residual @ products * residual, axis=(0, 2))


def _unseen(reference, earlier, Ts):
    """Share of the reference's power that is unseen, and its lowest frequency (rad/s).

    Unseen is the power of the slope in bands in which the `earlier` ones, (trial, time), had hardly
    any.
    """
    count = 2 * max(len(reference), earlier.shape[1])
    edges = np.unique(np.geomspace(1, count // 2, BANDS).round().astype(int))

    def power(signal):
        lines = np.abs(np.fft.rfft(np.diff(signal), count)) ** 2
        return np.add.reduceat(lines, edges, axis=-1)

    bands = power(reference)
    unseen = bands > UNSEEN * power(earlier).max(axis=0)
    share = bands[unseen].sum() / (bands.sum() or 1.0)
    lowest = edges[unseen].min(initial=count)
    return share, 2 * np.pi / (count * Ts) * lowest


def _warnings(result, i, name, unseen, low):
    """What speaks against the first signal of output i."""
    if result.predicted[i] < PREDICTED:
        yield (
            f"F predicts {result.predicted[i]:.0%} of v + e for {name}: if another disturbance "
            "came, or actuators reached limits, leave these trials out, by isel"
        )
    if unseen > UNSEEN_SHARE:
        yield (
            f"reference has {unseen:.0%} of the power of its slope in {name} from {low:.2g} "
            "rad/s on, where the earlier ones had hardly any: v is a guess there"
        )
    size, off = np.sqrt(np.mean(result.v[:, i] ** 2)), result.uncertainty[i]
    if off > UNCERTAIN * size:
        yield (
            f"v for {name}, of RMS {size:.3g}, may be off by {off:.3g}: the trials do not "
            "distinguish the response to this reference from a repeating disturbance. Pass "
            "the first trials, too, where v was another, or trials of another task"
        )
