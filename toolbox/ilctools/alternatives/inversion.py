"""Learning by the inverse of the plant, or by its adjoint: both act in two directions of time."""

import control
import numpy as np

from ilctools import arguments
from ilctools.alternatives.two_sided import TwoSidedFilter
from ilctools.filters import zero_phase_butterworth
from ilctools.models import frequency_response, sampled_plant


def stable_inversion(
    P: control.StateSpace, gain: float = 1.0, cutoff: float | None = None
) -> TwoSidedFilter:
    """L = gain P^-1 F, with a low-pass filter F, stable in both directions of time together.

    Poles of the inverse inside the unit circle act forward, those outside backward in time: that is
    what the inverse transform of the response makes of them. S. Devasia, D. Chen and B. Paden,
    Nonlinear inversion-based output tracking, IEEE Transactions on Automatic Control 41 (1996)
    930-942; for ILC the first designs of the paper's [9].

    Parameters
    ----------
    P : control.StateSpace
        In discrete time, m inputs and m outputs, stable.
    gain : float
        In (0, 1].
    cutoff : float, optional
        Of F, a Butterworth filter of order 2 applied forward and backward in time, rad/s: where a
        plant passes next to nothing, its inverse is large. Default: no F.

    Returns
    -------
    TwoSidedFilter
        Of a model with a zero on the unit circle, a ValueError says so when it is applied.
    """
    gain, (m, Ts) = arguments.share("gain", gain), square(P)
    low_pass = _low_pass(cutoff, Ts)

    def response(omega):
        F = low_pass(omega)[:, None, None]
        return gain * F * np.linalg.inv(frequency_response(P, omega))

    return TwoSidedFilter(response, m, Ts)


def zero_phase_inversion(
    P: control.StateSpace, gain: float = 1.0, cutoff: float | None = None
) -> TwoSidedFilter:
    """Zero-phase-error tracking, each channel by itself: the zeros outside are not inverted.

    With the zeros zeta of P_ii outside the unit circle or on it,

        L_ii = gain P_ii^-1 F prod |z - zeta|^2 / |1 - zeta|^2   on the unit circle,

    so that P_ii L_ii is real, and `gain` at frequency zero. The coupling is left out of the design.
    M. Tomizuka, Zero phase error tracking algorithm for
    digital control, Journal of Dynamic Systems, Measurement, and Control 109 (1987) 65-68, the
    paper's [10].

    Parameters and result as for :func:`stable_inversion`; of a model with a zero at frequency zero
    a ValueError says that there is none.
    """
    gain, (m, Ts) = arguments.share("gain", gain), square(P)
    low_pass = _low_pass(cutoff, Ts)
    zeros = [outer_zeros(P[i, i]) for i in range(m)]
    for i in range(m):
        if np.any(np.abs(zeros[i] - 1) < 1e-9):
            raise ValueError(f"P[{i}, {i}] has a zero at frequency zero: no L undoes it")

    def response(omega):
        z = np.exp(1j * omega * Ts)[:, None]
        P_response, F = frequency_response(P, omega), low_pass(omega)
        L = np.zeros(P_response.shape, complex)
        for i in range(m):
            factor = np.prod(np.abs((z - zeros[i]) / (1 - zeros[i])) ** 2, axis=1)
            L[:, i, i] = gain * F * factor / P_response[:, i, i]
        return L

    return TwoSidedFilter(response, m, Ts)


def gradient(P: control.StateSpace, step: float) -> TwoSidedFilter:
    """L = step P^*, the adjoint of P: the plant with its time reversed, step P_N^T on N samples.

    v moves against the gradient of ||e||^2 / 2, which is -P^* e. Without Q the rate is
    max |1 - step sigma^2| over the singular values sigma of P, so that `step` must be below
    2 / max sigma^2, and what P hardly passes is hardly learned. K. Furuta and M. Yamakita, The
    design of a learning control system for multivariable systems, IEEE International Symposium on
    Intelligent Control (1987) 371-376. P as for :func:`stable_inversion`; the step is above zero.
    """
    step, (m, Ts) = arguments.positive("step", step), square(P)

    def response(omega):
        return step * frequency_response(P, omega).conj().swapaxes(1, 2)

    return TwoSidedFilter(response, m, Ts)


def _low_pass(cutoff, Ts):
    if cutoff is None:
        return np.ones_like
    return zero_phase_butterworth(2, cutoff, Ts).frequency_response


def outer_zeros(P: control.StateSpace) -> np.ndarray:
    """Zeros of a square model outside the unit circle, or on it up to rounding."""
    zeros = control.zeros(P)
    zeros = zeros[np.isfinite(zeros)]
    return zeros[np.abs(zeros) > 1 - 1e-9]


def square(P: control.StateSpace) -> tuple[int, float]:
    """Number of channels and sampling period (s) of a model that L can be designed for."""
    sampled_plant(arguments.state_space("P", P), "P")
    arguments.square("P", P.ninputs, P.noutputs)
    arguments.stable("P", P.poles())
    return P.noutputs, float(P.dt)
