"""The frequency response of any records in which the input moved, with its region.

One regression for each output; see :mod:`ilctools.measurement.regression`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy import ndimage
from scipy.special import gammaincinv

from ilctools import arguments
from ilctools.law.io import RESET
from ilctools.loop.closed import ClosedLoop, Loop
from ilctools.loop.notes import LogError, loop_of
from ilctools.measurement.consistency import contradictions
from ilctools.measurement.regression import Regression, Trials, regression
from ilctools.problem.problem import largest_singular_values
from ilctools.problem.responses import Measured
from ilctools.signals import Signals, check_match, period_of

LINES = 200  # frequencies at which the region is found
FEWEST = 20  # samples of a trial
LEARNED = 0.5  # of the deviation before the data: what is less is identified
SMOOTHED = 5.0  # lines, over which this is averaged
INTERVALS = 2  # of frequencies, the longest, that are said to be identified
import os
FACTOR = float(os.environ.get('FACTOR', '0.85'))
INDEPENDENT = 50
UNKNOWN = 1e-3
MIDDLE = 0.8  # quantile of the errors at a line, to which they are relative
TAIL = 10  # draws beyond which a quantile is extrapolated, as of a normal distribution
STABLE = 0.1  # least share of stable draws; with fewer the record is refused
SETTLED = 0.95  # with fewer a finding says that the output may not settle
LOOP = "learning presupposes a stable plant. Record longer, or in a closed loop"
NAMED = 5  # contradictions at most that are said


class Agreement(NamedTuple):
    """How well an estimate predicts another record."""

    # 1 - RMS of the error of simulation / RMS of the output's moves, (outputs,)
    fit: np.ndarray
    inside: float  # share of frequencies, identified in both, where the regions of both meet


@dataclass(frozen=True, repr=False)
class EstimatedResponse(Measured):
    """The frequency response from an input to y as estimated, and responses that may be the truth.

    Where the records say little, what was assumed before them makes the radius.
    """

    omega: np.ndarray  # rad/s, shape (n,)
    fits: tuple[Regression, ...]  # of each output
    units: np.ndarray  # shape (outputs, inputs): of P, by which each fit is multiplied
    # whether the data say more than what was assumed, shape (n,), bool
    known: np.ndarray
    loop: Loop  # from whose w to y it is; a ClosedLoop without P, if the record names none
    of: str  # the input: "w" or "u"
    record: str  # what it was estimated from, in words
    apart: float = 0.0  # of P, by which records contradict one linear plant
    findings: tuple[str, ...] = ()

    @cached_property
    def response(self) -> np.ndarray:
        """The estimate at `omega`, shape (n, outputs, inputs), complex."""
        return self._at(self.omega)

    def _at(self, omega):
        rows = [fit.response(omega * self.loop.Ts) for fit in self.fits]
        inputs = self.units.shape[1]
        return self.units * np.stack([row[:, :inputs] for row in rows], axis=1)

    def _region(self, omega, confidence, jointly):
        """The estimate and its radius; `jointly` at all frequencies."""
        P, inputs = self._at(omega), self.units.shape[1]
        mean, root, share = 0.0, 0.0, 0.0  # of the trace of S, of tr(S S), of dA / A
        for fit, units in zip(self.fits, self.units, strict=True):
            D, of_A = fit.errors(omega * self.loop.Ts)
            D = D[:, :inputs] * units[:, None]
            D = np.concatenate([D.real, D.imag], axis=1)
            S = D @ D.swapaxes(1, 2)
            mean = mean + np.einsum("nii->n", S)
            root = root + np.linalg.norm(S, axis=(1, 2))
            share = np.maximum(share, of_A)
        miss = (1 - confidence) / (INDEPENDENT if jointly else 1)
        shape = mean**2 / (2 * root**2)
        radius = FACTOR * np.sqrt(gammaincinv(shape, 1 - miss) * mean / shape)
        left = 1 - FACTOR * np.sqrt(-np.log(miss)) * share
        radius = radius / np.maximum(left, UNKNOWN)
        return P, radius + self.apart * largest_singular_values(P)

    def _radius(self, confidence, jointly):
        return self._region(self.omega, confidence, jointly)[1]

    def _on(self, omega, confidence):
        """All at once, these frequencies and `self.omega`."""
        n = len(omega)
        P, radius = self._region(np.append(omega, self.omega), confidence, True)
        return P[:n], radius[:n]

    def _scaled(self, scale):
        return replace(self, units=self.units * scale / scale[:, None])

    def check(self, log: xr.Dataset) -> Agreement:
        """How well the estimate predicts a record that it was not made of.

        Parameters
        ----------
        log : xarray.Dataset
            Another record of the same plant, from the same input.

        Returns
        -------
        Agreement
            ``fit``, for each output without a straight line: 1 is perfect, 0 as good as no motion
            at all. ``inside``: of the frequencies identified in both records, the share at which
            their regions, of 99 % jointly, have a plant in common; 1 if there are none.
        """
        other = estimated_response([log], self.of)
        check_match(P=self.loop, log=other.loop)
        u, y = _signals(log, self.of)
        n = u.shape[1]
        g = self.units[..., None] * [fit.impulse(n)[: u.shape[2]] for fit in self.fits]
        size = 2 * n
        U, G = np.fft.rfft(u, size, axis=1), np.fft.rfft(g, size)
        simulated = np.fft.irfft(np.einsum("ijf,kfj->kfi", G, U), size, axis=1)[:, :n]
        line = np.linalg.qr(np.stack([np.ones(n), np.arange(n)], axis=1))[0]
        off, moved = (x - line @ (line.T @ x) for x in (y - simulated, y))
        fit = 1 - np.linalg.norm(off, axis=(0, 1)) / np.linalg.norm(moved, axis=(0, 1))
        P, radius = self.on(other.omega, 0.99)
        apart = largest_singular_values(P - other.response)
        inside = apart <= radius + other.radius(0.99, jointly=True)
        both = other.known & np.interp(other.omega, self.omega, self.known).astype(bool)
        return Agreement(fit, float(inside[both].mean()) if both.any() else 1.0)

    def _basis(self, omega, confidence):
        ends = np.flatnonzero(np.diff(np.pad(self.known.astype(int), 1)))
        where = ", ".join(
            f"{self.omega[a]:.3g} to {self.omega[b - 1]:.3g}" for a, b in ends.reshape(-1, 2)
        )
        lines = [
            f"P estimated from {self.record}; the truth is within the radius with confidence "
            f"{confidence:g}",
            "assumed: the plant is linear, stays as it is, and A(z) y = B(z) u describes it with "
            f"{self.fits[0].data.layout.knots[-1]} lags, those of B after a delay",
        ]
        if not self.known.all():
            lines.append(
                f"P is identified from {where} rad/s; elsewhere the input had too little power, "
                "and the radius is that of what was assumed before the data"
            )
        return lines

    def __repr__(self):
        radius = self.radius()[self.known]
        within = f"within {radius.min():.2g} to {radius.max():.2g} (95 %, at each frequency)"
        return f"{super().__repr__()}\n{within}"


def estimated_response(logs: Sequence[xr.Dataset], of: str | None = None) -> EstimatedResponse:
    """Estimate a frequency response from records; see :func:`ilctools.measured_response`."""
    if of is None:
        of = "w" if all("reference" in log for log in logs) else "u"
    arguments.choice("of", of, ["u", "w"])
    names = [f"log[{i}]" if len(logs) > 1 else "log" for i in range(len(logs))]
    first = logs[0]
    check_match(**{n: Signals.of_log(log) for n, log in zip(names, logs, strict=True)})
    signals = [_signals(log, of, name) for log, name in zip(logs, names, strict=True)]
    moved = [str(n) for n in (first.control if of == "u" else first.output).values]
    outputs = [str(n) for n in first.output.values]
    check_moved([u for u, _ in signals], moved, f"{names[0]}.{of}", "what follows from it is not "
                 "known. Record it while it moves, by a step or by noise")  # fmt: skip
    check_moved([y for _, y in signals], outputs, f"{names[0]}.y", "is it connected?")
    u_size, y_size = (_size([pair[k] for pair in signals]) for k in (0, 1))
    groups = []
    for log, name, (u, y) in zip(logs, names, signals, strict=True):
        where = f" of {name}" if len(logs) > 1 else ""
        joined = len(y) < log.sizes["trial"]
        titles = ["the trials"] if joined else [f"trial {k}" for k in log.trial.values]
        titles = tuple(title + where for title in titles)
        groups.append(Trials(_with_disturbances(log, u / u_size), y / y_size, titles))
    width = min(group.u.shape[2] for group in groups)
    direct = of == "w" or "reference" not in first
    fits, found, apart = [], [], 0.0
    for i, name in enumerate(outputs):
        one = [Trials(x.u[..., :width], x.y[..., [i]], x.names) for x in groups]
        fit = regression(one, direct)
        fits.append(fit)
        said = sorted(contradictions(fit, one), key=lambda pair: -pair[1])
        apart = max([apart, *(off for _, off in said)])
        if said:
            words = "; ".join(f"{what} (by {off:.0%} of P)" for what, off in said[:NAMED])
            found.append(
                f"{name} is not that of one linear plant: {words}. The radius is larger for it: "
                "leave such trials or times out, by isel, or move the input less"
            )
    Ts, longest = period_of(first), max(y.shape[1] for _, y in signals)
    omega = np.geomspace(np.pi / (2 * longest * Ts), np.pi / Ts, LINES)
    loop = loop_of(first) if of == "w" else None
    if loop is None:
        units = dict(zip(outputs, first.output_unit.values.tolist(), strict=True))
        loop = ClosedLoop(None, Ts, outputs, units=units)
    estimate = EstimatedResponse(
        omega, tuple(fits), y_size[:, None] / u_size, np.ones(LINES, bool), loop, of,
        _words(signals, of), apart, tuple(found),
    )  # fmt: skip
    known = _identified(estimate)
    if not known.any():
        raise LogError(
            f"P is identified at no frequency: the response to {', '.join(moved)} is below the "
            "noise, or they moved alike. Record longer, or move them more, each by itself"
        )
    return replace(estimate, known=known)


def _identified(estimate):
    """Where the data say more than what was assumed, and P is not lost in errors: two intervals."""
    off = estimate.radius() / largest_singular_values(estimate.response)
    label, count = ndimage.label(ndimage.gaussian_filter1d(np.log(off), SMOOTHED) < 0)
    longest = np.argsort(np.bincount(label.ravel(), minlength=count + 1)[1:])[-INTERVALS:] + 1
    return np.isin(label, longest)


def _signals(log, of, name="log"):
    """Input and outputs from before each trial on, (trial, time, channel)."""
    if of == "w" and "reference" not in log:
        raise LogError(f"{name} has no reference, and so no w: take of = 'u'")
    if of == "u" and "u" not in log:
        raise LogError(f"{name} has no commands u: take of = 'w', or read them by `inputs`")
    u = log.u if of == "u" else log.reference + log.get("v", 0)
    axes = "trial", "time", "channel"
    u, y = (x.transpose(*axes).values for x in (u, log.y))
    u = arguments.array(f"{name}.{of}", u, axes)
    y = arguments.array(f"{name}.y", y, (*u.shape[:2], "channel"))
    if len(y[0]) < FEWEST:
        raise LogError(f"{name} has {len(y[0])} samples in a trial, but must have {FEWEST} or more")
    # Before a trial w rests at the reference's first row; commands, at their own.
    before = u if of == "u" else log.reference.transpose(*axes).values
    if RESET in log.attrs:  # trials go on where the last one ended: one record
        u, y, before = (x.reshape(1, -1, x.shape[2]) for x in (u, y, before))
    return u - before[:, :1], y - y[:, :1]


def _with_disturbances(log, u):
    """The inputs, and other ones that are known."""
    if "disturbance" not in log:
        return u
    d = log.disturbance.transpose("trial", "time", ...).values
    d = d.reshape(*u.shape[:2], -1)
    d = d - d[:, :1]
    return np.concatenate([u, d / np.maximum(_size([d]), 1e-300)], axis=2)


def check_moved(signals, names, what, remedy):
    """Refuse signals, (trial, time, channel) of each record, of which one stands still."""
    still = np.all([np.ptp(x, axis=1).max(axis=0) == 0 for x in signals], axis=0)
    if still.any():
        words = ", ".join(name for name, one in zip(names, still, strict=True) if one)
        raise LogError(f"{what} of {words} never moved: {remedy}")


def _size(signals):
    """Root mean square of the moves of signals (trial, time, channel)."""
    moves = [(x - x.mean(axis=1, keepdims=True)).reshape(-1, x.shape[2]) for x in signals]
    return np.sqrt(np.mean(np.concatenate(moves) ** 2, axis=0))


def _words(signals, of):
    sizes = [f"{len(y)} trials" if len(y) > 1 else "one trial" for _, y in signals]
    each = [f"{size} of {y.shape[1]} samples" for size, (_, y) in zip(sizes, signals, strict=True)]
    again = ", what repeats in all trials" if any(len(y) > 1 for _, y in signals) else ""
    return (
        f"{' and '.join(each)}, from {of} to y; assumed: y is moved by {of}{again}, known "
        "disturbances, noise and drift only"
    )
