"""The two filters of the ILC law v_{k+1} = Q (v_k + L e_k), equation (23).

Each filter knows its frequency response and how it acts on a finite trial. Both look ahead in
time, which is no contradiction: they act between two trials, when the whole last trial is known.

Beyond the two ends of a trial nothing has been recorded, so something must be assumed there.
``ends="zero"`` takes every signal as zero outside the trial; the filters are then exactly the
two-sided filters of the analysis, seen through the window of the trial. ``ends="hold"`` lets the
first and the last sample stand still, which suits a trial that does not end at zero.
"""

from dataclasses import dataclass, field
from functools import cached_property
from numbers import Real

import numpy as np
from scipy.signal import butter, freqz_sos, sosfilt, sosfilt_zi

ENDS = {"zero": "constant", "hold": "edge"}  # the modes of numpy.pad


@dataclass(frozen=True)
class ZeroPhaseButterworth:
    """The Q-filter (43): a Butterworth low-pass filter applied forward and backward in time.

    Build it with :func:`zero_phase_butterworth`, which checks the arguments.
    """

    order: int
    cutoff: float
    Ts: float
    ends: str = "zero"

    @cached_property
    def sections(self) -> np.ndarray:
        """Second-order sections of the forward half of the filter."""
        return butter(self.order, self.cutoff, fs=2 * np.pi / self.Ts, output="sos")

    def frequency_response(self, omega) -> np.ndarray:
        """Squared magnitude of the Butterworth filter at `omega` (rad/s), real, shape (n,)."""
        _, H = freqz_sos(self.sections, np.atleast_1d(omega), fs=2 * np.pi / self.Ts)
        return np.abs(H) ** 2

    def apply(self, signal) -> np.ndarray:
        """Filter a signal of shape (..., time, channel), forward and backward in time."""
        signal = _signal("signal", signal)
        sections = self.sections
        poles = np.concatenate([np.roots(section[3:]) for section in sections])
        # Once the impulse response has decayed to rounding level, the line is as good as infinite.
        decay = int(np.ceil(np.log(1e-18) / np.log(np.abs(poles).max())))
        padding = [(0, 0)] * (signal.ndim - 2) + [(decay, decay), (0, 0)]
        once = np.pad(signal, padding, mode=ENDS[self.ends])
        at_rest = sosfilt_zi(sections).reshape(len(sections), *[1] * (signal.ndim - 2), 2, 1)
        for _ in range(2):
            filtered, _ = sosfilt(sections, once, axis=-2, zi=at_rest * once[..., :1, :])
            once = np.flip(filtered, axis=-2)
        return once[..., decay:-decay, :]


def zero_phase_butterworth(
    order: int = 2, cutoff: float = 0.1, Ts: float = 1.0, *, ends: str = "zero"
) -> ZeroPhaseButterworth:
    """Build the Q-filter (43). The defaults are the paper's.

    Parameters
    ----------
    order : int
        Order n_Q of the Butterworth filter; the zero-phase filter has twice that order.
    cutoff : float
        Cut-off frequency, rad/s. There the Butterworth filter is down by 3 dB, the Q-filter,
        which squares its magnitude, by 6 dB.
    Ts : float
        Sampling period, s.
    ends : {"zero", "hold"}
        What a signal is taken to be outside the trial.

    Returns
    -------
    ZeroPhaseButterworth

    Raises
    ------
    ValueError
        If an argument is out of range; the message names it and its value.
    """
    if not (isinstance(order, int | np.integer) and order >= 1):
        raise ValueError(f"order = {order!r} must be a whole number, 1 or more")
    if not (isinstance(Ts, Real) and 0 < Ts < np.inf):
        raise ValueError(f"Ts = {Ts!r} must be a positive sampling period in seconds")
    if not (isinstance(cutoff, Real) and 0 < cutoff < np.pi / Ts):
        raise ValueError(f"cutoff = {cutoff!r} must be in (0, {np.pi / Ts:.6g}) rad/s (Nyquist)")
    _check_ends(ends)
    return ZeroPhaseButterworth(int(order), float(cutoff), float(Ts), ends)


@dataclass(frozen=True)
class LearningFilter:
    """The learning filter L of (42), (44): a non-causal finite impulse response.

    Attributes
    ----------
    coefficients : ndarray, shape (m, m, order)
        L_ij(q) = sum_k coefficients[i, j, k - 1] q^k, where q looks one sample ahead.
    Ts : float
        Sampling period, s.
    ends : {"zero", "hold"}
        What the error is taken to be beyond the end of the trial.

    Raises
    ------
    ValueError
        If the coefficients have the wrong shape or are not finite, or Ts is not positive.
    """

    coefficients: np.ndarray = field(repr=False)
    Ts: float
    ends: str = "zero"

    def __post_init__(self):
        c = np.array(self.coefficients, dtype=float)
        if c.ndim != 3 or c.shape[0] != c.shape[1] or not c.size:
            raise ValueError(f"coefficients have shape {c.shape}, but must be (m, m, order)")
        if not np.isfinite(c).all():
            raise ValueError("coefficients must be finite")
        if not (isinstance(self.Ts, Real) and 0 < self.Ts < np.inf):
            raise ValueError(f"Ts = {self.Ts!r} must be a positive sampling period in seconds")
        _check_ends(self.ends)
        c.flags.writeable = False
        object.__setattr__(self, "coefficients", c)

    @property
    def order(self) -> int:
        """Number of samples that the filter looks ahead."""
        return self.coefficients.shape[2]

    def frequency_response(self, omega) -> np.ndarray:
        """L(exp(j omega Ts)) at `omega` (rad/s), shape (n, m, m), complex."""
        shifts = time_shifts(self.Ts * np.atleast_1d(omega), self.order)
        return np.einsum("nk,ijk->nij", shifts, self.coefficients).astype(complex)

    def apply(self, signal) -> np.ndarray:
        """Filter a signal of shape (..., time, m)."""
        signal = _signal("signal", signal)
        m = len(self.coefficients)
        if signal.shape[-1] != m:
            raise ValueError(f"signal has {signal.shape[-1]} channels, but the filter has {m}")
        padding = [(0, 0)] * (signal.ndim - 2) + [(0, self.order), (0, 0)]
        ahead = np.pad(signal, padding, mode=ENDS[self.ends])
        windows = np.lib.stride_tricks.sliding_window_view(ahead, self.order, axis=-2)
        return np.tensordot(windows[..., 1:, :, :], self.coefficients, axes=([-2, -1], [1, 2]))


def time_shifts(angles, order) -> np.ndarray:
    """z, z^2, ..., z^order for z = exp(j angles), in long doubles, shape (n, order).

    They are nearly dependent at low frequencies. Without a bound (46) a learning filter has
    coefficients of 1e9 that all but cancel, and doubles would leave seven digits of its gain.
    """
    angles = np.asarray(angles, dtype=np.longdouble)
    return np.exp(1j * np.outer(angles, np.arange(1, order + 1)))


def update(v, e, Q: ZeroPhaseButterworth, L: LearningFilter) -> np.ndarray:
    """Compute the next trial's ILC signal by the ILC law (23), v_{k+1} = Q (v_k + L e_k).

    Parameters
    ----------
    v, e : array_like, shape (time, m)
        ILC signal and tracking error of the trial just done, both in the unit of the output.
    Q, L : ZeroPhaseButterworth, LearningFilter

    Returns
    -------
    ndarray, shape (time, m)

    Raises
    ------
    ValueError
        If the shapes do not fit, or a signal has a gap (NaN) or an infinite value.
    """
    v, e = _signal("v", v), _signal("e", e)
    if v.shape != e.shape:
        raise ValueError(f"v has shape {v.shape} and e has shape {e.shape}: they must be equal")
    if Q.Ts != L.Ts:
        raise ValueError(f"Q.Ts = {Q.Ts} s and L.Ts = {L.Ts} s: the filters must share one period")
    return Q.apply(v + L.apply(e))


def _signal(name, value):
    value = np.asarray(value, dtype=float)
    if value.ndim < 2 or value.shape[-2] < 1:
        raise ValueError(f"{name} has shape {value.shape}, but must be (time, channel)")
    bad = np.argwhere(~np.isfinite(value))
    if bad.size:
        raise ValueError(f"{name} has {len(bad)} values that are not finite, the first at {bad[0]}")
    return value


def _check_ends(ends):
    if ends not in ENDS:
        raise ValueError(f"ends = {ends!r} must be one of {sorted(ENDS)}")
