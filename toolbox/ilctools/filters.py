"""The two filters of the ILC law v_{k+1} = Q (v_k + L e_k), equation (23) of the paper.

Q is a low-pass filter, which makes learning robust. L is the learning filter, which computes a
change of v from the error e. Each filter has a frequency response and a method that applies it to a
finite trial. Q and L look ahead in time. This is possible because they act between two trials, when
the whole last trial is known.

Beyond the two ends of a trial nothing has been recorded, so something must be assumed there.
``ends="zero"`` takes every signal as zero outside the trial. The filters are then exactly the
two-sided filters of the analysis. Only those samples of their output that lie within the trial are
kept. ``ends="hold"`` repeats the first sample before the trial and the last sample after the trial.
``ends="hold-last"`` repeats only the last sample, which suits a trial that begins at rest and does
not end at zero.
"""

import warnings
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import BadCoefficients, butter, oaconvolve, sosfilt

from ilctools import arguments, labels

ENDS = {  # whether the first sample is repeated before the trial, and the last one after it
    "zero": (False, False),
    "hold": (True, True),
    "hold-last": (False, True),
}
# Inputs and outputs of the plant: L makes inputs from errors.
AXES_OF_L = (labels.INPUT, labels.OUTPUT, "order")
LONG = 100  # coefficients; above, doubles and fast convolution are used, see `time_shifts`
FARTHEST_TAP = 10**6  # largest number of samples that a filter may look ahead or back
HIGHEST_ORDER = 20  # of Q: a higher number is probably a cut-off, passed as the order
LONGEST_RESPONSE = 10**7  # longest impulse response of Q in each direction of time, samples
ANYWHERE = 1.0  # rad per sample: a frequency at which only the shape of a response is checked
WEIGHT_OF_CHANGE = 1e-2  # of ||v||^2 beside ||P v||^2, for v with little effect on outputs


@dataclass(frozen=True)
class ZeroPhaseButterworth:
    """A low-pass filter Q without phase lag.

    A Butterworth filter is applied forward and backward in time. The response of Q is |H|^2, where
    H is the response of the Butterworth filter, equation (43) of the paper. Scipy's and MATLAB's
    ``filtfilt`` filter in the same way: F. Gustafsson, Determining the initial states in
    forward-backward filtering, IEEE Transactions on Signal Processing 44 (1996) 988-992. Unlike
    ``filtfilt``, this filter continues a signal beyond the trial as `ends` says.

    Attributes
    ----------
    order : int
        Order of the Butterworth filter, 20 at most; the zero-phase filter has twice that order.
    cutoff : float
        Cut-off frequency, rad/s. At this frequency, the gain of the Butterworth filter is -3 dB.
        The gain of Q is the square of this gain, -6 dB.
    Ts : float
        Sampling period, s.
    ends : {"zero", "hold", "hold-last"}
        How a signal is continued outside the trial, see :mod:`ilctools.filters`. Default: by zeros.

    See Also
    --------
    synthesise : designs a learning filter for Q
    Law : uses both filters

    Examples
    --------
    >>> from ilctools import zero_phase_butterworth
    >>> Q = zero_phase_butterworth(order=2, cutoff=0.1, Ts=1.0)
    >>> Q.frequency_response([0.0, 0.1, 1.0]).round(2)
    array([1. , 0.5, 0. ])
    """

    order: int
    cutoff: float
    Ts: float
    ends: str = "zero"

    def __post_init__(self):
        arguments.choice("ends", self.ends, list(ENDS))
        Ts = arguments.sampling_period("Ts", self.Ts)
        what = (
            f"in (0, {np.pi / Ts:.6g}) rad/s, up to the Nyquist frequency of Ts = {Ts} s; a "
            "normalised cut-off, as in scipy, must be multiplied by this frequency"
        )
        cutoff = arguments.number("cutoff", self.cutoff, what, 0, np.pi / Ts)
        order = arguments.whole("order", self.order, 1, HIGHEST_ORDER)
        vars(self).update(order=order, cutoff=cutoff, Ts=Ts)
        if not self._realised():
            end = "low" if cutoff < np.pi / Ts / 2 else "high"
            raise ValueError(
                f"cutoff = {cutoff!r} rad/s is too {end} for order = {order} at Ts = {Ts} s, "
                "because rounding changes the filter by more than a millionth, or its "
                "response lasts more than 1e7 samples: lower the order, choose another "
                "cut-off, or take another Ts. If the cut-off is normalised, as in scipy, "
                "multiply it by pi / Ts"
            )

    def _realised(self):
        """Whether rounding leaves the filter as designed.

        The gain must be 1 at zero frequency and 1/2 at the cut-off, and the impulse response must
        decay.
        """
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", BadCoefficients)
            try:
                gains = self.frequency_response([0, self.cutoff])
                decays = 0 <= self.decay < LONGEST_RESPONSE
            except OverflowError:  # next to the Nyquist frequency, or of a pole on the circle
                return False
        return decays and np.allclose(gains, [1, 0.5], 0, 1e-6)

    @cached_property
    def sections(self) -> np.ndarray:
        """Second-order sections of the forward half of the filter."""
        return butter(self.order, self.cutoff, fs=2 * np.pi / self.Ts, output="sos")

    @cached_property
    def poles(self) -> np.ndarray:
        """Poles of the forward half of the filter."""
        return butter(self.order, self.cutoff, fs=2 * np.pi / self.Ts, output="zpk")[1]

    @cached_property
    def decay(self):
        """Number of samples after which the impulse response has decayed to rounding level."""
        return int(np.ceil(np.log(1e-18) / np.log(np.abs(self.poles).max())))

    def frequency_response(self, omega) -> np.ndarray:
        """Compute the squared gain of the Butterworth filter at `omega` (rad/s).

        The result is real and has the shape (n,).
        """
        return np.abs(self(np.exp(1j * self.Ts * arguments.row("omega", omega))))  # (43)

    def __call__(self, z) -> np.ndarray:
        """Compute Q(z) = H(z) H(1/z) at any z except zero.

        H is the transfer function of the Butterworth filter.
        """
        z = arguments.array("z", z, (...,), complex)
        H = [np.polyval(s[:3], x) / np.polyval(s[3:], x) for s in self.sections for x in (z, 1 / z)]
        return np.prod(H, axis=0)

    def apply(self, signal) -> np.ndarray:
        """Filter a signal of shape (..., time, channel), forward and backward in time."""
        signal = arguments.array("signal", signal, (..., "time", "channel"))
        reach = self.decay  # so many more samples on each side are as good as infinitely many
        line = _continued(signal, reach, reach, self.ends)
        return self._both_ways(line)[..., reach:-reach, :]

    def apply_transposed(self, signal) -> np.ndarray:
        """Apply the transpose of the matrix that represents :meth:`apply` on a trial."""
        signal = arguments.array("signal", signal, (..., "time", "channel"))
        reach = self.decay
        line = _continued(signal, 2 * reach, 2 * reach, "zero")
        wide = self._both_ways(line)[..., reach:-reach, :]  # a symmetric matrix
        return _folded(wide, reach, signal.shape[-2], self.ends)

    def _both_ways(self, line):
        """Filter a signal (..., time, channel) forward and backward, both times from rest."""
        for _ in range(2):
            line = sosfilt(self.sections, line, axis=-2)[..., ::-1, :]
        return line


def _continued(signal, before, after, ends):
    """Extend a signal (..., time, channel) by some samples before and after the trial."""
    first, last = ENDS[ends]  # takes a fifth of the time of numpy.pad
    left = np.repeat(signal[..., :1, :] * first, before, axis=-2)
    right = np.repeat(signal[..., -1:, :] * last, after, axis=-2)
    return np.concatenate([left, signal, right], axis=-2)


def _folded(line, before, samples, ends):
    """Apply the transpose of `_continued` to a signal (..., time, channel).

    If the signal is held at an end, the samples beyond this end are added to the sample at the end.
    """
    inside, (first, last) = line[..., before : before + samples, :].copy(), ENDS[ends]
    inside[..., 0, :] += first * line[..., :before, :].sum(axis=-2)
    inside[..., -1, :] += last * line[..., before + samples :, :].sum(axis=-2)
    return inside


# a second name, as in scipy: butter(order, cutoff)
zero_phase_butterworth = ZeroPhaseButterworth


@runtime_checkable
class LearningOperator(Protocol):
    """The interface of L in the law v_{k+1} = Q (v_k + L e_k), equation (23) of the paper.

    L is a linear map from the errors of a trial to changes of v.

    Any object that has this interface can be used as L in :class:`ilctools.Law` and
    :func:`ilctools.convergence`. Examples are :class:`LearningFilter` and
    :class:`ilctools.NormOptimal`. The module ``pickle`` must be able to store an operator, so that
    a law can be sent to other processes.
    """

    @property
    def Ts(self) -> float:
        """Sampling period, s."""

    @property
    def rows(self) -> int:
        """Number m of output signals, one for each learned input of the plant."""

    @property
    def columns(self) -> int:
        """Number p of errors at the input of L, one for each output of the plant."""

    @property
    def weight_of_change(self) -> float:
        """The weight in the norm ||P v||^2 + weight ||v||^2, in units of y^2 / v^2.

        If commands have limits, the law projects v onto the limits in this norm. An operator may
        also have an attribute `weight_of_errors`, with the weights of the squares of P v, by time
        and output, (time, p).
        """

    def frequency_response(self, omega) -> np.ndarray:
        """Compute the frequency response of L at `omega` (rad/s).

        The result is complex and has the shape (n, m, p). L has this response far from the ends of
        a trial.
        """

    def apply(self, signal) -> np.ndarray:
        """Compute the changes of v from the errors of a trial.

        The errors have the shape (..., time, p) and the units of y. The changes have the shape
        (..., time, m) and the units of v. A ValueError is raised if the operator does not act on
        trials of this length.
        """

    def apply_transposed(self, signal) -> np.ndarray:
        """Apply the transpose of the matrix that represents :meth:`apply` on a trial.

        The argument has the shape (..., time, m), and the result has the shape (..., time, p). On a
        trial, sum(y * apply(x)) = sum(apply_transposed(y) * x) for any x and y.
        """


@dataclass(frozen=True, eq=False)
class LearningFilter:
    """A learning filter L of finite impulse response, which may look ahead in the recorded error.

    Its output at sample p is L(q) e(p) = sum_k C_k e(p + k), by equations (42) and (44) of the
    paper. See also D. A. Bristow, M. Tharayil and A. G. Alleyne, A survey of iterative learning
    control, IEEE Control Systems Magazine 26 (2006) 96-114.

    Attributes
    ----------
    coefficients : ndarray, shape (m, p, order)
        L_ij(q) = sum_k coefficients[i, j, k - first] q^k, where q e(p) = e(p + 1).
    Ts : float
        Sampling period, s.
    ends : {"zero", "hold", "hold-last"}
        How the error is continued beyond the ends of the trial, see :mod:`ilctools.filters`.
        Default: by zeros.
    first : int
        The lowest k in the sum. In equation (44) the lowest k is 1, and the filter only looks
        ahead. If `first` is below zero, the filter also looks back.

    See Also
    --------
    synthesise : designs an optimal learning filter
    Law : uses the filter

    Examples
    --------
    >>> from ilctools import LearningFilter
    >>> L = LearningFilter([[[0.5, 0.25]]], Ts=1.0)  # L(q) = 0.5 q + 0.25 q^2
    >>> L.apply([[0.0], [1.0], [2.0]]).ravel()
    array([1., 1., 0.])
    >>> L.frequency_response([0.1]).shape
    (1, 1, 1)
    """

    coefficients: np.ndarray | Any = field(repr=False)  # a list becomes an array
    Ts: float
    ends: str = "zero"
    first: int = 1
    weight_of_change = WEIGHT_OF_CHANGE

    def __post_init__(self):
        c = labels.with_axes("coefficients", self.coefficients, AXES_OF_L)
        c = arguments.array("coefficients", c, ("m", "p", "order"))
        Ts = arguments.sampling_period("Ts", self.Ts)
        arguments.choice("ends", self.ends, list(ENDS))
        first = arguments.whole("first", self.first, -FARTHEST_TAP, FARTHEST_TAP)
        c.flags.writeable = False
        vars(self).update(coefficients=c, Ts=Ts, first=first)

    @property
    def rows(self) -> int:
        """Number m of output signals."""
        return len(self.coefficients)

    @property
    def columns(self) -> int:
        """Number p of errors at the input."""
        return self.coefficients.shape[1]

    @property
    def order(self) -> int:
        """Number of coefficients; the filter (44) of the paper looks ahead by this many samples."""
        return self.coefficients.shape[2]

    @property
    def last(self) -> int:
        """The highest k, which is the number of samples that the filter looks ahead."""
        return self.first + self.order - 1

    @property
    def poles(self) -> np.ndarray:
        """Poles at zero, one for each sample that the filter looks ahead or back."""
        return np.zeros(max(abs(self.first), abs(self.last)))

    def __matmul__(self, K: "LearningOperator") -> "Filter":
        """Return the product of this filter and a filter K on its right.

        The product has the `ends` of K. If the right factor is another operator, such as the base B
        of :mod:`.base`, the result is the composition K B, in which this filter is K.
        """
        if not isinstance(K, LearningFilter):
            return Composition(K, self, K_first=False)
        products = oaconvolve(self.coefficients[:, :, None], K.coefficients[None], axes=-1)
        return LearningFilter(products.sum(axis=1), K.Ts, K.ends, self.first + K.first)

    def frequency_response(self, omega) -> np.ndarray:
        """Compute the response L(exp(j omega Ts)) at `omega` (rad/s).

        The result is complex and has the shape (n, m, p).
        """
        angles = self.Ts * arguments.row("omega", omega)
        shifts = time_shifts(angles, min(self.order, LONG))
        if self.order > LONG:
            shifts = shifts.astype(complex)
        response = 0
        for start in range(0, self.order, LONG):
            taps = self.coefficients[..., start : start + LONG]
            part = np.tensordot(shifts[:, : taps.shape[-1]], taps, (1, 2)).astype(complex)  # (44)
            response += part * np.exp(1j * (self.first + start - 1) * angles)[:, None, None]
        return response

    def apply(self, signal) -> np.ndarray:
        """Filter errors of shape (..., time, p) on a trial; the result has shape (..., time, m)."""
        signal = arguments.array("signal", signal, (..., "time", self.columns))
        before = max(0, -self.first)
        line = _continued(signal, before, max(0, self.last), self.ends)
        start = before + self.first  # where the window of the first sample begins
        if self.order <= LONG:
            # with channels side by side, a window is one piece of the line, without copies
            p, line = self.columns, line.reshape(*line.shape[:-2], -1)
            windows = sliding_window_view(line, p * self.order, axis=-1)[..., ::p, :]
            result = windows @ self.coefficients.T.reshape(-1, self.rows)
        else:
            taps = self.coefficients.T[::-1]  # (k, j, i), from the last
            taps = taps[(None,) * (line.ndim - 2)]
            result = oaconvolve(line[..., None], taps, mode="valid", axes=-3).sum(axis=-2)
        return result[..., start : start + signal.shape[-2], :]

    def apply_transposed(self, signal) -> np.ndarray:
        """Apply the transpose of the matrix that represents :meth:`apply` on a trial."""
        signal = arguments.array("signal", signal, (..., "time", self.rows))
        flipped = self.coefficients.swapaxes(0, 1)[..., ::-1]
        mirrored = LearningFilter(flipped, self.Ts, "zero", -self.last)
        before = max(0, -self.first)
        line = mirrored.apply(_continued(signal, before, max(0, self.last), "zero"))
        return _folded(line, before, signal.shape[-2], self.ends)


@dataclass(frozen=True)
class Composition:
    """The product L = B K or L = K B of two learning operators.

    In L = B K, the filter K acts on the error, and B acts on the result of K. ``B @ K`` and ``K @
    B`` make a composition. If both factors are a LearningFilter, their product is a LearningFilter
    instead.
    """

    B: LearningOperator
    K: LearningFilter
    K_first: bool = True  # whether K acts on the error, and B on the result of K
    weight_of_change = WEIGHT_OF_CHANGE

    def __post_init__(self):
        check_learning(self.B, "B")
        last, first = self.factors
        if last.columns != first.rows:
            product = "B K" if self.K_first else "K B"
            raise ValueError(
                f"L = {product} does not exist, because the sizes do not match: B has "
                f"{self.B.rows} rows and {self.B.columns} columns, K has {self.K.rows} and "
                f"{self.K.columns}"
            )

    @property
    def factors(self) -> tuple[LearningOperator, LearningOperator]:
        """Both factors, B and K; the factor that acts on the error stands last."""
        return (self.B, self.K) if self.K_first else (self.K, self.B)

    @property
    def Ts(self) -> float:
        """Sampling period, s."""
        return self.K.Ts

    @property
    def rows(self) -> int:
        """Number m of output signals."""
        return self.factors[0].rows

    @property
    def columns(self) -> int:
        """Number p of errors at the input."""
        return self.factors[1].columns

    @property
    def order(self) -> int:
        """Number of coefficients of K."""
        return self.K.order

    @property
    def poles(self) -> np.ndarray:
        """Poles of B and of K."""
        return np.append(self.B.poles, self.K.poles)

    def frequency_response(self, omega) -> np.ndarray:
        """Compute the frequency response of L at `omega` (rad/s).

        The result is complex and has the shape (n, m, p).
        """
        last, first = self.factors
        return last.frequency_response(omega) @ first.frequency_response(omega)

    def apply(self, signal) -> np.ndarray:
        """Filter errors of shape (..., time, p) on a trial; the result has shape (..., time, m)."""
        last, first = self.factors
        return last.apply(first.apply(signal))

    def apply_transposed(self, signal) -> np.ndarray:
        """Apply the transpose of the matrix that represents :meth:`apply` on a trial."""
        last, first = self.factors
        return first.apply_transposed(last.apply_transposed(signal))


Filter = LearningFilter | Composition  # operators that can be written as JSON


def time_shifts(angles, order) -> np.ndarray:
    """Compute z, z^2, ..., z^order for z = exp(j angles).

    The result has the shape (n, order) and consists of long doubles.
    """
    # At low frequencies these powers are nearly linearly dependent. Without the bound (46) of the
    # paper, a learning filter has coefficients of 1e9 that nearly cancel. Doubles would then leave
    # seven digits of its gain.
    z = np.exp(1j * np.asarray(angles, dtype=np.longdouble))
    return np.cumprod(np.repeat(z[:, None], order, axis=1), axis=1)


def check_learning(L: LearningOperator, name: str = "L", rows=None, columns=None) -> None:
    """Check that L and its response have the rows and columns that the plant needs."""
    arguments.instance(name, L, LearningOperator)
    asked = (rows or L.rows, columns or L.columns)
    if (L.rows, L.columns) != asked:
        raise ValueError(
            f"{name} has {L.rows} rows and {L.columns} columns, but must have {asked[0]} rows, one "
            f"for each learned input, and {asked[1]} columns, one for each output"
        )
    response = L.frequency_response(np.array([ANYWHERE / L.Ts]))
    arguments.array(f"{name}.frequency_response", response, (1, *asked), complex)
