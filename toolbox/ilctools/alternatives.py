"""Other learning filters than the paper's, for the same law (23).

What a design returns is a :class:`ilctools.filters.LearningOperator`, as a
:class:`ilctools.LearningFilter` is: it goes where L goes. Most of them reach far into the past and
the future at once. None needs a recursion of its own: between two trials the whole last trial is
known, and a filter that is known by its frequency response acts by the fast transform.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import control
import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.sparse import csc_array, eye_array, kron
from scipy.sparse.linalg import SuperLU, splu

from ilctools import arguments
from ilctools.filters import LearningFilter, LearningOperator
from ilctools.models import balanced, frequency_response, sampled_plant

SHORTEST, LONGEST = 2**12, 2**20  # samples of the transform, for an impulse response
NEGLIGIBLE = 1e-9  # of its largest entry
MOST = 0.999  # of its energy; half of the rest is left out at each end


def pd_type(gain: float, slope: float, ahead: int, channels: int, Ts: float) -> LearningFilter:
    """L(q) = (gain + slope (1 - 1/q) / Ts) q^ahead I: the error, and its slope, of a later sample.

    The shift makes up for the delay of the plant; P-type learning has a slope of zero. S. Arimoto,
    S. Kawamura and F. Miyazaki, Bettering operation of robots by learning, Journal of Robotic
    Systems 1 (1984) 123-140.

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


def gradient(P: control.StateSpace, step: float) -> "TwoSidedFilter":
    """L = step P^*, the adjoint of P: the plant with its time reversed, step P_N^T on N samples.

    v moves against the gradient of ||e||^2 / 2, which is -P^* e. Without Q the rate is
    max |1 - step sigma^2| over the singular values sigma of P, so that `step` must be below
    2 / max sigma^2, and what P hardly passes is hardly learned. K. Furuta and M. Yamakita, The
    design of a learning control system for multivariable systems, IEEE International Symposium on
    Intelligent Control (1987) 371-376. P is stable, in discrete time; the step is above zero.
    """
    step = arguments.positive("step", step)
    sampled_plant(arguments.state_space("P", P), "P")
    arguments.square("P", P.ninputs, P.noutputs)
    arguments.stable("P", P.poles())

    def response(omega):
        return step * frequency_response(P, omega).conj().swapaxes(1, 2)

    return TwoSidedFilter(response, P.noutputs, P.dt)


@dataclass(frozen=True)
class NormOptimal:
    """L = (P_N^T P_N + weight I)^-1 P_N^T, for trials of N samples.

    The change of v that minimises ||e - P_N change||^2 + weight ||change||^2. N. Amann, D. H. Owens
    and E. Rogers, Iterative learning control using optimal feedback and feedforward actions,
    International Journal of Control 65 (1996) 277-293; on the rod, the paper's [15].

    Attributes
    ----------
    P : control.StateSpace
        In discrete time, stable, from rest. With more outputs p than inputs m, no other change of
        v leaves less of an error, but for the weight; for the law (23) p and m must be equal.
    weight : float
        Above zero, in the square of the unit of y per unit of w.
    samples : int
        Length N of a trial.

    See Also
    --------
    Law : what takes it as L
    synthesise : a filter with bounds instead

    Notes
    -----
    The inverse is never formed. With x for the states of P and lambda for the multipliers of
    x(p) = A x(p-1) + B change(p-1), the conditions of optimality couple neighbouring samples alone:
    a sparse matrix, block tridiagonal and the same in each row, factored once.

    Examples
    --------
    >>> import control
    >>> import numpy as np
    >>> from ilctools import Law, NormOptimal, zero_phase_butterworth
    >>> P = control.ss(0.5, 0.5, 1, 0, 1.0)
    >>> L = NormOptimal(P, weight=0.01, samples=50)
    >>> law = Law(zero_phase_butterworth(2, 1.0, 1.0), L)
    >>> law.next(np.zeros((50, 1)), np.ones((50, 1))).shape
    (50, 1)
    """

    P: control.StateSpace
    weight: float
    samples: int

    def __post_init__(self):
        P = sampled_plant(self.P, "P")
        arguments.stable("P", P.poles())
        weight = arguments.positive("weight", self.weight)
        samples = arguments.whole("samples", self.samples, 1)
        vars(self).update(P=P, weight=weight, samples=samples)

    def __reduce__(self):  # to another process: the factors have no copy
        return NormOptimal, (self.P, self.weight, self.samples)

    @property
    def Ts(self) -> float:
        """Sampling period, s."""
        return self.P.dt

    @property
    def channels(self) -> int:
        """Number p of outputs."""
        return self.P.noutputs

    def frequency_response(self, omega) -> np.ndarray:
        """(P^H P + weight I)^-1 P^H, to which L tends far from the ends of a long trial."""
        P = frequency_response(self.P, omega)
        adjoint = P.conj().swapaxes(1, 2)
        weight = self.weight * np.eye(self.P.ninputs)
        return np.linalg.solve(adjoint @ P + weight, adjoint)

    @cached_property
    def _states(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B and C of P, of states in units of like size: pivots stay near the diagonal."""
        return balanced(self.P.A, self.P.B, self.P.C)

    @cached_property
    def _factors(self) -> SuperLU:
        """Of the conditions of optimality, for x(p), change(p), lambda(p), p = 0, 1, ..."""
        (A, B, C), D = self._states, self.P.D
        n, m = B.shape
        O, I = np.zeros, np.eye(n)  # noqa: E741
        here = np.block(
            [
                [C.T @ C, C.T @ D, I],
                [D.T @ C, D.T @ D + self.weight * np.eye(m), O((m, n))],
                [I, O((n, m + n))],
            ]
        )
        before = np.block([[O((n + m, 2 * n + m))], [-A, -B, O((n, n))]])
        N = self.samples
        system = kron(eye_array(N), here) + kron(eye_array(N, k=-1), before)
        system = csc_array(system + kron(eye_array(N, k=1), before.T))
        # samples in turn: pivots stay near the diagonal
        return splu(system, permc_spec="NATURAL")

    def apply(self, signal) -> np.ndarray:
        """The best change, shape (..., samples, m), for an error of shape (..., samples, p)."""
        signal = arguments.array("signal", signal, (..., self.samples, self.channels))
        n, m = self.P.B.shape
        right = self._solved(np.dot(signal, np.hstack([self._states[2], self.P.D])))
        return right[..., n : n + m]

    def apply_transposed(self, signal) -> np.ndarray:
        """The transpose of the matrix that :meth:`apply` is: P_N (P_N^T P_N + weight I)^-1."""
        n, m = self.P.B.shape
        signal = arguments.array("signal", signal, (..., self.samples, m))
        solution = self._solved(np.pad(signal, [(0, 0)] * (signal.ndim - 1) + [(n, 0)]))
        return solution[..., : n + m] @ np.hstack([self._states[2], self.P.D]).T

    def _solved(self, right):
        """The conditions of optimality, for right-hand sides (..., samples, n + m) of x, change."""
        n, m = self.P.B.shape
        padded = np.zeros((*right.shape[:-1], 2 * n + m))
        padded[..., : n + m] = right
        columns = padded.reshape(-1, self.samples * (2 * n + m)).T
        return self._factors.solve(columns).T.reshape(padded.shape)


@dataclass(frozen=True)
class TwoSidedFilter:
    """A learning filter for a :class:`Law`, for signals that are zero outside the trial."""

    response: Callable  # from omega (rad/s), (n,), to L, (n, channels, channels)
    channels: int
    Ts: float  # s

    def __post_init__(self):
        arguments.instance("response", self.response, Callable)

    def frequency_response(self, omega) -> np.ndarray:
        """L at `omega` (rad/s), shape (n, channels, channels), complex."""
        return self.response(arguments.row("omega", omega))

    @cached_property
    def _taps(self):
        return two_sided_taps(self)

    def apply(self, signal) -> np.ndarray:
        """Filter a signal of shape (..., time, channels)."""
        signal = arguments.array("signal", signal, (..., "time", self.channels))
        lags, taps = self._taps
        samples = signal.shape[-2]
        n = next_fast_len(samples + len(taps), real=True)
        spectrum = rfft(taps, n, axis=0) @ rfft(signal, n, axis=-2)[..., None]
        filtered = irfft(spectrum[..., 0], n, axis=-2)
        return np.roll(filtered, lags[0], axis=-2)[..., :samples, :]


def two_sided_taps(L: LearningOperator) -> tuple[np.ndarray, np.ndarray]:
    """Two-sided impulse response of a learning filter, by the inverse transform of its response.

    Parameters
    ----------
    L : LearningOperator

    Returns
    -------
    lags : ndarray of int, shape (n,)
        From the future (below zero) to the past.
    taps : ndarray, shape (n, channels, channels)
        L e at p is the sum of ``taps[i] @ e[p - lags[i]]``. What is left out is below `NEGLIGIBLE`;
        of a filter with a pole on the unit circle, or nearly, a ValueError says that it is not.
    """
    arguments.instance("L", L, LearningOperator)
    n = SHORTEST
    while n <= LONGEST:
        omega = rfftfreq(n, L.Ts / (2 * np.pi))
        taps = np.fft.fftshift(irfft(L.frequency_response(omega), n, axis=0), axes=0)
        size = np.abs(taps).max(axis=(1, 2))
        quarter = n // 4
        ends = max(size[:quarter].max(), size[-quarter:].max())
        if ends <= NEGLIGIBLE * size.max():
            lags = np.arange(-n // 2, n // 2)
            return lags[quarter:-quarter], taps[quarter:-quarter]
        n *= 2
    raise ValueError(
        f"L has an impulse response that does not decay within {LONGEST // 4} samples: a pole, "
        "which for an inverse is a zero of P, is on the unit circle or next to it. Take a design "
        "with a weight on v, such as norm_optimal"
    )


def extent(L: LearningOperator) -> tuple[int, int]:
    """How far a learning filter looks ahead and back, in samples, with nearly all of its energy.

    Either is below zero if the filter begins later than that.
    """
    lags, taps = two_sided_taps(L)
    energy = np.cumsum((taps**2).sum(axis=(1, 2)))
    energy /= energy[-1]
    first = np.searchsorted(energy, (1 - MOST) / 2)
    last = np.searchsorted(energy, (1 + MOST) / 2)
    return int(-lags[first]), int(lags[last])
