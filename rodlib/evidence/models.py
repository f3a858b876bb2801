"""Causal models with the singular values of L and of M, for which a peak can be proven."""

import control
import numpy as np

from rodlib import arguments
from rodlib.filters import LearningFilter, ZeroPhaseButterworth


def learning_model(L: LearningFilter) -> control.StateSpace:
    """Causal model of z^-n_L L(z), whose singular values are those of L of (44).

    Parameters
    ----------
    L : LearningFilter
        Of order n_L with m channels: L(z) = sum_k c_k z^k, k = 1 ... n_L.

    Returns
    -------
    control.StateSpace
        y(p) = c_nL e(p) + c_(nL-1) e(p - 1) + ... + c_1 e(p - nL + 1), with m (n_L - 1) states:
        e(p - 1), e(p - 2), ... A delay has gain one at every frequency, so it changes no
        singular value.
    """
    arguments.instance("L", L, LearningFilter)
    m, _, order = L.coefficients.shape
    newest_first = np.concatenate([L.coefficients[:, :, k] for k in range(order - 1, -1, -1)], 1)
    states = m * (order - 1)
    return control.ss(
        np.eye(states, k=-m), np.eye(states, m), newest_first[:, m:], newest_first[:, :m], L.Ts
    )


def convergence_model(
    P: control.StateSpace, Q: ZeroPhaseButterworth, L: LearningFilter
) -> control.StateSpace:
    """Causal, stable model with the singular values of M = Q (I - P L), (40), at every frequency.

    Parameters
    ----------
    P : control.StateSpace
        Stable, in discrete time, m inputs (w) and m outputs (y): :func:`reduced_loop` for the
        paper's. Its states are taken over as they are.
    Q : ZeroPhaseButterworth
    L : LearningFilter

    Returns
    -------
    control.StateSpace
        H(z)^2 z^-n_L (I - P(z) L(z)), H being the Butterworth filter whose squared magnitude is
        Q: |H(z)^2| = |H(z)|^2 = Q(z) and |z| = 1 on the unit circle, and both are scalars. With
        n states of P it has m n_L + n + 2 n_Q m states, which is the least possible unless
        poles and zeros happen to cancel: the taps of z^-n_L L and the delay of the direct path
        share one chain.

    Raises
    ------
    ValueError
        If P is no state-space model in discrete time with a sampling period in seconds, or not as
        large as L, or the sampling periods differ.

    Notes
    -----
    P L and L P have different singular values: this is the operator on the error, as in Lemma 1,
    not Q (I - L P), which acts on the ILC signal.
    """
    Ts, m = common_size(P, Q, L)

    # The chain holds e(p - 1) ... e(p - n_L). L in a unit that makes its taps of order one, and P
    # in its inverse, so that the entries of A below are, too; see peak.balanced.
    unit = 2.0 ** np.round(np.log2(np.abs(L.coefficients).max() or 1))
    taps, chain = learning_model(LearningFilter(L.coefficients / unit, Ts)), m * L.order
    P_C, P_D = unit * P.C, unit * P.D
    taps_C = np.hstack([taps.C, np.zeros((m, m))])
    delay_C = np.eye(m, chain, k=chain - m)
    I_minus_PL = control.ss(
        np.block([[np.eye(chain, k=-m), np.zeros((chain, P.nstates))], [P.B @ taps_C, P.A]]),
        np.vstack([np.eye(chain, m), P.B @ taps.D]),
        np.hstack([delay_C - P_D @ taps_C, -P_C]),
        -P_D @ taps.D,
        Ts,
    )
    for section in [*Q.sections, *Q.sections]:
        I_minus_PL = _diagonal(section, m, Ts) * I_minus_PL
    return I_minus_PL


def common_size(P, Q, L):
    """Sampling period and number of channels that a plant and the two filters share."""
    Ts = sampling_period("P", P)
    arguments.instance("Q", Q, ZeroPhaseButterworth)
    m = len(arguments.instance("L", L, LearningFilter).coefficients)
    if (P.noutputs, P.ninputs) != (m, m):
        raise ValueError(f"P is {P.noutputs} by {P.ninputs}, but L is {m} by {m}")
    if not np.allclose([Q.Ts, L.Ts], Ts, rtol=1e-12, atol=0):
        raise ValueError(f"P.dt = {Ts} s, Q.Ts = {Q.Ts} s and L.Ts = {L.Ts} s must be equal")
    return Ts, m


def sampling_period(name, system):
    """That of a state-space model, in seconds."""
    arguments.instance(name, system, control.StateSpace)
    if not (system.isdtime(strict=True) and system.dt is not True):
        raise ValueError(f"{name}.dt = {system.dt!r} must be a sampling period in seconds")
    return float(system.dt)


def _diagonal(section, m, Ts):
    """A second-order section (first-order, if it is one) on each of m channels."""
    numerator, denominator = section[:3], section[3:]
    if numerator[2] == denominator[2] == 0:
        numerator, denominator = numerator[:2], denominator[:2]
    order = len(denominator) - 1
    A = np.eye(order, k=1)  # observer form: A has no entry larger than those of the denominator
    A[:, 0] = -denominator[1:]
    B = (numerator - numerator[0] * denominator)[1:, None]
    each = np.eye(m)
    return control.ss(
        np.kron(each, A), np.kron(each, B), np.kron(each, np.eye(1, order)), numerator[0] * each, Ts
    )
