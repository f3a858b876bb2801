"""Does the finite trial converge? The norm of what one trial of the ILC law really does.

Lemma 1 is about signals without end; here the two ends of the trial are included.
"""

from dataclasses import replace

import control
import numpy as np
import scipy.sparse.linalg as sparse
from scipy.fft import irfft, next_fast_len, rfft
from scipy.sparse import diags_array, eye_array

from rodlib.ilc import arguments
from rodlib.ilc.filters import ENDS, LearningFilter, ZeroPhaseButterworth
from rodlib.ilc.models import impulse_response, sampled_plant
from rodlib.ilc.signals import check_match

LANCZOS = 60  # vectors that the Lanczos iteration keeps


def trial_operators(
    P: control.StateSpace, Q: ZeroPhaseButterworth, L: LearningFilter, samples: int
) -> tuple[sparse.LinearOperator, sparse.LinearOperator, sparse.LinearOperator]:
    """P, Q and L as they act on a trial of finite length, each with its adjoint.

    Parameters
    ----------
    P : control.StateSpace
        In discrete time, m inputs (w), m outputs (y); acts from rest.
    Q, L : ZeroPhaseButterworth, LearningFilter
        Act as in :class:`rodlib.Law`, with their own `ends`.
    samples : int
        Length of the trial.

    Returns
    -------
    P_N, Q_N, L_N : scipy.sparse.linalg.LinearOperator, shape (samples m, samples m)
        On signals of shape (samples, m), raveled. P_N is a lower triangular block Toeplitz
        matrix. Q_N and L_N are block Toeplitz if `ends` is "zero"; where an end is held, what the
        matrix would do to the samples beyond it is added to its first or last block column.
    """
    P = sampled_plant(P, "P")
    arguments.instance("Q", Q, ZeroPhaseButterworth)
    m = arguments.instance("L", L, LearningFilter).channels
    if (P.noutputs, P.ninputs) != (m, m):
        raise ValueError(f"P is {P.noutputs} by {P.ninputs}, but L is {m} by {m}")
    check_match(P=P, L=L, Q=Q)
    samples = arguments.whole("samples", samples, 1)

    length = next_fast_len(2 * samples, real=True)
    spectrum = rfft(impulse_response(P, samples), length, axis=0)

    def P_apply(signal, spectrum=spectrum):
        product = spectrum @ rfft(signal, length, axis=-2)[..., None]
        return irfft(product[..., 0], length, axis=-2)[..., :samples, :]

    def P_adjoint(signal):  # the adjoint of a convolution runs backward in time
        transposed = np.swapaxes(spectrum, -1, -2)
        return np.flip(P_apply(np.flip(signal, axis=-2), transposed), axis=-2)

    reach, two_sided = Q.decay, replace(Q, ends="zero")

    def Q_adjoint(signal):
        if Q.ends == "zero":  # a symmetric Toeplitz matrix
            return Q.apply(signal)
        padding = [(0, 0)] * (signal.ndim - 2) + [(reach, reach), (0, 0)]
        return _fold(two_sided.apply(np.pad(signal, padding)), reach, reach, Q.ends)

    def L_adjoint(signal):
        out = np.zeros((*signal.shape[:-2], samples + L.order, m))
        for k in range(1, L.order + 1):
            out[..., k : k + samples, :] += signal @ L.coefficients[:, :, k - 1]
        return _fold(out, 0, L.order, L.ends)

    pairs = [(P_apply, P_adjoint), (Q.apply, Q_adjoint), (L.apply, L_adjoint)]
    return tuple(_operator(apply, adjoint, samples, m) for apply, adjoint in pairs)


def trial_map(
    P: control.StateSpace,
    Q: ZeroPhaseButterworth,
    L: LearningFilter,
    samples: int,
    rest: int = 0,
) -> sparse.LinearOperator:
    """T = Q_N (I - L_N P_N): what a trial of the ILC law (23) makes of v_k - v_inf.

    v_{k+1} - v_inf = T (v_k - v_inf) and e_k - e_inf = -P_N (v_k - v_inf), exactly. Parameters as
    for :func:`trial_operators`; in the last `rest` samples of each trial, v is held at zero.

    The error alone has no such map. P_N maps the last sample of v to zero (P has a delay), and
    maps the exponentials z^p of its zeros z outside the unit circle, which live at the end of
    the trial, to next to nothing; Q_N then moves them to where they show. So M = P Q (P^-1 - L)
    of (35) does not carry over, and Q_N (I - P_N L_N) is not the operator of any trial.
    """
    P_N, Q_N, L_N = trial_operators(P, Q, L, samples)
    rest = arguments.whole("rest", rest, 0, samples - 1)
    active = np.repeat(np.arange(samples) < samples - rest, L.channels)
    active = sparse.aslinearoperator(diags_array(active.astype(float)))
    T = Q_N @ (sparse.aslinearoperator(eye_array(P_N.shape[0])) - L_N @ P_N)
    return active @ T @ active if rest else T


def trial_norm(
    P: control.StateSpace,
    Q: ZeroPhaseButterworth,
    L: LearningFilter,
    samples: int,
    trials: int = 1,
    rest: int = 0,
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
        Largest ||v_{k+trials} - v_inf|| / ||v_k - v_inf||. Below one for trials = 1, v converges
        monotonically. Lanczos approaches it from below, or a RuntimeError says that it does not
        converge; short trials have an SVD.
    before, after : ndarray, shape (samples, m)
        The unit v_k - v_inf that is amplified most, and what becomes of it.
    """
    trials = arguments.whole("trials", trials, 1)
    T = trial_map(P, Q, L, samples, rest) ** trials
    size = T.shape[1]
    if size <= LANCZOS:
        before = np.linalg.svd(T @ np.eye(size))[2][0]
    else:
        start = np.random.default_rng(0).standard_normal(size)  # the same in every run
        try:
            _, vectors = sparse.eigsh(T.H @ T, k=1, v0=start, tol=1e-8, ncv=LANCZOS)
        except sparse.ArpackNoConvergence as error:
            raise RuntimeError(
                f"the Lanczos iteration did not converge: {error}"
            ) from error
        before = vectors[:, 0]
    after = T.matvec(before)
    norm = float(np.linalg.norm(after))
    return norm, before.reshape(samples, -1), after.reshape(samples, -1)


def _operator(apply, adjoint, samples, m):
    """A linear operator on raveled signals, one or several side by side."""

    def on_columns(function):
        def matmat(X):
            signals = np.moveaxis(np.reshape(X, (samples, m, -1)), -1, 0)
            return np.moveaxis(function(signals), 0, -1).reshape(samples * m, -1)

        return matmat

    size, forward, backward = samples * m, on_columns(apply), on_columns(adjoint)
    return sparse.LinearOperator(
        (size, size),
        matvec=forward,
        rmatvec=backward,
        matmat=forward,
        rmatmat=backward,
        dtype=float,
    )


def _fold(signal, before, after, ends):
    """Adjoint of holding ends: what lies beyond one that is held is added to the sample there."""
    samples = signal.shape[-2] - before - after
    out = signal[..., before : before + samples, :].copy()
    first, last = (mode == "edge" for mode in ENDS[ends])
    if first:
        out[..., 0, :] += signal[..., :before, :].sum(axis=-2)
    if last:
        out[..., -1, :] += signal[..., before + samples :, :].sum(axis=-2)
    return out
