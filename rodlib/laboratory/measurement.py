"""From a shaken loop to its frequency response P, with the region in which the truth lies.

No model is fitted. Each line of the excitation is looked at with the lines around it that are not
excited: these hold what remains of the transient, a smooth function of frequency, and noise. The
transient is interpolated and taken off; what scatters about it is the noise, and so the accuracy.
"""

import warnings
from dataclasses import dataclass, replace
from functools import cache

import control
import numpy as np
import xarray as xr
from scipy.interpolate import make_interp_spline
from scipy.optimize import elementwise
from scipy.special import fdtrc, fdtri
from scipy.stats import chi2

from rodlib import arguments
from rodlib.laboratory.excitation import Excitation
from rodlib.laboratory.notes import excitation_of, loop_of
from rodlib.laboratory.tables import LogError, few
from rodlib.loop import CurrentTrialLoop

DEGREE = 2  # of the polynomial that the transient is, locally
NEIGHBOURS = 16  # lines at most around one, from which transient and noise are told
# Up to this multiple of a line: from zero on, the mean square of the frequency is then that of the
# line, so that noise is told right that rises with frequency, as below the bandwidth of the loop.
SPAN = np.sqrt(3)
DRAWS = 200  # of directions, for the norm of a random matrix
DRIFT = 3.0  # standard deviations without it, from which a drift is reported
SURE = 1e-3  # probability of a false report
TINY = 1e-300  # instead of a variance of zero


@dataclass(frozen=True)
class MeasuredResponse:
    """The frequency response from w to y as measured, and how far off it may be.

    At each frequency its error is C^(1/2) G `spread`, where the entries of G, m by m, are
    independent, complex and normal with variance one. `noise` estimates C with `freedom` complex
    degrees of freedom.

    Attributes
    ----------
    omega : ndarray, shape (n,)
        Frequencies, rad/s.
    response : ndarray, shape (n, m, m), complex
    noise : ndarray, shape (n, m, m), complex
        Estimated covariance of the outputs' spectra, the transient taken off.
    spread : ndarray, shape (n, m, m), complex
        Inverse of the spectra of w, (experiment, input).
    freedom : ndarray, shape (n,), int
    loop : CurrentTrialLoop
        Whose controller ran. Its observer integrates, so that P(0) = I.
    findings : tuple of str
        What speaks against the measurement, and what follows from it.
    """

    omega: np.ndarray
    response: np.ndarray
    noise: np.ndarray
    spread: np.ndarray
    freedom: np.ndarray
    loop: CurrentTrialLoop
    findings: tuple[str, ...] = ()

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the entries P11, P12, ... of the response, shape (n, m m, m m), complex."""
        each = np.einsum("nik,nej,nel->nijkl", self.noise, self.spread, self.spread.conj())
        size = self.response[0].size
        return each.reshape(-1, size, size)

    def radius(self, confidence: float = 0.95, jointly: bool = False) -> np.ndarray:
        """Radius of ||Delta||, the largest singular value, that covers the truth.

        Parameters
        ----------
        confidence : float
            Probability, between 0 and 1, that the truth lies within.
        jointly : bool
            Whether within all radii at once, rather than within each.

        Returns
        -------
        ndarray, shape (n,)

        Notes
        -----
        For one channel |Delta|^2 has an F distribution. For more, the size of Delta has one, with
        the degrees of freedom of the noise in all its directions together (Satterthwaite), and its
        shape that of a normal matrix; the share of truths covered by 95 % is then between 93 and
        96.5 %, from 4 degrees of freedom on (tests/laboratory/test_measurement.py).
        """
        confidence = arguments.number("confidence", confidence, "between 0 and 1", 0, 1)
        miss = 1 - (confidence ** (1 / len(self.omega)) if jointly else confidence)
        return _radius(self.noise, self.spread, self.freedom, miss)

    def frd(self) -> control.FrequencyResponseData:
        """The response as python-control's frequency response data."""
        return control.frd(
            np.moveaxis(self.response, 0, -1), self.omega, dt=self.loop.Ts,
            inputs=[f"w_{name}" for name in self.loop.outputs], outputs=self.loop.outputs,
        )  # fmt: skip

    def on(self, omega, confidence: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Response and radius on other frequencies, for the synthesis.

        Parameters
        ----------
        omega : array_like, shape (n,)
            Frequencies, rad/s.
        confidence : float
            Probability that the truth lies within the radius at all measured frequencies.

        Returns
        -------
        response : ndarray, shape (n, m, m), complex
            A cubic spline through what was measured and, at frequency zero, I.
        radius : ndarray, shape (n,)
            That of the neighbours, interpolated linearly, and by how much the spline differs from
            straight lines: it is assumed that it is not further than this from the truth. Above the
            highest frequency that was measured, it is assumed that P is not larger than there: the
            response is zero, the radius what P may be.
        """
        omega = np.abs(arguments.row("omega", omega))
        radius = np.append(0.0, self.radius(confidence, jointly=True))
        knots = np.append(0.0, self.omega)
        P = np.concatenate([[np.eye(len(self.loop.outputs))], self.response])
        knots_both = np.concatenate([-knots[:0:-1], knots])
        P_both = np.concatenate([P[:0:-1].conj(), P])
        spline, straight = (
            make_interp_spline(knots_both, P_both, k)(np.minimum(omega, knots[-1])) for k in (3, 1)
        )
        bend = np.linalg.norm(spline - straight, 2, axis=(1, 2))
        beyond = omega > knots[-1] * (1 + 1e-9)
        response = np.where(beyond[:, None, None], 0, spline)
        largest = np.linalg.norm(P[-1], 2) + radius[-1]
        return response, np.where(beyond, largest, np.interp(omega, knots, radius) + bend)

    def __repr__(self):
        radius = self.radius()
        lines = [
            f"P at {len(self.omega)} frequencies from {self.omega[0]:.3g} to "
            f"{self.omega[-1]:.3g} rad/s, and P(0) = I",
            f"within {radius.min():.2g} to {radius.max():.2g} (95 %, at each frequency)",
        ]
        return "\n".join([*lines, *self.findings])


def measured_response(
    log: xr.Dataset, limits: dict[str, tuple[float, float]] | None = None
) -> MeasuredResponse:
    """Estimate the frequency response from w to y from the record of a loop that was shaken.

    Parameters
    ----------
    log : xarray.Dataset
        From :func:`shake`, or loaded.
    limits : dict, optional
        Lowest and highest command that an actuator follows, by the name of the control. A slow
        plant hides from its outputs what a limit does.

    Returns
    -------
    MeasuredResponse

    Raises
    ------
    LogError
        If the log is no such record, lacks an experiment, or w is not periodic or does not excite
        every line.

    Warns
    -----
    UserWarning
        Each of the findings: commands beyond the limits, a loop that is not linear, outputs that
        drift, a lowest frequency that is too high for what is known at zero.

    Notes
    -----
    The spectrum of all periods of an experiment is P W + T + V: between the harmonics W is zero and
    T, from the state at the start and at the end, and the noise V are left. This is the local
    polynomial method for periodic excitation (Pintelon, Schoukens, Vandersteen and Barbé,
    Estimation of nonparametric noise and FRF models for multivariable linear systems, Mech. Syst.
    Signal Process. 24, 2010), with a prescribed pole: T is a polynomial not in z but in
    1 / (1 - p / z), where p is the slowest pole of the loop as designed. So a slow transient is
    one, too, as with the local rational method (McKelvey and Guérin, Non-parametric frequency
    response estimation using a local rational model, SYSID 2012), and the estimate stays linear in
    the data. Noise is taken to be stationary and smooth across neighbouring lines; where it rises
    more steeply than in proportion to frequency, the radius at the lowest lines is larger than need
    be.

    No well-kept library does this: pyFRF and scipy.signal average spectra, without a transient or
    a covariance.
    """
    arguments.instance("log", log, xr.Dataset)
    excitation, loop = excitation_of(log), loop_of(log)
    if excitation is None or loop is None:
        raise LogError("log names no excitation or no loop in its metadata: it is not of shake")
    limits = {
        name: arguments.array(f"limits[{name!r}]", pair, (2,))
        for name, pair in arguments.by_name("limits", limits, loop.controls).items()
    }
    w, y = _signals(log, excitation)
    windows = _windows(excitation.harmonics, excitation, loop)
    measured = _estimate(w, y, windows, excitation, loop)
    reports = (
        _beyond(log, limits),
        _distortion(y, excitation, measured),
        _drift(y, windows, excitation, measured),
        _unanchored(measured),
    )
    findings = tuple(report for report in reports if report)
    for finding in findings:
        warnings.warn(finding, stacklevel=2)
    return replace(measured, findings=findings)


def expected_radius(
    excitation: Excitation, rest: xr.Dataset, confidence: float = 0.95, jointly: bool = False
) -> np.ndarray:
    """How accurate a measurement will be, from the noise of a rest.

    Parameters
    ----------
    excitation : Excitation
    rest : xarray.Dataset
        From :func:`record` with the loop at rest: reference zero, no learning. At frequencies
        below those that it is long enough for, the noise of the lowest that it shows is taken; that
        is more than there is in a loop that integrates.
    confidence, jointly
        As in :meth:`MeasuredResponse.radius`.

    Returns
    -------
    ndarray, shape (n,)
        At the frequencies of the excitation.

    Raises
    ------
    ValueError
        If the rest is too short, or of another loop.
    """
    arguments.instance("excitation", excitation, Excitation)
    arguments.instance("rest", rest, xr.Dataset)
    loop, m = loop_of(rest), excitation.channels
    if loop is None:
        raise LogError("rest names no loop in its metadata: it is not of record")
    arguments.one_period(rest=loop.Ts, excitation=excitation.Ts)
    y = arguments.array(
        "rest.y", rest.y.transpose("trial", "time", "channel"), ("trial", "time", m)
    )
    samples = y.shape[1]
    if samples < 4 * NEIGHBOURS:
        raise ValueError(f"rest has {samples} samples, but must have {4 * NEIGHBOURS} or more")
    Y = np.fft.rfft(y, axis=1)[:, 1:]
    power = np.einsum("erj,erk->rjk", Y, Y.conj()) / (len(y) * samples)
    windows = _windows(excitation.harmonics, excitation, loop)
    noise = []
    for window, omega in zip(windows, excitation.omega, strict=True):
        line = omega * excitation.Ts * samples / (2 * np.pi)
        near = _nearest(line, np.arange(1, len(power) + 1)[: max(4, int(SPAN * line))])
        noise.append(window.variance * excitation.evaluated * power[near - 1].mean(0))
    lines = np.array(excitation.harmonics)
    W = np.fft.fft(excitation.signals[:, -excitation.period :], axis=1)[:, lines]
    spread = np.linalg.inv(np.moveaxis(W, 0, 2) * excitation.periods)
    freedom = np.array([m * window.freedom for window in windows])
    miss = 1 - (confidence ** (1 / len(lines)) if jointly else confidence)
    return _radius(np.array(noise), spread, freedom, miss)


def _signals(log, excitation):
    """w and y of the periods that are evaluated, shape (experiment, time, m), if all are there."""
    m = excitation.channels
    if log.sizes["channel"] != m or log.sizes["time"] != excitation.samples:
        raise LogError(
            f"log has {log.sizes['channel']} channels and {log.sizes['time']} samples, but its "
            f"excitation {m} and {excitation.samples}"
        )
    if log.trial.values.tolist() != list(range(1, m + 1)):
        raise LogError(
            f"log has the experiments {few(log.trial.values.tolist())} of {m}: go on with shake "
            "and the same path"
        )
    log = log.isel(time=slice(-excitation.evaluated, None))
    w = arguments.array("log.v", (log.reference + log.v).values, (m, "time", m))
    y = arguments.array("log.y", log.y.values, (m, "time", m))
    again = np.abs(np.diff(w.reshape(m, excitation.periods, -1, m), axis=1)).max(axis=(0, 1, 2))
    for name, off, size in zip(log.output.values, again, np.abs(w).max(axis=(0, 1)), strict=True):
        if off > 1e-6 * size:
            raise LogError(f"w of {name} is not periodic: it differs by {off:.3g} between periods")
    return w, y


def _estimate(w, y, windows, excitation, loop):
    """The response from the signals (experiment, time, channel), before it is doubted."""
    W = np.fft.rfft(w, axis=1)[:, [window.line for window in windows]]
    W = np.moveaxis(W, 0, 2)  # (line, input, experiment)
    _refuse_weak(W, excitation.omega)
    net, noise, freedom = _separated(y, windows)
    spread = np.linalg.inv(W)
    return MeasuredResponse(excitation.omega, net @ spread, noise, spread, freedom, loop)


def _refuse_weak(W, omega):
    """Refuse lines that are not excited in all directions."""
    values = np.linalg.svd(W, compute_uv=False)
    weak = omega[values[:, -1] <= 1e-6 * max(values.max(), TINY)]
    if weak.size:
        listed = ", ".join(few([f"{x:.4g}" for x in weak]))
        raise LogError(f"w does not excite all inputs at {listed} rad/s: P is not known there")


@dataclass(frozen=True)
class _Window:
    """The lines around one, and how the transient there follows from them."""

    line: int
    neighbours: np.ndarray
    weights: np.ndarray  # of the neighbours, for the transient at the line
    residual: np.ndarray  # projection: what the polynomial leaves of the neighbours

    @property
    def freedom(self) -> int:
        """Complex degrees of freedom of the noise, for each experiment."""
        return len(self.neighbours) - DEGREE - 1

    @property
    def variance(self) -> float:
        """Of the line without the transient, relative to the noise."""
        return 1 + np.sum(np.abs(self.weights) ** 2)


def _windows(harmonics, excitation, loop):
    """Of each harmonic the nearest lines that are none."""
    pole = np.abs(loop.closed.poles()).max()
    evaluated, windows = excitation.evaluated, []
    for line in excitation.periods * np.array(harmonics):
        lines = np.arange(1, min(int(SPAN * line) + 1, (evaluated + 1) // 2))
        near = _nearest(line, lines[lines % excitation.periods > 0])
        z = np.exp(2j * np.pi * np.append(line, near) / evaluated)
        warped = 1 / (1 - pole / z[1:]) - 1 / (1 - pole / z[0])
        powers = np.vander(warped / np.abs(warped).max(), DEGREE + 1, increasing=True)
        inverse = np.linalg.pinv(powers)
        windows.append(_Window(line, near, inverse[0], np.eye(len(near)) - powers @ inverse))
    return windows


def _nearest(line, lines):
    """Those of some lines that are nearest to one."""
    return lines[np.argsort(np.abs(lines - line), kind="stable")[:NEIGHBOURS]]


def _separated(y, windows):
    """Lines without transient (line, output, experiment), their noise, its degrees of freedom."""
    Y = np.fft.rfft(y, axis=1)
    net, noise = [], []
    for window in windows:
        around = Y[:, window.neighbours]
        net.append(Y[:, window.line] - np.einsum("r,erj->ej", window.weights, around))
        left = np.einsum("qr,erj->eqj", window.residual, around)
        power = np.einsum("eqj,eqk->jk", left, left.conj()) / (len(y) * window.freedom)
        noise.append(window.variance * power)
    freedom = np.array([len(y) * window.freedom for window in windows])
    return np.array(net).transpose(0, 2, 1), np.array(noise), freedom


def _distortion(y, excitation, measured):
    """What is found at harmonics that were not excited: there, a linear loop shows noise only."""
    excited = np.array(excitation.harmonics)
    between = (excited[1:] + excited[:-1]) // 2
    quiet = between[~np.isin(between, excited)]
    if not quiet.size:
        return None
    m, loop = excitation.channels, measured.loop
    windows = _windows(quiet, excitation, loop)
    net, noise, freedom = _separated(y, windows)
    power = np.mean(np.abs(net) ** 2, axis=2)  # (line, output)
    expected = np.einsum("njj->nj", noise).real
    chance = fdtrc(2 * m, 2 * freedom[:, None], power / np.maximum(expected, TINY))
    together = chi2.sf(-2 * np.log(np.maximum(chance, 1e-300)).sum(0), 2 * len(quiet))
    if together.min() > SURE / m:
        return None
    excess = np.sqrt(np.maximum(power - expected, 0).mean(0).max())
    off = excess * np.median(np.linalg.norm(measured.spread, 2, axis=(1, 2)))
    names = [n for n, p in zip(loop.outputs, together, strict=True) if p <= SURE / m]
    return (
        f"the loop is not linear: {', '.join(names)} move at harmonics that were not excited. P is "
        f"off by about {off:.2g}, which the radius does not contain. An actuator at its limit, "
        "perhaps: shake with a smaller amplitude"
    )


def _drift(y, windows, excitation, measured):
    """Whether the means drift from period to period, more than what else there is would explain."""
    periods, m = excitation.periods, excitation.channels
    means = y.reshape(m, periods, -1, m).mean(axis=2)
    steps = np.arange(periods) - (periods - 1) / 2
    slope = np.einsum("p,epj->ej", steps, means) / np.sum(steps**2)
    ramp = slope[:, None] * np.arange(y.shape[1])[:, None] / excitation.period
    off = np.linalg.norm(_separated(ramp, windows)[0] @ measured.spread, 2, axis=(1, 2))
    without = replace(measured, noise=_separated(y - ramp, windows)[1])
    deviation = np.sqrt(np.einsum("nkk->n", without.covariance).real)
    worst = (off / np.maximum(deviation, TINY)).argmax()
    if off[worst] <= DRIFT * deviation[worst]:
        return None
    fastest = np.abs(slope).max(axis=0).argmax()
    rate = np.abs(slope[:, fastest]).max() / (excitation.period * excitation.Ts) * 3600
    return (
        f"{measured.loop.outputs[fastest]} drifts by {rate:.3g} an hour: P is off by about "
        f"{off[worst]:.2g} at {measured.omega[worst]:.3g} rad/s, and the radius is larger for it. "
        "Wait until the rig is warm, or shake at higher frequencies"
    )


def _beyond(log, limits):
    """Commands that the actuators did not follow."""
    beyond = {}
    for name, (low, high) in limits.items():
        u = log.u.sel(channel=log.control == name).values
        beyond[name] = np.mean((u < low) | (u > high))
    listed = ", ".join(f"{name} in {share:.1%}" for name, share in beyond.items() if share)
    if not listed:
        return None
    return (
        f"commands were beyond the limits of {listed} of all samples: what was measured is not the "
        "loop, and the radius does not contain that. Shake with a smaller amplitude"
    )


def _unanchored(measured):
    """Whether P has turned away from I before the lowest frequency."""
    away = np.linalg.norm(measured.response[0] - np.eye(len(measured.response[0])), 2)
    if away <= 1:
        return None
    return (
        f"P differs from I by {away:.2g} at the lowest frequency, {measured.omega[0]:.3g} rad/s: "
        "between it and zero, P is not known. Shake at lower frequencies, or design above"
    )


@cache
def _directions(m):
    """Random matrices whose entries are normal, divided by their Frobenius norm."""
    if m == 1:
        return np.ones((1, 1, 1))
    parts = np.random.default_rng(0).standard_normal((2, DRAWS, m, m))
    G = parts[0] + 1j * parts[1]
    return G / np.linalg.norm(G, axis=(1, 2), keepdims=True)


def _shrunk(noise, freedom):
    """Eigenvalues of the noise's covariance, eigenvectors, and the freedom of their sum.

    Those of an estimate lie further apart than the true ones. They are drawn towards their mean
    until the sum of their squares is what it is without bias; it also tells in how many directions
    the noise goes, from 1 to m, each of which has its own degrees of freedom.
    """
    m = noise.shape[-1]
    values, vectors = np.linalg.eigh(noise)
    values = np.maximum(values, 0)
    square, squares = values.sum(axis=1) ** 2, (values**2).sum(axis=1)
    directions = (square - squares / freedom) / np.maximum(squares - square / freedom, TINY)
    directions = np.clip(directions, 1, m)
    apart = (square / directions - square / m) / np.maximum(squares - square / m, TINY)
    mean = values.mean(axis=1, keepdims=True)
    values = mean + np.sqrt(np.clip(apart, 0, 1))[:, None] * (values - mean)
    return np.maximum(values, 0), vectors, freedom * directions


def _radius(noise, spread, freedom, miss):
    """The radius that the norm of the error exceeds with probability `miss`, at each frequency."""
    m = noise.shape[-1]
    values, vectors, freedom = _shrunk(noise, freedom)
    root = vectors * np.sqrt(values)[:, None]
    products = root[:, None] @ _directions(m) @ spread[:, None]
    norms = np.linalg.eigvalsh(products @ products.conj().swapaxes(-1, -2))[..., -1]
    gain = m**2 * np.maximum(norms, TINY)

    def excess(log_square, k):
        ratio = np.exp(log_square)[..., None] / gain[k]
        return fdtrc(2 * m**2, 2 * freedom[k][..., None], ratio).mean(-1) - miss

    quantile = np.log(fdtri(2 * m**2, 2 * freedom, 1 - miss))
    bracket = np.log(gain.min(1)) + quantile - 1e-6, np.log(gain.max(1)) + quantile + 1e-6
    found = elementwise.find_root(excess, bracket, args=(np.arange(len(noise)),))
    return np.exp(found.x / 2)
