"""P-type and PD-type learning: the error, and its slope, a few samples later."""

import numpy as np

from ilctools import arguments
from ilctools.filters import LearningFilter


def p_type(gain: float, ahead: int, channels: int, Ts: float) -> LearningFilter:
    """L(q) = gain q^ahead I: what went wrong `ahead` samples later is added now.

    S. Arimoto, S. Kawamura and F. Miyazaki, Bettering operation of robots by learning, Journal of
    Robotic Systems 1 (1984) 123-140; the shift makes up for the delay of the plant. Parameters and
    result as for :func:`pd_type`, with a slope of zero.
    """
    return pd_type(gain, 0.0, arguments.whole("ahead", ahead, 1), channels, Ts)


def pd_type(gain: float, slope: float, ahead: int, channels: int, Ts: float) -> LearningFilter:
    """L(q) = (gain + slope (1 - 1/q) / Ts) q^ahead I, with the slope of the error as well.

    S. Arimoto, S. Kawamura and F. Miyazaki, as for :func:`p_type`.

    Parameters
    ----------
    gain : float
        Above zero, unit of w per unit of y.
    slope : float
        In the same unit times s.
    ahead : int
        Samples, one or more; two or more unless the slope is zero, since a filter (44) looks ahead.
    channels : int
    Ts : float
        Sampling period, s.
    """
    gain = arguments.positive("gain", gain)
    slope = arguments.number("slope", slope, "a finite number")
    Ts = arguments.sampling_period("Ts", Ts)
    ahead = arguments.whole("ahead", ahead, 2 if slope else 1)
    coefficients = np.zeros(ahead)
    coefficients[-1] = gain + slope / Ts
    if slope:
        coefficients[-2] = -slope / Ts
    identity = np.eye(arguments.whole("channels", channels, 1))
    return LearningFilter(identity[..., None] * coefficients, Ts)
