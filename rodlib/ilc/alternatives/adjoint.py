"""Gradient learning: a step against the gradient of the error's energy."""

import control

from rodlib.ilc import arguments
from rodlib.ilc.alternatives.inversion import square
from rodlib.ilc.alternatives.two_sided import TwoSidedFilter
from rodlib.ilc.models import frequency_response


def gradient(P: control.StateSpace, step: float) -> TwoSidedFilter:
    """L = step P^*, the adjoint of P: the plant with its time reversed, step P_N^T on N samples.

    v moves against the gradient of ||e||^2 / 2, which is -P^* e. Without Q the rate is
    max |1 - step sigma^2| over the singular values sigma of P, so that `step` must be below
    2 / max sigma^2, and what P hardly passes is hardly learned. K. Furuta and M. Yamakita, The
    design of a learning control system for multivariable systems, IEEE International Symposium on
    Intelligent Control (1987) 371-376.

    Parameters
    ----------
    P : control.StateSpace
        In discrete time, m inputs and m outputs, stable.
    step : float
        Above zero.
    """
    step, (m, Ts) = arguments.positive("step", step), square(P)
    return TwoSidedFilter(
        lambda omega: step * frequency_response(P, omega).conj().swapaxes(1, 2), m, Ts
    )
