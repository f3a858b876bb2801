"""Excitations of a loop: periodic multisines with few excited frequencies (lines) and low peaks."""

import json
from dataclasses import asdict, dataclass
from functools import cached_property

import numpy as np
import xarray as xr
from scipy.fft import next_fast_len

from ilctools import arguments
from ilctools.law.notes import read_note, with_loop
from ilctools.loop.closed import Loop, check_loop
from ilctools.signals import Signals, check_match

CLIPPING_ROUNDS = 300  # in the search for low peaks; with three times as many, peaks are 3 % lower
# Defaults. With more than ten realisations, the quantiles of the radius hardly fall.
FEWEST_REALISATIONS, MOST_REALISATIONS = 2, 10


@dataclass(frozen=True)
class Excitation:
    """A periodic excitation, with one experiment per input for each realisation of the phases.

    All inputs are excited in each experiment. In experiment e, input i is amplitude_i / peak times
    the sum over all harmonics h of cos(2 pi h t / period + phase_ih + 2 pi e i / m). At every line
    (excited frequency) the m experiments are therefore orthogonal. With the same peaks and in the
    same time, the variance of the estimate is 1 / m of the variance that results if one input is
    excited at a time. The source is Dobrowiecki, Schoukens and Guillaume, Optimized excitation
    signals for MIMO frequency response function measurements, IEEE Trans. Instrum. Meas. 55, 2006.
    Each realisation has its own random phases. Differences between the realisations show the
    nonlinear part of the response. The first period of each experiment is left out, because most of
    the transient decays in this period.
    """

    Ts: float  # s
    period: int  # samples
    periods: int  # number of periods of each experiment that are evaluated
    harmonics: list[int]  # of the period, increasing
    phases: list[list[list[float]]]  # rad, (realisation, input, harmonic)
    amplitude: list[float]  # largest |w| of each input, in the units of the outputs

    @property
    def rows(self) -> int:
        """Number of inputs, which is also the number of experiments of each realisation."""
        return len(self.amplitude)

    @property
    def omega(self) -> np.ndarray:
        """The excited frequencies, rad/s."""
        return 2 * np.pi * np.array(self.harmonics) / (self.period * self.Ts)

    @property
    def evaluated(self) -> int:
        """Number of evaluated samples, at the end of each experiment."""
        return self.periods * self.period

    @property
    def samples(self) -> int:
        """Number of samples of each experiment."""
        return self.evaluated + self.period

    @property
    def hours(self) -> float:
        """Duration of all experiments together, in hours."""
        return self.rows * len(self.phases) * self.samples * self.Ts / 3600

    @cached_property
    def signals(self) -> np.ndarray:
        """The signal w of each experiment, shape (experiment, time, input)."""
        envelopes = _envelopes(np.array(self.phases), self.harmonics, self.period)
        experiment = np.arange(self.rows)
        turns = np.exp(2j * np.pi * np.outer(experiment, experiment) / self.rows)
        waves = np.real(np.einsum("ei,rit->reti", turns, envelopes))
        waves *= np.array(self.amplitude) / np.abs(waves).max(axis=(1, 2, 3), keepdims=True)
        return np.tile(waves.reshape(-1, self.period, self.rows), (1, self.periods + 1, 1))

    def spectra(self, signal: np.ndarray) -> np.ndarray:
        """Compute the spectra at the lines of a signal, shape (experiment, time, channel).

        The signal has whole periods. The result has the shape (realisation, period, n, channel,
        experiment).
        """
        _, samples, channels = signal.shape
        periods = samples // self.period
        parts = signal.reshape(-1, self.rows, periods, self.period, channels)
        lines = np.fft.rfft(parts, axis=3)[:, :, :, self.harmonics]
        return np.moveaxis(lines, 1, -1)

    def __repr__(self):
        return (
            f"{len(self.phases)} realisations of {self.rows} experiments, each with 1 + "
            f"{self.periods} periods of {self.period * self.Ts:.6g} s, {self.hours:.3g} h in "
            f"all; {len(self.harmonics)} excited frequencies (lines) from {self.omega[0]:.3g} "
            f"to {self.omega[-1]:.3g} rad/s"
        )


def multisine(
    loop: Loop,
    lowest: float,
    highest: float,
    amplitude,
    hours: float,
    lines: int = 40,
    *,
    realisations: int | None = None,
    seed: int = 0,
) -> Excitation:
    """Design an excitation for a loop: periodic multisines, with low peaks, within some hours.

    Parameters
    ----------
    loop : CurrentTrialLoop or ClosedLoop
        The loop that will be excited. Only its sampling period and its channels matter.
    lowest, highest : float
        Lowest and highest excited frequency, rad/s. The lowest frequency determines the period. The
        excitation gives no information on P below the lowest or above the highest frequency.
    amplitude : float or array_like, shape (m,)
        Largest |w| of each learned input, in the unit of the input.
    hours : float
        Time for all experiments, in hours. If the time is too short, the error says how much time
        is needed.
    lines : int
        Number of excited frequencies, or lines, evenly spaced on a logarithmic scale. There are
        fewer lines if some would fall on the same harmonic.
    realisations : int, optional
        Number of realisations of random phases. The differences between the responses to them show
        the nonlinear part of the loop. Default: as many as fit into the time with two evaluated
        periods each, but at most 10.
    seed : int
        Seed of the random phases.

    See Also
    --------
    shake : applies the excitation to a rig
    measured_response : estimates P from the record

    Examples
    --------
    >>> from ilctools import ClosedLoop, multisine
    >>> loop = ClosedLoop(Ts=1.0, outputs=["y1", "y2"])
    >>> shaking = multisine(loop, lowest=0.003, highest=0.3, amplitude=2.0, hours=8.0)
    >>> shaking.signals.shape[0], shaking.hours <= 8  # two realisations of two experiments
    (4, True)
    """
    Ts, m = check_loop(loop).Ts, len(loop.learned)
    nyquist = np.pi / Ts
    lowest = arguments.number("lowest", lowest, "between 0 and pi / Ts / 4", 0, nyquist / 4)
    highest = arguments.number("highest", highest, "between lowest and pi / Ts", lowest, nyquist)
    amplitude = _amplitudes(amplitude, loop)
    lines, seed = arguments.whole("lines", lines, 2), arguments.whole("seed", seed, 0)
    period = round(2 * np.pi / (lowest * Ts))
    hours_of_all_inputs = m * period * Ts / 3600
    realisations, periods = _divided(hours, hours_of_all_inputs, realisations, lowest)
    harmonics = _harmonics(period, highest * Ts, lines)
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, (realisations, m, len(harmonics)))
    phases = _with_low_peaks(phases, harmonics, m).tolist()
    return Excitation(Ts, period, periods, harmonics, phases, amplitude)


def _amplitudes(amplitude, loop):
    """Return the largest |w| of each input, checked."""
    m = len(loop.learned)
    each = [amplitude] * m if np.ndim(amplitude) == 0 else amplitude
    each = arguments.by_channel(
        "amplitude", each, loop.outputs if loop.one_for_one else loop.learned
    )
    each = arguments.array("amplitude", each, (m,)).tolist()
    return [arguments.positive("amplitude", value) for value in each]


def _harmonics(period, highest, lines):
    """Return harmonics that are evenly spaced on a logarithmic scale.

    The frequency of the last harmonic is at most `highest`, in rad per sample.
    """
    below_nyquist = (period - 1) // 2
    last = min(int(highest * period / (2 * np.pi)), below_nyquist)
    return np.unique(np.round(np.geomspace(1, last, lines)).astype(int)).tolist()


def _divided(hours, cycle, realisations, lowest):
    """Return the number of realisations, and of the evaluated periods in each experiment.

    One period in all m experiments takes `cycle` hours.
    """
    hours = arguments.positive("hours", hours, "a positive number of hours")
    available = int(hours / cycle)
    if realisations is None:
        realisations = np.clip(available // 3, FEWEST_REALISATIONS, MOST_REALISATIONS)
    realisations = arguments.whole("realisations", realisations, FEWEST_REALISATIONS)
    periods = available // realisations - 1
    if periods < 2:
        needed = 3 * realisations * cycle
        raise ValueError(
            f"hours = {hours:g} is too short for 3 periods of the lowest frequency in "
            f"{realisations} realisations of one experiment for each input: take hours = "
            f"{needed:.4g}, or lowest = {lowest * needed / hours:.3g}"
        )
    return realisations, periods


def _envelopes(phases, harmonics, period):
    """Compute the sum of exp(j (2 pi h t / period + phase)) over all harmonics h.

    The result has the shape (..., time), where `time` is one period.
    """
    spectrum = np.zeros((*phases.shape[:-1], period), complex)
    spectrum[..., harmonics] = np.exp(1j * phases)
    return period * np.fft.ifft(spectrum)


def _with_low_peaks(phases, harmonics, m):
    """Improve phases, so that none of the m experiments has high peaks.

    The phases have the shape (..., harmonic).
    """
    # The signal is clipped, less and less, and the phases of the clipped signal are taken, as by
    # Van der Ouderaa, Schoukens and Renneboog (Peak factor minimization using a time-frequency
    # domain swapping algorithm, IEEE Trans. Instrum. Meas. 37, 1988).
    period = next_fast_len(8 * harmonics[-1])
    turns = np.exp(2j * np.pi * np.arange(m) / m)
    best, lowest = phases, np.full((*phases.shape[:-1], 1), np.inf)
    for k in range(CLIPPING_ROUNDS):
        waves = np.real(turns[:, None] * _envelopes(phases, harmonics, period)[..., None, :])
        peak = np.abs(waves).max(axis=(-2, -1))[..., None]
        best, lowest = np.where(peak < lowest, phases, best), np.minimum(peak, lowest)
        limit = (0.6 + 0.4 * k / CLIPPING_ROUNDS) * peak
        clipped = np.fft.fft(np.clip(waves[..., k % m, :], -limit, limit))[..., harmonics]
        phases = np.angle(clipped / turns[k % m])
    return best


def with_excitation(
    trials: xr.Dataset,
    excitation: Excitation,
    loop: Loop,
    limits: dict[str, tuple[float, ...]] | None = None,
) -> xr.Dataset:
    """Write the excitation, its loop and the limits of actuators into the metadata of trials."""
    notes = {"excitation": json.dumps(asdict(excitation))}
    if limits:
        notes["actuators"] = json.dumps(limits, ensure_ascii=False)
    return with_loop(trials.assign_attrs(notes), loop)


def excitation_of(trials: xr.Dataset) -> Excitation | None:
    """Read the excitation from the metadata of a log.

    If the metadata state no excitation, None is returned.
    """

    def read(note):
        excitation = Excitation(**note)
        check_match(log=Signals(trials.attrs["Ts"]), excitation=excitation)
        return excitation

    return read_note(trials, "excitation", read)
