"""Another task tomorrow: where to begin with a new reference, from the trials of others.

By (30), y_k = P (r + v_k) + P~ d in any trial, converged or not, so that with e_k = r - y_k

    v_k + e_k = F y_k + c,    F = P^-1 - I,    c = -P^-1 P~ d:

what v would have to be if y_k were the reference. F is the plant's; c answers a disturbance that
repeats; v = F r + c is what any reference r needs. No model of P enters.
"""

import reprlib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import xarray as xr
from scipy.signal import oaconvolve

from rodlib.ilc import arguments

GROWTH = 1.5  # from one lag of F to the next
DECAY = 2.0  # a priori, entries of F fall as 1 / |lag|^DECAY
WEIGHTS = 10.0 ** np.arange(
    -10, 1
)  # of this prior, to choose from, times the mean square
ROUNDING = 1e-14  # of the power
STATIC, FREE = (
    1e6,
    2.0,
)  # times the weight, for F(0) = 0, as if P(0) = I; what else must gain
BLOCKS = 5  # of time, each left out in turn
RATIOS = 10.0 ** -np.arange(0, 7)  # of variances, to choose from
EXPLAINED, DOUBTFUL = 0.9, 0.2  # when to warn: share of v + e, of v
NEVER, NEW, BANDS = (
    1e3,
    0.1,
    25,
)  # times the power that was there, share of it, of frequency


@dataclass(frozen=True, eq=False)
class Transfer:
    """Where to begin with another reference. Signals have the shape (time, m).

    `doubt` is what the fits without one block of time differ by (jackknife), and the one by what
    differs between trials alone.
    """

    v: np.ndarray  # ILC signal of the first trial, explained + kept
    explained: np.ndarray  # F r
    kept: (
        np.ndarray
    )  # c, which answers a disturbance that repeats, whatever the reference
    F: np.ndarray  # (m, m, 2 R + 1): impulse response, from R samples ahead to R back
    left_out: (
        np.ndarray
    )  # (m,): share of v_k + e_k foretold where it was left out of the fit
    doubt: np.ndarray  # (m,): RMS by which v may be off, as the trials leave F open


def transfer(trials: xr.Dataset | Sequence[xr.Dataset], reference) -> Transfer:
    """The ILC signal with which to begin another task, from trials of one task or of several.

    Parameters
    ----------
    trials : xarray.Dataset or list of them
        From :func:`rodlib.run_trials`, :func:`rodlib.record` or :func:`rodlib.load_log`, of one
        loop, under the same disturbance, of the same length. All count, the first most of all.
        Where actuators cut off, with v as :func:`rodlib.ilc.law.limits.realised` has it.
    reference : array_like, shape (time, m)
        Of the new task, of any length; where the trials had ended, nothing is kept.

    Warns
    -----
    UserWarning
        If F and c explain little of the trials; if these leave v open, as one trial alone does;
        if the reference has power where no old one had.

    Notes
    -----
    Each row of F is a ridge regression. Lags grow geometrically up to half a trial, with straight
    lines between, and are weighted as slopes, (y(p - l) - y(p)) / l^2. c is a random effect: the
    mean over K trials has the variance s_w^2 / K + s_c^2, deviations from it have s_w^2 (P.
    Balestra and M. Nerlove, Econometrica 34 (1966) 585-612). So c is told from F r by what differs
    between trials: v within a task, and the reference between tasks. The weight, the ratio of the
    variances, and whether F is zero at frequency zero, as if P(0) = I, are those by which blocks
    of time that were left out are most likely. By kernels, with one trial: L. Blanken and T.
    Oomen, Automatica 114 (2020) 108830.
    """
    v, y, old, outputs, Ts = _signals(trials)
    K, N, m = y.shape
    new = arguments.in_columns("reference", reference, ("time", m), outputs)
    size = np.sqrt(np.mean(y**2, axis=(0, 1)))
    size[size == 0] = 1.0
    basis = _basis(max(1, N // 2))
    told = [
        np.hstack([_taps(y_k / size, basis), t])
        for y_k, t in zip(y, old + v - y, strict=True)
    ]
    mean = sum(told) / K
    about = K * _products(mean)
    within = sum(_products(signals) for signals in told) - about

    p = m * basis.shape[1]
    X, before = _taps(new / size, basis), np.zeros((len(new), p + m))
    before[:N] = mean[: len(new)]
    rows, kept, left_out, doubt = (
        np.zeros((m, p)),
        np.zeros_like(new),
        np.zeros(m),
        np.zeros(m),
    )
    for i in range(m):
        apart, *_ = _fit(
            within, about, p, i, m, K, [0.0]
        )  # by what differs between trials alone
        rows[i], others, ratio, left_out[i] = _fit(
            within, about, p, i, m, K, RATIOS[: 1 if K == 1 else None]
        )
        shift, share = before[:, p + i], X - (1 - ratio) * before[:, :p]
        kept[:, i] = (1 - ratio) * (shift - before[:, :p] @ rows[i])
        moved = (1 - 1 / BLOCKS) * np.sum((share @ (others - rows[i]).T) ** 2, axis=1)
        moved += (shift + (X - before[:, :p]) @ apart - X @ rows[i] - kept[:, i]) ** 2
        doubt[i] = np.sqrt(np.mean(moved))
    explained, F = X @ rows.T, (rows.reshape(m, m, -1) / size[:, None]) @ basis.T
    found = Transfer(explained + kept, explained, kept, F, left_out, doubt)
    for finding in _findings(found, outputs, new, old, Ts):
        warnings.warn(finding, stacklevel=2)
    return found


def _signals(trials):
    """v, y and reference of all trials, shape (trial, time, m), the outputs' names, and Ts."""
    tasks = [trials] if isinstance(trials, xr.Dataset) else trials
    if not (isinstance(tasks, list | tuple) and tasks):
        raise ValueError(
            f"trials = {reprlib.repr(trials)} must be a Dataset of trials, or a list"
        )
    found, axes, first = (
        {"v": [], "y": [], "reference": []},
        ("trial", "time", "channel"),
        None,
    )
    for each in tasks:
        each = arguments.instance("trials", each, xr.Dataset)
        each = each if "trial" in each.dims else each.expand_dims("trial")
        if not all(name in each and {*each[name].dims} == {*axes} for name in found):
            raise ValueError(
                f"trials lack one of {[*found]}, or its axes: see run_trials"
            )
        Ts = arguments.sampling_period("trials.attrs['Ts']", each.attrs.get("Ts"))
        first = first or (
            Ts,
            each.sizes,
            arguments.names_of(each.y) or [*each.channel.values],
        )
        arguments.one_period(trials=first[0], another=Ts)
        shape = ("trial", first[1]["time"], first[1]["channel"])
        for name, signals in found.items():
            signal = each[name].transpose(*axes)
            signals.append(
                arguments.in_columns(f"trials.{name}", signal, shape, first[2])
            )
    return *(np.concatenate(signals) for signals in found.values()), first[2], first[0]


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
    """A signal (time, m) by each tap, shape (time, m taps); beyond its ends it stands still."""
    still = np.pad(signal, [(len(basis) // 2, len(basis) // 2), (0, 0)], mode="edge")
    taps = oaconvolve(still[:, :, None], basis[:, None], mode="valid", axes=0)
    return taps.reshape(len(signal), -1)


def _products(signals):
    """Inner products of the columns in each block of time, shape (blocks, columns, columns)."""
    return np.array([block.T @ block for block in np.array_split(signals, BLOCKS)])


def _fit(within, about, p, i, m, K, ratios):
    """Row i of F; those without each block; s_w^2 / (s_w^2 + K s_c^2); share that is foretold."""
    power, moved = (
        (within + about)[:, p + i, p + i].sum(),
        np.trace(about.sum(axis=0)[:p, :p]) / p,
    )
    if not power > 0:
        return np.zeros(p), np.zeros((BLOCKS, p)), 1.0, 1.0
    best = (np.inf,)
    for ratio, static, weight in product(ratios, (1.0, STATIC), WEIGHTS):
        prior = np.full((m, p // m), ROUNDING * moved or 1.0)
        fit = _ridge(within + ratio * about, p, i, weight, prior, static)
        off, ours = (_missed(S, fit[1], i) + ROUNDING * power for S in (within, about))
        likely = (
            (K - 1) * np.log(off)
            + np.log(ours)
            + (K * np.log(FREE) if static == 1 else 0)
        )
        if likely < best[0]:
            best = likely, *fit, off, ours
    _, row, others, off, ours = best
    ratio = min(1.0, off / (K - 1) / ours) if K > 1 else 1.0
    whole = (within + ratio * about)[:, p + i, p + i].sum()
    return row, others, ratio, 1 - (off + ratio * ours) / whole


def _ridge(S, p, i, weight, prior, static):
    """Row i of F, and those without each block."""
    total = S.sum(axis=0)
    sums = np.concatenate([total[None], total - S])
    prior += weight * np.trace(total[:p, :p]) / p
    prior[:, prior.shape[1] // 2] *= static
    rows = np.linalg.solve(
        sums[:, :p, :p] + np.diag(prior.ravel()), sums[:, :p, [p + i]]
    )[..., 0]
    return rows[0], rows[1:]


def _missed(S, others, i):
    """Sum of squares that the rows leave of the blocks that they were made without."""
    blocks, p = others.shape
    residual = np.zeros((blocks, S.shape[1]))
    residual[:, :p], residual[:, p + i] = -others, 1
    return np.einsum("bp,bpq,bq", residual, S, residual)


def _unseen(new, old, Ts):
    """Share of a slope's power in bands where no old one (trial, time) had any; the lowest."""
    n = 2 * max(len(new), old.shape[1])
    edges = np.unique(np.geomspace(1, n // 2, BANDS).round().astype(int))
    slopes = np.diff(new), *np.diff(old)
    bands = [np.add.reduceat(np.abs(np.fft.rfft(s, n)) ** 2, edges) for s in slopes]
    fresh = bands[0] > NEVER * np.max(bands[1:], axis=0)
    share = bands[0][fresh].sum() / (bands[0].sum() or 1.0)
    return share, 2 * np.pi / (n * Ts) * edges[fresh].min(initial=n)


def _findings(found, outputs, new, old, Ts):
    """What speaks against beginning so, in words."""
    for i, name in enumerate(outputs):
        if found.left_out[i] < EXPLAINED:
            yield (
                f"F explains {found.left_out[i]:.0%} of what was learned for {name}: if another "
                "disturbance came, or actuators reached limits, leave these trials out, by isel"
            )
        share, low = _unseen(new[:, i], old[:, :, i], Ts)
        if share > NEW:
            yield (
                f"reference has {share:.0%} of the power of its slope in {name} from {low:.2g} "
                "rad/s on, where no old one had any to speak of: v is a guess there"
            )
        size = np.sqrt(np.mean(found.v[:, i] ** 2))
        if found.doubt[i] > DOUBTFUL * size:
            yield (
                f"v for {name}, of RMS {size:.3g}, may be off by {found.doubt[i]:.3g}: the trials "
                "do not tell what answers this reference, or a disturbance that repeats. Pass the "
                "first trials, too, where v was another, or trials of another task"
            )
