"""Causal models with the singular values of L and of I - P L, for which a peak can be proven."""

import control
import numpy as np

from rodlib.ilc.filters import LearningFilter


def learning_model(L: LearningFilter) -> control.StateSpace:
    """Causal model of z^-n_L L(z), whose singular values are those of L of (44)."""
    # y(p) = c_nL e(p) + ... + c_1 e(p - nL + 1), with m (n_L - 1) states e(p - 1), e(p - 2) ...
    # A delay has gain one at every frequency, so it changes no singular value.
    m, _, order = L.coefficients.shape
    newest_first = np.concatenate([L.coefficients[:, :, k] for k in range(order - 1, -1, -1)], 1)
    states = m * (order - 1)
    return control.ss(
        np.eye(states, k=-m), np.eye(states, m), newest_first[:, m:], newest_first[:, :m], L.Ts
    )


def error_model(P: control.StateSpace, L: LearningFilter) -> control.StateSpace:
    """Causal model of z^-n_L (I - P L): |Q| times its singular values are those of M of (40)."""
    m = len(L.coefficients)
    # The taps of z^-n_L L and the delay of the direct path share a chain, e(p - 1) ... e(p - n_L).
    # L in a unit that makes its taps of order one, and P in its inverse, so that the entries of A
    # below are, too; see peak.balanced.
    unit = 2.0 ** np.round(np.log2(np.abs(L.coefficients).max() or 1))
    taps, chain = learning_model(LearningFilter(L.coefficients / unit, L.Ts)), m * L.order
    P_C, P_D = unit * P.C, unit * P.D
    taps_C = np.hstack([taps.C, np.zeros((m, m))])
    delay_C = np.eye(m, chain, k=chain - m)
    return control.ss(
        np.block([[np.eye(chain, k=-m), np.zeros((chain, P.nstates))], [P.B @ taps_C, P.A]]),
        np.vstack([np.eye(chain, m), P.B @ taps.D]),
        np.hstack([delay_C - P_D @ taps_C, -P_C]),
        -P_D @ taps.D,
        L.Ts,
    )
