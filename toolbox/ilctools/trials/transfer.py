"""Another task tomorrow: the first ILC signal of a new reference, from the trials of others.

By (30), y_k = P (r_k + v_k) + P~ d in any trial, converged or not, so that with e_k = r_k - y_k

    v_k + e_k = F y_k + c,    F = P^-1 - I,    c = -P^-1 P~ d:                                (1)

what v would have to be if y_k were the reference. F is the plant's; c compensates a repeating
disturbance; any reference r needs v = F r + c. No model of P enters.

With F y_k = Phi_k f by the taps f of F, and t_k = v_k + e_k, one ridge regression gives both,

    minimise  sum_k ||t_k - Phi_k f - c||^2 + lambda f' D f + gamma ||c||^2.                  (2)

With the means Phi and t over K trials, and rho = gamma / (K + gamma), its solution for c, and what
is left to be minimised by f, are

    c = (1 - rho) (t - Phi f),                                                                (3)
    sum_k ||t_k - t - (Phi_k - Phi) f||^2 + rho K ||t - Phi f||^2 + lambda f' D f.            (4)

So c is a random effect (P. Balestra and M. Nerlove, Econometrica 34 (1966) 585-612): the mean over
the trials has K s_c^2 / s_w^2 + 1 = 1 / rho times the variance that deviations from it promise. By
kernels, with one trial: L. Blanken and T. Oomen, Automatica 114 (2020) 108830.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import xarray as xr
from scipy.signal import oaconvolve

from ilctools import arguments
from ilctools.signals import Signals, check_match, period_of

GROWTH = 1.5  # from one lag of F to the next: fewer taps, a smoother F
DECAY = 2.0  # a priori, entries of F fall as 1 / |lag|^DECAY
WEIGHTS = 10.0 ** np.arange(-10, 1)  # candidates for lambda, in mean squares of the regressors
STATIC = 1e6  # of F(0) in D, a candidate beside 1: F(0) = 0, as if P(0) = I,
PENALTY = 2.0  # unless F(0) /= 0 makes each trial so many times as likely
RATIOS = 10.0 ** -np.arange(0, 7)  # candidates for rho; with one trial it is 1
BLOCKS = 5  # of time, for cross-validation
ROUNDING = 1e-14  # of the power, below which residuals are rounding
PREDICTED = 0.9  # share of v + e with less of which a warning comes
UNCERTAIN = 0.2  # share of v that may be uncertain without one
AXES = ("trial", "time", "channel")


@dataclass(frozen=True, eq=False)
class Transfer:
    """Where to begin with another reference. Signals have the shape (time, m).

    The uncertainty is the jackknife's, by fits without one block of time each, together with the
    distance to the fit by differences between trials alone, rho = 0.
    """

    v: np.ndarray  # ILC signal of the first trial, feedforward + compensation
    feedforward: np.ndarray  # F r
    compensation: np.ndarray  # c, of a repeating disturbance
    F: np.ndarray  # (m, m, 2 R + 1): impulse response, from R samples ahead to R back
    predicted: np.ndarray  # (m,): share of v_k + e_k, in cross-validation
    uncertainty: np.ndarray  # (m,): RMS by which v may be off


def transfer(trials: xr.Dataset | Sequence[xr.Dataset], reference) -> Transfer:
    """Compute the first ILC signal of another task from trials of one task or of several.

    Parameters
    ----------
    trials : xarray.Dataset or list of them
        From :func:`run_trials`, :func:`record` or :func:`load_log`, of one plant and loop, under
        the same disturbance, of the same length: those of another are to be left out, by isel. All
        count, the first most of all. Where actuators cut off, with v as
        the loop's `realised` has it.
    reference : array_like, shape (time, m)
        Of the new task, of any length; beyond the end of the trials the compensation is zero. At
        frequencies where it has power and the earlier ones had hardly any, v is a guess.

    Warns
    -----
    UserWarning
        If F and c predict little of the trials; if the trials leave v uncertain, as one alone does.

    See Also
    --------
    run_trials : what takes its v
    record : trials on a rig

    Notes
    -----
    The lags of F grow geometrically up to half a trial, with straight lines between, and are
    weighted as slopes, (y(p - l) - y(p)) / l^2. Differences between trials distinguish c from F r:
    v within a task, and the reference between tasks. The weights lambda and rho, and whether F(0) =
    0, have the largest likelihood in cross-validation over blocks of time.

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
    v, y, references, outputs = _signals(trials)
    K, N, m = y.shape
    reference = arguments.in_columns("reference", reference, ("time", m), outputs)
    size = np.sqrt(np.mean(y**2, axis=(0, 1)))
    size[size == 0] = 1.0
    basis = _basis(max(1, N // 2))
    targets = references + v - y  # v_k + e_k
    taps = np.array([_taps(output / size, basis) for output in y])
    columns = np.concatenate([taps, targets], axis=2)  # Phi_k, t_k
    mean = columns.mean(axis=0)
    fits = _Fits(sum(map(_products, columns - mean)), K * _products(mean), K, m)

    f, without = fits.likeliest(RATIOS if K > 1 else RATIOS[:1])
    rho, predicted = fits.variances(without)
    by_differences, _ = fits.likeliest([0.0])  # between trials, alone
    X = _taps(reference / size, basis)
    past = np.zeros((len(reference), columns.shape[2]))
    past[:N] = mean[: len(reference)]
    Phi, t = past[:, :-m], past[:, -m:]

    def first_signal(f, rho):
        return X @ f + (1 - rho) * (t - Phi @ f)  # F r + c, (3)

    v = first_signal(f, rho)
    jackknife = (1 - 1 / BLOCKS) * sum((first_signal(other, rho) - v) ** 2 for other in without)
    distance = first_signal(by_differences, 0.0) - v
    uncertainty = np.sqrt(np.mean(jackknife + distance**2, axis=0))
    F = (f.T.reshape(m, m, -1) / size[:, None]) @ basis.T
    result = Transfer(v, X @ f, v - X @ f, F, predicted, uncertainty)
    for i, name in enumerate(outputs):
        for text in _warnings(result, i, name):
            warnings.warn(text, stacklevel=2)
    return result


def _signals(trials):
    """v, y and reference of all trials, (trial, time, output), and the names of the outputs."""
    tasks = trials if isinstance(trials, list | tuple) and trials else [trials]
    signals, periods, outputs, shape = {"v": [], "y": [], "reference": []}, {}, None, None
    for i, task in enumerate(tasks):
        task = arguments.instance("trials", task, xr.Dataset)
        task = task if "trial" in task.dims else task.expand_dims("trial")
        if not all(name in task and {*task[name].dims} == {*AXES} for name in signals):
            raise ValueError(f"trials lack one of {[*signals]}, or its axes: see run_trials")
        periods[f"trials[{i}]"] = Signals(period_of(task))
        outputs = outputs or arguments.names_of(task.y) or task.channel.values.tolist()
        shape = shape or ("trial", task.sizes["time"], task.sizes["channel"])
        for name, arrays in signals.items():
            array = task[name].transpose(*AXES)
            arrays.append(arguments.in_columns(f"trials.{name}", array, shape, outputs))
    check_match(**periods)
    v, y, references = (np.concatenate(arrays) for arrays in signals.values())
    return v, y, references, outputs


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
    reach = len(basis) // 2
    extended = np.pad(signal, [(reach, reach), (0, 0)], mode="edge")
    taps = oaconvolve(extended[..., None], basis[:, None], mode="valid", axes=0)
    return taps.reshape(len(signal), -1)


def _products(columns):
    """Inner products of the columns in each block of time, shape (blocks, columns, columns)."""
    return np.array([block.T @ block for block in np.array_split(columns, BLOCKS)])


@dataclass(frozen=True)
class _Fits:
    """The sums of (4) over blocks of time: products of p regressors and m targets."""

    within: np.ndarray  # of deviations from the mean over the trials
    between: np.ndarray  # K times those of the mean
    K: int
    m: int

    def likeliest(self, ratios):
        """f by the likeliest weights rho, lambda and D of each output, and f without each block.

        Shapes (p, m) and (blocks, p, m).
        """
        m, p = self.m, self.within.shape[1] - self.m
        D = np.ones((m, p // m))
        candidates, likelihoods = [], []
        for rho, static, weight in product(ratios, (1.0, STATIC), WEIGHTS):
            D[:, D.shape[1] // 2] = static
            size = np.mean(self.power(rho)[:p]) or 1.0
            candidates.append((rho, weight * size * D.ravel()))
            prior = self.K * np.log(PENALTY) if static == 1 else 0.0
            likelihoods.append(self.likelihood(*candidates[-1]) - prior)
        best = np.argmax(likelihoods, axis=0)
        fits = [self.solve(*candidates[k])[..., i] for i, k in enumerate(best)]
        f, *without = np.stack(fits, axis=-1)
        return f, np.array(without)

    def power(self, rho=1.0):
        """Sums of squares of the columns (Phi, t), as (4) weights them."""
        return np.diagonal(np.sum(self.within + rho * self.between, axis=0))

    def variances(self, without):
        """rho, by what fits without a block leave in it; and the share that they predict, (m,)."""
        within, between = self.residuals(without)
        rho = np.ones(self.m)
        if self.K > 1:
            rho = np.minimum(1.0, within / (self.K - 1) / np.maximum(between, np.finfo(float).tiny))
        power = np.array([self.power(ratio)[i - self.m] for i, ratio in enumerate(rho)])
        missed = np.divide(within + rho * between, power, out=np.zeros(self.m), where=power > 0)
        return rho, 1 - missed

    def solve(self, rho, penalty):
        """f of (4), of all blocks, and without each, shape (1 + blocks, p, m)."""
        p, products = len(penalty), self.within + rho * self.between
        total = products.sum(axis=0)
        sums = np.concatenate([total[None], total - products])
        return np.linalg.solve(sums[:, :p, :p] + np.diag(penalty), sums[:, :p, p:])

    def residuals(self, without):
        """Sums of squares in all blocks that fits without them leave, within and between trials."""
        one = np.broadcast_to(np.eye(self.m), (BLOCKS, self.m, self.m))
        R = np.concatenate([-without, one], axis=1)  # from (Phi, t) to t - Phi f
        return [np.sum(R * (products @ R), axis=(0, 1)) for products in (self.within, self.between)]

    def likelihood(self, rho, penalty):
        """Logarithm of the likelihood of the residuals of each output, within and between."""
        power = self.power()[-self.m :]
        floor = ROUNDING * np.where(power > 0, power, 1.0)
        residuals = self.residuals(self.solve(rho, penalty)[1:])
        within, between = (residual + floor for residual in residuals)
        return -(self.K - 1) * np.log(within) - np.log(between)


def _warnings(result, i, name):
    """What speaks against the first signal of output i."""
    if result.predicted[i] < PREDICTED:
        yield (
            f"F predicts {result.predicted[i]:.0%} of v + e for {name}: if another disturbance "
            "came, or actuators reached limits, leave these trials out, by isel"
        )
    size, off = np.sqrt(np.mean(result.v[:, i] ** 2)), result.uncertainty[i]
    if off > UNCERTAIN * size:
        yield (
            f"v for {name}, of RMS {size:.3g}, may be off by {off:.3g}: the trials do not "
            "distinguish the response to this reference from a repeating disturbance. Pass "
            "the first trials, too, where v was another, or trials of another task"
        )
