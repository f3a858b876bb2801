"""Do trials of finite length converge? The norm of the map of v from one trial to the next.

Lemma 1 of the paper holds for signals of infinite length. This module includes the effects of the
beginning and of the end of a trial.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.sparse.linalg as sparse
from scipy.sparse import diags_array, eye_array

from ilctools import arguments
from ilctools.evidence.worst_trial import largest_trial_norm
from ilctools.filters import Filter, LearningFilter, ZeroPhaseButterworth
from ilctools.models import Model, impulse_response, sampled_plant
from ilctools.norm_optimal import NormOptimal
from ilctools.signals import check_match

SETTLED = 0.02  # share of the response to a disturbance that remains when a plant has settled
SHORTEST_TRIAL, LONGEST_TRIAL = (50, 1000)  # samples; longer trials of several plants take seconds
LANCZOS = 30  # vectors that the Lanczos iteration keeps: with 15 it takes half as long again
# A matrix of up to SMALL columns is made dense, and its SVD is computed, which takes no longer than
# two or three Lanczos rounds. A matrix of up to DENSE columns is made dense if a Lanczos iteration
# of as many products has not converged. This happens if many directions have the same gain, such as
# the directions that a long delay keeps the plant from answering.
SMALL, DENSE = 300, 1000
MOST_REACHED = 4000  # most numbers in v, for which the basis in learned_basis takes 10 s
RANK_TOLERANCE = 1e-10  # of the largest singular value of Q_N L_N: smaller values are rounding


def trial_operators(
    P: Model, Q: ZeroPhaseButterworth, L: Filter, samples: int
) -> tuple[sparse.LinearOperator, sparse.LinearOperator, sparse.LinearOperator]:
    """Return P, Q and L as operators on a trial of finite length, each with its adjoint.

    Parameters
    ----------
    P : control.StateSpace
        Model in discrete time, from v (m inputs) to y (p outputs). A trial starts at rest.
    Q, L : ZeroPhaseButterworth, LearningFilter
        Filters, which act as in :class:`ilctools.Law`. The attribute `ends` of each filter says
        which values the filter takes beyond the ends of a trial.
    samples : int
        Number of samples in the trial.

    Returns
    -------
    P_N, Q_N, L_N : scipy.sparse.linalg.LinearOperator
        Operators on raveled signals of shape (samples, m) or (samples, p). P_N has the shape
        (samples p, samples m), Q_N has (samples m, samples m), and L_N has (samples m, samples p).
        P_N is a lower triangular block Toeplitz matrix. Q_N and L_N are block Toeplitz if `ends` is
        "zero". With "hold", the first and the last value of a signal are repeated beyond the ends
        of the trial. The effect of these repeated values is added to the first and the last block
        column. With "hold-last", only the last value is repeated.

    See Also
    --------
    trial_map : the map that one trial applies to v

    Examples
    --------
    >>> import control
    >>> import numpy as np
    >>> from ilctools import LearningFilter, trial_operators, zero_phase_butterworth
    >>> P, L = control.ss(0.5, 0.5, 1, 0, 1.0), LearningFilter([[[0.8]]], Ts=1.0)
    >>> P_N, Q_N, L_N = trial_operators(P, zero_phase_butterworth(2, 0.1, 1.0), L, samples=4)
    >>> (P_N @ np.ones(4))[1:].round(3)
    array([0.5  , 0.75 , 0.875])
    """
    P = sampled_plant(P, "P")
    arguments.instance("Q", Q, ZeroPhaseButterworth)
    m, p = arguments.instance("L", L, Filter | NormOptimal).rows, L.columns
    if (P.noutputs, P.ninputs) != (p, m):
        raise ValueError(f"P is {P.noutputs} by {P.ninputs}, but L is {m} by {p}")
    check_match(P=P, L=L, Q=Q)
    samples = arguments.whole("samples", samples, 1)

    h = np.moveaxis(impulse_response(P, samples), 0, -1)
    from_rest = LearningFilter(h[..., ::-1], L.Ts, first=1 - samples)  # P as a filter of the past
    return (
        _on_trial(from_rest, samples, made=p, taken=m),
        _on_trial(Q, samples, made=m, taken=m),
        _on_trial(L, samples, made=m, taken=p),
    )


def trial_map(
    P: Model, Q: ZeroPhaseButterworth, L: Filter, samples: int, rest: int = 0
) -> sparse.LinearOperator:
    """Return T = Q_N (I - L_N P_N), the map from v_k - v_inf to v_{k+1} - v_inf in a finite trial.

    Here v_k is the ILC signal of trial k, and v_inf is its limit after many trials. P_N, Q_N, L_N
    are the matrices of P, Q and L on a trial of N samples. They are also called "lifted" operators,
    see D. A. Bristow, M. Tharayil and A. G. Alleyne, A survey of iterative learning control, IEEE
    Control Systems Magazine 26 (2006).

    If no actuator saturates, v_{k+1} - v_inf = T (v_k - v_inf) and e_k - e_inf = -P_N (v_k - v_inf)
    hold exactly. With a learning gain a, the map is (1 - a) I + a T. The parameters are as for
    :func:`trial_operators`. In the last `rest` samples of each trial, v is zero.

    No such map exists for the error alone. P has a delay, so that P_N maps the last sample of v to
    zero. For a zero z of P outside the unit circle, the signal z^p is an exponential that is large
    only at the end of the trial. P_N maps this exponential to almost zero, so that the error hardly
    shows it. Q_N then spreads the exponential to other samples, where it does change the outputs.
    M = P Q (P^-1 - L), equation (35) of the paper, therefore does not hold for a finite trial.
    Q_N (I - P_N L_N) is not the operator of any trial.

    See Also
    --------
    trial_norm : the largest gain of the map
    trial_operators : the factors of the map

    Examples
    --------
    >>> import control
    >>> from ilctools import LearningFilter, trial_map, zero_phase_butterworth
    >>> P, L = control.ss(0.5, 0.5, 1, 0, 1.0), LearningFilter([[[0.8]]], Ts=1.0)
    >>> trial_map(P, zero_phase_butterworth(2, 0.1, 1.0), L, samples=100).shape
    (100, 100)
    """
    P_N, Q_N, L_N = trial_operators(P, Q, L, samples)
    rest = arguments.whole("rest", rest, 0, samples - 1)
    learned = np.arange(samples * L.rows) < (samples - rest) * L.rows
    at_rest = sparse.aslinearoperator(diags_array(learned.astype(float)))
    identity = sparse.aslinearoperator(eye_array(learned.size))
    return at_rest @ Q_N @ (identity - L_N @ P_N) @ at_rest


def trial_norm(
    P: Model, Q: ZeroPhaseButterworth, L: Filter, samples: int, trials: int = 1, rest: int = 0
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the 2-norm of the map of the ILC signal v from one finite trial to the next.

    The norm is the largest factor by which the distance of v from its limit can grow.

    Parameters
    ----------
    P, Q, L, samples, rest :
        As for :func:`trial_map`.
    trials : int
        Number of consecutive trials. The norm is the norm of T^trials, with the T of
        :func:`trial_map`.

    Returns
    -------
    norm : float
        Largest ||v_{k+trials} - v_inf|| / ||v_k - v_inf||. If P has more inputs than outputs, only
        the v that the law can learn count, see :func:`learned_basis`. If the norm is below one for
        trials = 1, v converges monotonically. The norm is computed by Lanczos iteration, which
        approaches the norm from below. If the iteration does not converge, a RuntimeError is
        raised. If v has few values, an SVD replaces the iteration. If v has up to 1000 values, an
        SVD replaces an iteration that takes long.
    before, after : ndarray, shape (samples, m)
        `before` is the v_k - v_inf of norm one that is amplified most. `after` is the resulting
        v_{k+trials} - v_inf.

    See Also
    --------
    trial_map : the map itself
    convergence : how fast trials of infinite length converge

    Examples
    --------
    >>> import control
    >>> from ilctools import LearningFilter, trial_norm, zero_phase_butterworth
    >>> P, L = control.ss(0.5, 0.5, 1, 0, 1.0), LearningFilter([[[0.8]]], Ts=1.0)
    >>> norm, worst, image = trial_norm(P, zero_phase_butterworth(2, 0.1, 1.0), L, samples=100)
    >>> round(float(norm), 3), worst.shape
    (0.21, (100, 1))
    """
    trials = arguments.whole("trials", trials, 1)
    T = trial_map(P, Q, L, samples, rest) ** trials
    if L.rows <= L.columns and np.all(getattr(L, "weight_of_errors", 1.0)):
        norm, before, after = _largest(T)
    else:
        basis = sparse.aslinearoperator(learned_basis(Q, L, samples, rest))
        norm, before, after = _largest(T @ basis)
        before = basis @ before
    return norm, before.reshape(samples, -1), after.reshape(samples, -1)


@lru_cache(maxsize=4)
def learned_basis(Q: ZeroPhaseButterworth, L: Filter, samples: int, rest: int) -> np.ndarray:
    """Return orthonormal columns that span all v that Q_N L_N computes from errors.

    If there are more inputs than outputs, or if only the errors at some points of time count, most
    v do not change any counted error. Only Q_N reduces such a v from trial to trial, and the norm
    of T of :func:`trial_map` over all v is therefore one. If learning begins with v = 0, the law
    adds almost none of these v. The norm is therefore computed without these v.
    """
    size = samples * L.rows
    if size > MOST_REACHED:
        raise ValueError(
            f"samples = {samples}, with {L.rows} learned inputs and {L.columns} outputs, makes "
            f"{size} numbers, but with more than {MOST_REACHED} the norm takes minutes: take a "
            "shorter trial"
        )
    errors = np.eye(samples * L.columns).reshape(-1, samples, L.columns)
    made = Q.apply(L.apply(errors))
    made[:, samples - rest :] = 0
    U, S, _ = np.linalg.svd(made.reshape(len(made), -1).T, full_matrices=False)
    return U[:, RANK_TOLERANCE * S[0] < S]


def _largest(T) -> tuple[float, np.ndarray, np.ndarray]:
    """Compute the largest singular value of T, its right singular vector x, and T x."""
    size = T.shape[1]
    if size <= SMALL:
        before = np.linalg.svd(T @ np.eye(size))[2][0]
    else:
        start = np.random.default_rng(0).standard_normal(size)  # the same numbers in every run
        rounds = 1 + size // LANCZOS if size <= DENSE else None  # of LANCZOS products each
        try:
            _, vectors = sparse.eigsh(T.H @ T, k=1, v0=start, tol=1e-8, ncv=LANCZOS, maxiter=rounds)
            before = vectors[:, 0]
        except sparse.ArpackNoConvergence:  # a RuntimeError
            if size > DENSE:
                raise
            before = np.linalg.svd(T @ np.eye(size))[2][0]
    after = T.matvec(before)
    return float(np.linalg.norm(after)), before, after


class SettledTrial(NamedTuple):
    """The length and the norm of a trial in which all plants settle, see `trial_norm`."""

    samples: int  # zero if a plant or Q is known by samples only
    norm: float  # the largest :func:`trial_norm` among the plants


def settled_trial(plants, Q: ZeroPhaseButterworth, L: Filter) -> SettledTrial:
    """Return the length and the norm of a trial that is long enough for all plants to settle.

    The trial is ten times as long as the slowest plant needs to settle, and at least twice as long
    as the largest delay. `SHORTEST_TRIAL` samples are added to this length. The length is limited
    to `LONGEST_TRIAL`, divided by the number of inputs. With several plants, a single Lanczos
    iteration finds the largest norm among the plants.
    """
    slowest = max(np.abs(P.poles()).max(initial=0) for P in plants)
    settled = np.log(SETTLED) / np.log(np.clip(slowest, SETTLED, 1 - 1e-9))
    settled = max(10 * settled, *(2 * _delay(P) for P in plants))
    samples = int(min(settled + SHORTEST_TRIAL, LONGEST_TRIAL / L.rows))
    if len(plants) == 1:
        norm, *_ = trial_norm(plants[0], Q, L, samples)
        return SettledTrial(samples, norm)
    basis = learned_basis(Q, L, samples, rest=0) if L.rows > L.columns else None
    return SettledTrial(samples, largest_trial_norm(plants, Q, L, samples, basis))


def _delay(P):
    """Return the largest delay, in samples, among the nonzero entries of a model."""
    answers = impulse_response(P, LONGEST_TRIAL) != 0
    return answers.argmax(axis=0).max()


def _on_trial(f, samples, made, taken):
    """Convert a filter into a linear operator on the raveled signals of one trial.

    The operator maps signals with `taken` channels to signals with `made` channels.
    """

    def raveled(apply, channels):
        def on_columns(X):
            signals = apply(X.T.reshape(-1, samples, channels))
            return signals.reshape(*X.T.shape[:-1], -1).T

        return on_columns

    to, back = raveled(f.apply, taken), raveled(f.apply_transposed, made)
    shape = samples * made, samples * taken
    return sparse.LinearOperator(
        shape, matvec=to, rmatvec=back, matmat=to, rmatmat=back, dtype=float
    )
