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
TINY = np.finfo(float).tiny  # instead of a zero that divides
UNCERTAIN = 0.2  # share of v that may be uncertain without one
AXES = ("trial", "time", "channel")


@dataclass(frozen=True, eq=False)
class Transfer:
    """Where to begin with another reference. Signals have the shape (time, m).

    The uncertainty is the distance to the fit by differences between trials alone, rho = 0.
    """

    v: np.ndarray  # ILC signal of the first trial, feedforward + compensation
    feedforward: np.ndarray  # F r
    compensation: np.ndarray  # c, of a repeating disturbance
    F: np.ndarray  # (m, m, 2 R + 1): impulse response, from R samples ahead to R back
    predicted: np.ndarray  # (m,): share of v_k + e_k, in cross-validation
    uncertainty: np.ndarray  # (m,): RMS by which v may be off, if the disturbance was misjudged


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
    outputs, v, y, references = _signals(trials)
    K, N, m = y.shape
    reference = arguments.in_columns("reference", reference, ("time", m), outputs)
    size = np.sqrt(np.mean(y**2, axis=(0, 1)))
    size[size == 0] = 1.0
    basis = _basis(max(1, N // 2))
    taps = np.array([_taps(output / size, basis) for output in y])
    columns = np.concatenate([taps, references + v - y], axis=2)  # Phi_k, t_k = v_k + e_k
    mean = columns.mean(axis=0)
    sums = np.array([sum(map(_products, columns - mean)), K * _products(mean)])  # of (4)
    X = _taps(reference / size, basis)

    def first_signal(f, rho):  # F r and c, (3)
        c = (1 - rho) * (mean[:, -m:] - mean[:, :-m] @ f)
        return X @ f, np.pad(c, [(0, len(X)), (0, 0)])[: len(X)]

    f, rho, predicted = _estimates(sums, K, m)
    feedforward, compensation = first_signal(f, rho)
    v = feedforward + compensation
    by_differences, _ = _likeliest(sums, K, m, [0.0])  # between trials, alone
    uncertainty = np.sqrt(np.mean((sum(first_signal(by_differences, 0.0)) - v) ** 2, axis=0))
    F = (f.T.reshape(m, m, -1) / size[:, None]) @ basis.T
    for text in _warnings(v, predicted, uncertainty, outputs):
        warnings.warn(text, stacklevel=2)
    return Transfer(v, feedforward, compensation, F, predicted, uncertainty)


def _signals(trials):
    """Names of the outputs; v, y and reference of all trials, shape (trial, time, output)."""
    tasks = trials if isinstance(trials, list | tuple) and trials else [trials]
    tasks = [arguments.instance("trials", task, xr.Dataset) for task in tasks]
    tasks = [task if "trial" in task.dims else task.expand_dims("trial") for task in tasks]
    names = ["v", "y", "reference"]
    if not all(n in task and {*task[n].dims} == {*AXES} for task in tasks for n in names):
        raise ValueError(f"trials lack one of {names}, or its axes: see run_trials")
    check_match(**{f"trials[{i}]": Signals(period_of(task)) for i, task in enumerate(tasks)})
    y = tasks[0].y
    outputs = arguments.names_of(y) or y.channel.values.tolist()
    shape = "trial", y.sizes["time"], y.sizes["channel"]
    yield outputs
    for name in names:
        arrays = [task[name].transpose(*AXES) for task in tasks]
        yield np.concatenate(
            [arguments.in_columns(f"trials.{name}", array, shape, outputs) for array in arrays]
        )


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


def _estimates(sums, K, m):
    """f; rho, by what fits without a block of time leave there; which share they predict."""
    f, (within, between) = _likeliest(sums, K, m, RATIOS if K > 1 else RATIOS[:1])
    rho = np.ones(m)
    if K > 1:
        rho = np.minimum(1.0, within / (K - 1) / np.maximum(between, TINY))
    power = _powers(sums)[:, -m:]
    missed = (within + rho * between) / np.maximum(power[0] + rho * power[1], TINY)
    return f, rho, 1 - missed


def _powers(sums):
    """Sums of squares of the columns (Phi, t), within and between trials, shape (2, columns)."""
    return np.diagonal(sums.sum(axis=1), axis1=1, axis2=2)


def _likeliest(sums, K, m, ratios):
    """f of (4), and what fits without a block of time leave there, within and between trials.

    For each output by the rho, lambda and D with which what they leave is the likeliest.
    """
    power = _powers(sums)
    p = power.shape[1] - m
    fits, likelihoods, D = [], [], np.ones((m, p // m))
    for rho, static, weight in product(ratios, (1.0, STATIC), WEIGHTS):
        D[:, D.shape[1] // 2] = static
        size = np.mean([1, rho] @ power[:, :p]) or 1.0
        fits.append(_fit(sums, rho, weight * size * D.ravel()))
        left = np.log(fits[-1][p:] + np.maximum(ROUNDING * power.sum(axis=0)[p:], TINY))
        prior = K * np.log(PENALTY) if static == 1 else 0.0
        likelihoods.append(-np.array([K - 1, 1]) @ left - prior)
    best = np.argmax(likelihoods, axis=0)
    chosen = np.stack([fits[k][:, i] for i, k in enumerate(best)], axis=1)
    return chosen[:p], chosen[p:]


def _fit(sums, rho, penalty):
    """f of (4), (p, m), above the sums of squares in all blocks that fits without them leave.

    Two rows of these, within and between trials, for the m outputs.
    """
    p, products = len(penalty), np.tensordot([1, rho], sums, 1)
    total = products.sum(axis=0)
    kept = np.concatenate([total[None], total - products])
    f, *without = np.linalg.solve(kept[:, :p, :p] + np.diag(penalty), kept[:, :p, p:])
    R = np.array([np.vstack([-g, np.eye(g.shape[1])]) for g in without])  # t - Phi f, of (Phi, t)
    return np.vstack([f, np.sum(R * (sums @ R), axis=(1, 2))])


def _warnings(v, predicted, uncertainty, outputs):
    """What speaks against the first signals v."""
    sizes = np.sqrt(np.mean(v**2, axis=0))
    for name, share, size, off in zip(outputs, predicted, sizes, uncertainty, strict=True):
        if share < PREDICTED:
            yield (
                f"F predicts {share:.0%} of v + e for {name}: if another disturbance came, or "
                "actuators reached limits, leave these trials out, by isel"
            )
        if off > UNCERTAIN * size:
            yield (
                f"v for {name}, of RMS {size:.3g}, may be off by {off:.3g}: the trials do not "
                "distinguish the response to this reference from a repeating disturbance. Pass "
                "the first trials, too, where v was another, or trials of another task"
            )
