"""The first ILC signal of a new reference, from the trials of other references.

By (30) of the paper, y_k = P (r_k + v_k) + P~ d in any trial, whether learning has converged or
not. With e_k = r_k - y_k, this gives

    v_k + e_k = F y_k + c,    F = P^-1 - I,    c = -P^-1 P~ d.                                (1)

This is the v that would be needed if y_k were the reference. F depends on the plant alone, and c
compensates a repeating disturbance. Any reference r needs v = F r + c. No model of P is used.

Let F y_k = Phi_k f, where f are the taps (coefficients) of F, and let t_k = v_k + e_k. One ridge
regression gives f and c. The terms lambda f' D f and gamma ||c||^2 penalise large f and c:

    minimise  sum_k ||t_k - Phi_k f - c||^2 + lambda f' D f + gamma ||c||^2.                  (2)

Let Phi and t be the means over K trials, and rho = gamma / (K + gamma). Then c, and the cost that f
minimises, are

    c = (1 - rho) (t - Phi f),                                                                (3)
    sum_k ||t_k - t - (Phi_k - Phi) f||^2 + rho K ||t - Phi f||^2 + lambda f' D f.            (4)

Therefore c is a random effect (P. Balestra and M. Nerlove, Econometrica 34 (1966) 585-612). The
mean over the trials has a larger variance than the deviations from the mean predict. The factor is
K s_c^2 / s_w^2 + 1 = 1 / rho, where s_c^2 is the variance of c, and s_w^2 is the variance of the
residuals within trials. L. Blanken and T. Oomen, Automatica 114 (2020) 108830, use kernels and one
trial.

*With a model* M of P, only the unknown part of F is fitted. Let M^+ be the regularised inverse of M
over a trial, and z_k = M^+ y_k. Then (1) becomes

    v_k + r_k = G z_k + c,    G = P^-1 M,    v = G M^+ r + c - r,                             (5)

where G is near I. Equations (2) to (4) are then used for G - I, with z_k in the place of y_k and
v_k + r_k - z_k as t_k. A single trial has one number for each output and frequency, but each row of
G has m unknowns. With one trial, G is therefore taken to be diagonal, as if each input had an error
of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import xarray as xr
from scipy.interpolate import make_interp_spline
from scipy.signal import oaconvolve

from ilctools import arguments
from ilctools.law.notes import RESET
from ilctools.loop.closed import Loop
from ilctools.models import Model, frequency_response, stable_plant
from ilctools.norm_optimal import NormOptimal
from ilctools.signals import TRIAL_AXES, Signals, check_match, period_of
from ilctools.singular_values import largest_singular_values
from ilctools.trials.rms import SMALLEST_DIVISOR
from ilctools.warn import warn

LAG_RATIO = 1.5  # ratio of successive lags of F; a larger one gives fewer taps and a smoother F
DECAY = 2.0  # a priori, entries of F fall as 1 / |lag|^DECAY
WEIGHTS = 10.0 ** np.arange(-10, 1)  # candidates for lambda, in mean squares of the regressors
STATIC_WEIGHT = 1e6  # candidate beside 1 for the weight of F(0): F(0) = 0, as if P(0) = I
DIAGONAL_WEIGHT = 1e6  # candidate beside 1 for the weight of coupling in G: no coupling
PENALTY = 2.0  # 1 is chosen only if each trial is then so many times as likely
SMALLEST_GAIN = 0.01  # smallest gain of M that is inverted, relative to the largest gain
RATIOS = 10.0 ** -np.arange(0, 7)  # candidates for rho; with one trial rho is 1
BLOCKS = 5  # blocks of time for cross-validation
ROUNDED_POWER = 1e-14  # fraction of the power below which residuals are rounding
PREDICTED = 0.9  # a smaller share of v + e that is predicted gives a warning
UNCERTAIN = 0.2  # a larger share of v that is uncertain gives a warning


@dataclass(frozen=True, eq=False)
class Transfer:
    """The v for the first trial of a new reference, and the uncertainty of this v.

    Signals have the shape (time, m). The uncertainty has two parts. The first part, the jackknife,
    comes from fits, each of which leaves out one block of time. The second part is the distance to
    a fit that uses only differences between trials, rho = 0.
    """

    v: np.ndarray  # ILC signal of the first trial, feedforward + compensation
    feedforward: np.ndarray  # F r
    compensation: np.ndarray  # c, which compensates a repeating disturbance
    # (m, m, 2 R + 1): impulse response of F, from R samples ahead to R back; with a model, of G - I
    F: np.ndarray
    predicted: np.ndarray  # (m,): predicted share of v_k + e_k, in cross-validation
    uncertainty: np.ndarray  # (m,): RMS by which v may be wrong

    def __repr__(self):
        size, share = np.sqrt(np.mean(self.v**2, axis=0)), np.round(self.predicted, 4)
        with np.printoptions(precision=3):
            return (
                f"v has {len(self.v)} samples and an RMS of {size}, which may be wrong by "
                f"{self.uncertainty}; F and c predict a share {share} of v + e in the trials"
            )


def transfer(
    trials: xr.Dataset | Sequence[xr.Dataset], reference, model: Loop | Model | None = None
) -> Transfer:
    """Compute a first v for a new reference from trials of other references.

    Parameters
    ----------
    trials : xarray.Dataset or list of them
        Trials from :func:`run_trials`, :func:`record` or :func:`load_log`. All trials must have the
        same plant, loop, disturbance and length, and must start from a reset. Leave out other
        trials by isel. The first trials of a task are the most informative. If actuators saturate,
        pass the v that was realised, see the loop's `realised`.
    reference : array_like, shape (time, m)
        The new reference, of any length. At frequencies that the earlier references did not
        contain, v is only a guess. If the new reference is longer than the trials, no disturbance
        is compensated after their end.
    model : control.StateSpace or a loop with a model, optional
        A model of the response from references to y. The trials correct a wrong model, and fewer
        trials are needed than without one. Default: no model.

    Warns
    -----
    UserWarning
        If F and c predict little of the trials, or if the trials leave v uncertain.

    See Also
    --------
    run_trials : simulates trials, with v for the first trial
    record : runs trials on a rig

    Notes
    -----
    The impulse response of F is linear between lags that grow geometrically up to half a trial. The
    regressors of F are slopes, (y(p - l) - y(p)) / l^2. Differences between trials distinguish c
    from F r. Trials of one task differ in v, and trials of different tasks differ in the reference.
    Cross-validation over blocks of time chooses the weights lambda and rho, and whether F(0) = 0.
    If v has frequencies above the cut-off of Q, a law removes them again.

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
    v, y, references, outputs, period = _signals(trials)
    reference = arguments.in_columns("reference", reference, ("time", y.shape[2]), outputs)
    result = fitted(v, y, references, reference, _model(model, outputs, period))
    for text in _warnings(result, outputs):
        warn(text)
    return result


def _signals(trials):
    """Return v, y, the reference, the names of the outputs, and the sampling period.

    The signals have the shape (trial, time, output).
    """
    signals, tasks, periods = ("v", "y", "reference"), [], {}
    for task in trials if isinstance(trials, list | tuple) and trials else [trials]:
        task = arguments.instance("trials", task, xr.Dataset)
        task = task if "trial" in task.dims else task.expand_dims("trial")
        if "input" in task.coords:
            raise ValueError(
                f"trials have a v of {task.input.values.tolist()}, but transfer needs a v that "
                "is added to references, one for each output"
            )
        if RESET in task.attrs or not all(
            name in task and {*task[name].dims} == {*TRIAL_AXES} for name in signals
        ):
            raise ValueError(
                f"trials lack one of {[*signals]}, or one of its axes, or a reset before each "
                "trial: pass the result of run_trials or record"
            )
        periods[f"trials[{len(tasks)}]"] = Signals(period_of(task))
        tasks.append(task.transpose(*TRIAL_AXES, ...))
    check_match(**periods)
    y = tasks[0].y
    outputs = arguments.names_of(y) or y.channel.values.tolist()

    def of_all(name):
        shape = "trial", *y.shape[1:]
        return [arguments.in_columns(f"trials.{name}", x[name], shape, outputs) for x in tasks]

    return *(np.concatenate(of_all(name)) for name in signals), outputs, period_of(tasks[0])


def _model(model, outputs, period):
    """Check the model, and return P; return None if there is no model."""
    if model is None:
        return None
    if isinstance(model, Loop):
        if model.P_v is None or not model.one_for_one:
            raise ValueError(
                "model is a loop without P, or a loop whose v is not added to references: "
                "give P as a state-space model from references to outputs, or leave model out"
            )
        model = model.P_v
    P = stable_plant(model, "model")
    if (P.noutputs, P.ninputs) != (len(outputs), len(outputs)):
        raise ValueError(
            f"model has {P.noutputs} outputs and {P.ninputs} inputs, but the trials have "
            f"{len(outputs)} outputs, each with a reference"
        )
    check_match(trials=Signals(period), model=Signals(P.dt))
    return P


def _inverted(signals, model, size):
    """Apply M^+ of (5) to signals (..., time, m); without a model, return the signals.

    In M^+, each channel is in units of its `size`.
    """
    if model is None:
        return signals
    M = np.diag(1 / size) * model * np.diag(size)
    omega = np.pi / model.dt * np.arange(1, 257) / 256
    gain = largest_singular_values(frequency_response(M, omega)).max()
    least_squares = NormOptimal(M, (SMALLEST_GAIN * gain) ** 2, signals.shape[-2])
    return least_squares.apply(signals / size) * size


def _sizes(signals):
    """Compute the RMS of each of the m channels of trials.

    If a channel is zero, its RMS is replaced by one.
    """
    size = np.sqrt(np.mean(signals**2, axis=(0, 1)))
    size[size == 0] = 1.0
    return size


def fitted(v, y, references, reference, model: Model | None) -> Transfer:
    """Fit F and c to trials, and apply F and c to a new reference.

    The signals of trials have the shape (trial, time, m). The new reference has the shape
    (time, m).
    """
    _, samples, m = y.shape
    z, z_new = (_inverted(signals, model, _sizes(y)) for signals in (y, reference))
    size = _sizes(z)
    basis = _basis(max(1, samples // 2))
    known = model is not None
    fits = _Fits([_taps(one / size, basis) for one in z], references + v - z, known)
    f, without = fits.likeliest(RATIOS if len(y) > 1 else RATIOS[:1])
    rho, predicted = fits.variances(without)
    new = _taps(z_new / size, basis)
    by_fit = fits.first_signal(new, f, rho)
    v = z_new - reference + by_fit
    uncertainty = _uncertainty(fits, new, by_fit, without, rho)
    F = (f.T.reshape(m, m, -1) / size[:, None]) @ basis.T
    feedforward = z_new - reference + new @ f
    return Transfer(v, feedforward, v - feedforward, F, predicted, uncertainty)


def _uncertainty(fits, new, by_fit, without, rho):
    """Compute the uncertainty of the first v, for each of the m channels.

    The uncertainty shows how v changes if a block of time is left out, and if only differences
    between trials are used.
    """
    apart = fits.first_signal(new, without, rho) - by_fit
    jackknife = (1 - 1 / BLOCKS) * np.sum(apart**2, axis=0)
    by_differences, _ = fits.likeliest([0.0])
    distance = fits.first_signal(new, by_differences, 0.0) - by_fit
    return np.sqrt(np.mean(jackknife + distance**2, axis=0))


def _basis(reach):
    """Make the basis of F, shape (lags, taps).

    The basis consists of slopes from lag 0 to other lags, and of lag 0 by itself.
    """
    knots = [0, 1]
    while knots[-1] < reach:
        knots.append(min(reach, round(LAG_RATIO * knots[-1])))
    knots = np.append(-np.array(knots)[:0:-1], knots)
    middle = len(knots) // 2
    hats = make_interp_spline(knots, np.eye(len(knots)), k=1)(np.arange(-reach, reach + 1))
    hats /= hats.sum(axis=0)
    slopes = (hats - hats[:, [middle]]) / np.maximum(np.abs(knots), 1) ** DECAY
    slopes[:, middle] = hats[:, middle] / reach
    return slopes


def _taps(signal, basis):
    """Filter a signal by each tap; the signal is constant beyond its ends.

    The signal has the shape (time, m), and the result has the shape (time, m taps).
    """
    reach = len(basis) // 2
    extended = np.pad(signal, [(reach, reach), (0, 0)], mode="edge")
    taps = oaconvolve(extended[..., None], basis[:, None], mode="valid", axes=0)
    return taps.reshape(len(signal), -1)


def _products(columns):
    """Compute the inner products of columns in each block of time.

    The result has the shape (blocks, columns, columns).
    """
    return np.array([block.T @ block for block in np.array_split(columns, BLOCKS)])


class _Fits:
    """Fits of m targets t_k by p regressors Phi_k.

    The targets have the shape (trial, time, m), and the regressors have the shape (trial, time, p).
    The flag `known` says whether the fits are deviations from a model, which may be diagonal.
    """

    def __init__(self, Phi, t, known=False):
        self.K, _, self.m = t.shape
        self.coupling = (1.0,)  # candidates for the weight of coupling
        if known and self.m > 1:
            self.coupling = (1.0, DIAGONAL_WEIGHT) if self.K > 1 else (DIAGONAL_WEIGHT,)
        columns = np.concatenate([Phi, t], axis=2)
        self.mean = columns.mean(axis=0)
        within = sum(map(_products, columns - self.mean))
        self.products = np.array([within, self.K * _products(self.mean)])  # the sums of (4)
        self.power = np.diagonal(self.products, 0, 2, 3).sum(axis=1)[:, -self.m :]  # of targets

    def first_signal(self, new, f, rho):
        """Compute F r + c, with c of (3), for a new reference r.

        The argument `new` holds the regressors of r.
        """
        Phi, t = np.split(np.pad(self.mean, [(0, len(new)), (0, 0)])[: len(new)], [-self.m], axis=1)
        return new @ f + (1 - rho) * (t - Phi @ f)

    def likeliest(self, ratios):
        """Find f with the likeliest weights of each output, and f without each block of time.

        f has the shape (p, m).
        """
        candidates = [*product(ratios, (1.0, STATIC_WEIGHT), self.coupling, WEIGHTS)]
        best = np.argmax([self.likelihood(*weights) for weights in candidates], axis=0)
        fits = [self.solve(*candidates[k])[..., i] for i, k in enumerate(best)]
        f, *without = np.stack(fits, axis=-1)
        return f, np.array(without)

    def solve(self, rho, static, coupling, weight):
        """Compute f of (4) from all blocks of time, and then without each block.

        The result has the shape (1 + blocks, p, m).
        """
        blocks = np.tensordot([1, rho], self.products, 1)
        total = blocks.sum(axis=0)
        sums, p = np.concatenate([total[None], total - blocks]), len(total) - self.m
        mean, taps = np.mean(np.diagonal(total)[:p]) or 1.0, p // self.m
        f = []
        for i in range(self.m):
            D = np.ones((self.m, taps))
            D[:, taps // 2] = static
            D[np.arange(self.m) != i] *= coupling
            penalty = weight * mean * np.diag(D.ravel())
            f.append(np.linalg.solve(sums[:, :p, :p] + penalty, sums[:, :p, [p + i]]))
        return np.concatenate(f, axis=2)

    def squares(self, f):
        """Compute the sums of squares of t - Phi f in each block of time.

        The f of a block is passed for each block. The sums are computed for differences between
        trials, and for means of trials.
        """
        one = np.broadcast_to(np.eye(self.m), (BLOCKS, self.m, self.m))
        R = np.concatenate([-f, one], axis=1)  # from (Phi, t) to t - Phi f
        return np.maximum(0, np.sum(R * (self.products @ R), axis=(1, 2)))  # rounding may be < 0

    def likelihood(self, rho, static, coupling, weight):
        """Compute the log-likelihood of each output.

        Each block of time is predicted by a fit that left this block out.
        """
        without = self.solve(rho, static, coupling, weight)[1:]
        power = self.power.sum(axis=0)
        floor = ROUNDED_POWER * np.where(power > 0, power, 1.0)
        free = (static == 1) + (coupling == 1 and len(self.coupling) > 1)
        prior = self.K * np.log(PENALTY) * free
        return [1 - self.K, -1] @ np.log(self.squares(without) + floor) - prior

    def variances(self, without):
        """Estimate rho, and the predicted share of each of the m outputs.

        Both are computed from residuals in blocks of time that the fits left out.
        """
        missed, rho = self.squares(without), np.ones(self.m)
        if self.K > 1:
            rho = np.minimum(
                1.0, missed[0] / (self.K - 1) / np.maximum(missed[1], SMALLEST_DIVISOR)
            )
        missed, power = (squares[0] + rho * squares[1] for squares in (missed, self.power))
        return rho, 1 - np.divide(missed, power, out=np.zeros(self.m), where=power > 0)


def _warnings(result, outputs):
    """Yield a warning for each output whose first signal is poorly predicted or uncertain."""
    sizes = np.sqrt(np.mean(result.v**2, axis=0))
    each = zip(outputs, result.predicted, sizes, result.uncertainty, strict=True)
    for name, predicted, size, off in each:
        if predicted < PREDICTED:
            yield (
                f"F predicts only {predicted:.0%} of v + e for {name}: if another "
                "disturbance came, an actuator saturated, or the plant was another one, leave "
                "these trials out, by isel"
            )
        if off > UNCERTAIN * size:
            yield (
                f"v for {name}, of RMS {size:.3g}, may be wrong by {off:.3g}, because the trials "
                "do not distinguish the response to this reference from a repeating disturbance: "
                "pass also the first trials, where v was different, or trials of another task"
            )
