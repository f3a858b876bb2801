"""Compute the size of the signals of trials: RMS, harmonics, octaves, and noise."""

import numpy as np
import xarray as xr

from ilctools import arguments
from ilctools.signals import ASKED, points_of, with_points

SMALLEST_DIVISOR = np.finfo(float).tiny  # replaces a divisor that is zero


def rms(e: xr.DataArray | xr.Dataset) -> xr.DataArray:
    """Compute the RMS of the error of each trial.

    The RMS is the square root of the mean of e'e over time. The product e'e is the sum of squares
    over all channels. If the reference is given at some points only, the mean of each output is
    taken over these points.

    Parameters
    ----------
    e : xarray.DataArray or xarray.Dataset
        The error, with the dimensions time and channel, or time and input. A dataset of trials,
        such as a log, may be passed instead. The error is then its reference - y.

    Returns
    -------
    xarray.DataArray
        The RMS, for each trial.

    Raises
    ------
    ValueError
        If `e` is anything else, or contains a value that is not finite.

    See Also
    --------
    run_trials : trials with an error e

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from ilctools import rms
    >>> e = xr.DataArray(np.ones((2, 9, 2)), dims=("trial", "time", "channel"))
    >>> rms(e).values.round(4)
    array([1.4142, 1.4142])
    """
    if isinstance(e, xr.Dataset):
        if not {"reference", "y"} <= set(e):
            raise ValueError(
                f"e has the variables {[*e]}, but not both reference and y: pass "
                "one of its variables, as e.y"
            )
        e = with_points(e.assign(e=e.reference.astype(float) - e.y), points_of(e)).e
    arguments.instance("e", e, xr.DataArray)
    if "time" not in e.dims or not {"channel", "input"} & {*e.dims}:
        raise ValueError(f"e has dimensions {e.dims}, but must have 'time' and 'channel'")
    arguments.array("e", e.values, (...,))
    return rms_of(e)


def rms_of(e: xr.DataArray) -> xr.DataArray:
    """Compute RMS(e_k), also for an error that is not finite."""
    channels = "input" if "input" in e.dims else "channel"
    squares = e.astype(float) ** 2
    if ASKED in e.coords:  # the mean of each output over its points
        count = e[ASKED].sum("time")
        squares = squares * (e.sizes["time"] / count.where(count > 0, 1))
    return np.sqrt(squares.sum(channels).mean("time")).drop_vars(ASKED, errors="ignore")


def harmonics(signals) -> np.ndarray:
    """Compute the Fourier coefficients of signals.

    The signals have the shape (..., time, channel), and the coefficients have the shape
    (..., harmonic, channel). The squares of the coefficients add up to the mean square of the
    signal.
    """
    samples = signals.shape[-2]
    coefficients = np.fft.rfft(signals, axis=-2) / samples
    coefficients[..., 1 : (samples + 1) // 2, :] *= np.sqrt(2)  # harmonic and its conjugate
    return coefficients


def octaves(samples: int) -> np.ndarray:
    """Return the first harmonic of each octave of a trial: 0, 2, 4, 8, ..."""
    return np.append(0, 2 ** np.arange(1, (samples // 2).bit_length()))


def rms_by_octave(signal) -> np.ndarray:
    """Compute the RMS of a signal in each octave, over all channels.

    The signal has the shape (time, channel).
    """
    power = np.sum(np.abs(harmonics(signal)) ** 2, axis=1)
    return np.sqrt(np.add.reduceat(power, octaves(len(signal))))


def noise_std(signals) -> np.ndarray:
    """Estimate the standard deviation of white noise in signals of shape (time, channel)."""
    bends = np.diff(signals, 2, axis=0)
    return np.sqrt(np.sum(bends**2, axis=0) / (6 * max(1, len(bends))))
