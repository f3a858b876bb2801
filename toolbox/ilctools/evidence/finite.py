"""Does the finite trial converge? The norm of what one trial of the ILC law really does.

Lemma 1 is about signals without end; here the two ends of the trial are included.
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

SETTLED = 0.02  # of a disturbance
SHORTEST_TRIAL, LONGEST_TRIAL = (50, 1000)  # samples; longer trials of several plants take seconds
LANCZOS = 30  # vectors that the Lanczos iteration keeps: with 15 it takes half as long again
# Rounds of it, of LANCZOS products each, before the SVD of a matrix of up to DENSE rows: it takes
# no longer. Many directions that grow alike, as those that a long delay leaves alone, need it.
ROUNDS, DENSE = 60, 1000
MOST_REACHED = 4000  # numbers in v, of which a basis takes 10 s
RANK_TOLERANCE = 1e-10  # of the largest singular value of Q_N L_N: what is less is rounding


def trial_operators(
    P: Model, Q: ZeroPhaseButterworth, L: Filter, samples: int
) -> tuple[sparse.LinearOperator, sparse.LinearOperator, sparse.LinearOperator]:
    """P, Q and L as they act on a trial of finite length, each with its adjoint.

    Parameters
    ----------
    P : control.StateSpace
        In discrete time, from v (m) to y (p); acts from rest.
    Q, L : ZeroPhaseButterworth, LearningFilter
        Act as in :class:`ilctools.Law`, with their own `ends`.
    samples : int
        Length of the trial.

    Returns
    -------
    P_N, Q_N, L_N : scipy.sparse.linalg.LinearOperator
        On signals of shape (samples, m) or (samples, p), raveled: P_N has the shape (samples p,
        samples m), Q_N (samples m, samples m) and L_N (samples m, samples p). P_N is a lower
        triangular block Toeplitz matrix. Q_N and L_N are block Toeplitz if `ends` is "zero"; where
        an end is held, what the matrix would do to the samples beyond it is added to its first or
        last block column.

    See Also
    --------
    trial_map : what a trial makes of v

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
    from_rest = LearningFilter(h[..., ::-1], L.Ts, first=1 - samples)  # of P, which looks back
    return (
        _on_trial(from_rest, samples, made=p, taken=m),
        _on_trial(Q, samples, made=m, taken=m),
        _on_trial(L, samples, made=m, taken=p),
    )


def trial_map(
    P: Model, Q: ZeroPhaseButterworth, L: Filter, samples: int, rest: int = 0
) -> sparse.LinearOperator:
    """T = Q_N (I - L_N P_N): what a trial of the law makes of v_k - v_inf, with its two ends.

    P_N, Q_N, L_N are matrices on a trial of N samples ("lifted"): D. A. Bristow, M. Tharayil and
    A. G. Alleyne, A survey of iterative learning control, IEEE Control Systems Magazine 26 (2006).

    v_{k+1} - v_inf = T (v_k - v_inf) and e_k - e_inf = -P_N (v_k - v_inf), exactly; with a learning
    gain a, (1 - a) I + a T; without limits. Parameters as for :func:`trial_operators`; in the last
    `rest` samples of each trial, v is held at zero.

    The error alone has no such map. P_N maps the last sample of v to zero (P has a delay), and
    maps the exponentials z^p of its zeros z outside the unit circle, which live at the end of
    the trial, to next to nothing; Q_N then moves them to where they show. So M = P Q (P^-1 - L)
    of (35) does not carry over, and Q_N (I - P_N L_N) is not the operator of any trial.

    See Also
    --------
    trial_norm : its largest gain
    trial_operators : what it is made of

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
    """2-norm of the trial-to-trial map of the ILC signal on a finite trial.

    Parameters
    ----------
    P, Q, L, samples, rest :
        As for :func:`trial_map`.
    trials : int
        Number of trials in a row: the norm of T^trials.

    Returns
    -------
    norm : float
        Largest ||v_{k+trials} - v_inf|| / ||v_k - v_inf||; with more inputs than outputs, among
        those that Q L makes of errors, see :func:`learned_basis`. Below one for trials = 1, v
        converges monotonically. Lanczos approaches it from below, or a RuntimeError says that it
        does not converge; short trials have an SVD, and those of up to 1000 values where Lanczos
        needs long.
    before, after : ndarray, shape (samples, m)
        The unit v_k - v_inf that is amplified most, and what becomes of it.

    See Also
    --------
    trial_map : the map itself
    convergence : the same of trials without ends

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
    """Orthonormal columns that span what Q_N L_N makes of errors.

    With more inputs than outputs, or where errors at points alone count, most v move none of them.
    Such a v shrinks by Q_N alone, so that the norm of T among all v is one. From v = 0 the law
    makes next to nothing of such v.
    """
    size = samples * L.rows
    if size > MOST_REACHED:
        raise ValueError(
            f"samples = {samples} with {L.rows} learned inputs and {L.columns} outputs are {size} "
            f"numbers, more than {MOST_REACHED}, for which the norm takes minutes: take a shorter "
            "trial"
        )
    errors = np.eye(samples * L.columns).reshape(-1, samples, L.columns)
    made = Q.apply(L.apply(errors))
    made[:, samples - rest :] = 0
    U, S, _ = np.linalg.svd(made.reshape(len(made), -1).T, full_matrices=False)
    return U[:, RANK_TOLERANCE * S[0] < S]


def _largest(T) -> tuple[float, np.ndarray, np.ndarray]:
    """The largest singular value of an operator, and its vectors, before and after."""
    size = T.shape[1]
    if size <= LANCZOS:
        before = np.linalg.svd(T @ np.eye(size))[2][0]
    else:
        start = np.random.default_rng(0).standard_normal(size)  # the same in every run
        rounds = ROUNDS if size <= DENSE else None
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
    """A trial that is long enough to show what v does."""

    samples: int  # none, if the plants or Q are no models
    norm: float  # the largest 2-norm of :func:`trial_map` among the plants


def settled_trial(plants, Q: ZeroPhaseButterworth, L: Filter) -> SettledTrial:
    """A trial ten times as long as plants settle and twice as long as they delay, within limits.

    Its norm is found by one iteration for all plants where there are several.
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
    """Samples after which a model answers at the latest, in each of its entries that answers."""
    answers = impulse_response(P, LONGEST_TRIAL) != 0
    return answers.argmax(axis=0).max()


def _on_trial(f, samples, made, taken):
    """A filter as a linear operator from raveled signals (samples, taken) to (samples, made)."""

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
