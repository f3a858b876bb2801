"""The frequency response of any record in which the input moved enough, with its region.

Of several trials, what they differ by counts: what repeats in all of them, a disturbance or a start
that is off, cancels. What is not known, because the input had no power there, is said so.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import xarray as xr
from scipy.linalg import helmert
from scipy.signal import fftconvolve
from scipy.special import fdtrc

from rodlib.ilc import arguments
from rodlib.ilc.loop.closed import ClosedLoop, Loop
from rodlib.ilc.loop.notes import LogError, loop_of
from rodlib.ilc.measurement.impulse import impulse_of
from rodlib.ilc.problem.problem import largest_singular_values
from rodlib.ilc.problem.responses import Measured
from rodlib.ilc.signals import period_of

LINES = 200  # frequencies at which the region is found
FEWEST = 20  # samples of a trial
STILL = 1e-3  # of the range of an input: trials that differ by less do not differ
LEARNED = 0.5  # of the largest P, and of its size before the data: what is further off is not known
SURE = 1e-6  # probability by which noise alone may make trials start apart
# standard deviations, from which on neighbouring lines contradict an estimate
BEYOND = 3.0
# of the largest P, that neighbouring lines by themselves are off by at most
SEEN = 0.25
EACH = 8  # lines of all trials together, for each input, that are neighbours
# of a record, in which a response falls by e a priori, if it is to settle
LONGEST = 0.6
LATE = 0.4  # of a response in the later half of the record, from which on it does not settle
TAIL = 10  # draws beyond which a quantile is extrapolated, as of a normal distribution


@dataclass(frozen=True, repr=False)
class EstimatedResponse(Measured):
    """The frequency response from an input to y as estimated, and responses that may be the truth.

    Where it is not known, the radius admits all that is not larger than the largest that is known;
    above all that is known, than at the last frequency that is.
    """

    omega: np.ndarray  # rad/s, shape (n,)
    # shape (lags, m, m): the response over time, of which `errors` are off
    impulse: np.ndarray
    errors: np.ndarray  # shape (draw, n, m, m), complex
    # shape (n,), bool: whether the data tell more than what was assumed
    known: np.ndarray
    loop: Loop  # from whose w to y it is; a ClosedLoop without P, if the record names none
    record: str  # what it was estimated from, in words
    lasting: float  # s, in which all but a smooth part of the response falls by e
    # shape (n,): what lines by themselves would be off by, in the largest P
    alone: np.ndarray
    findings: tuple[str, ...] = ()

    @cached_property
    def response(self) -> np.ndarray:
        """The estimate at `omega`, shape (n, m, m), complex."""
        return self._at(self.omega)

    def _at(self, omega):
        lags = np.arange(len(self.impulse))
        return np.tensordot(
            np.exp(-1j * self.loop.Ts * np.outer(omega, lags)), self.impulse, 1
        )

    @cached_property
    def _norms(self):
        """Of the errors, (draw, n)."""
        errors = self.errors.reshape(-1, *self.errors.shape[2:])
        return largest_singular_values(errors).reshape(len(self.errors), -1)

    def _radius(self, confidence, jointly):
        norms = self._norms
        radius = np.sqrt(np.mean(norms**2, axis=0))
        worst = norms / radius
        if jointly:
            worst = worst[:, self.known].max(axis=1, keepdims=True)
        least = TAIL / len(norms)
        radius *= np.quantile(worst, 1 - max(1 - confidence, least), axis=0)
        if 1 - confidence < least:
            radius *= np.sqrt(np.log(1 - confidence) / np.log(least))
        size = largest_singular_values(self.response)
        last = np.flatnonzero(self.known)[-1]
        anything = np.full(len(size), (size + radius)[self.known].max())
        anything[last:] = (size + radius)[last]
        return np.where(self.known, radius, size + anything)

    def _on(self, omega, confidence):
        """With the larger radius of the two neighbours in `self.omega`."""
        radius = self.radius(confidence, jointly=True)
        after = np.searchsorted(self.omega, omega).clip(1, len(radius) - 1)
        return self._at(omega), np.maximum(radius[after - 1], radius[after])

    def _scaled(self, scale):
        units = scale / scale[:, None]
        return replace(self, impulse=self.impulse * units, errors=self.errors * units)

    def _basis(self, omega, confidence):
        lines = [
            f"P estimated from {self.record}; wherever it is known, the truth is within the radius "
            f"with confidence {confidence:g}",
            "assumed: the plant is linear and settles within a trial, smoothly after "
            f"{self.lasting:.2g} s: a resonance that lasts longer and was not excited is not seen; "
            "without that, single frequencies would be known to within "
            f"{self.alone[self.known].max():.1%} of the largest P, at worst",
        ]
        if not self.known.all():
            ends = self.omega[self.known][[0, -1]]
            lines.append(
                f"P is known from {ends[0]:.3g} to {ends[1]:.3g} rad/s, not at "
                f"{np.mean(~self.known):.0%} of {LINES} frequencies: elsewhere the input had too "
                "little power; assumed: P is not larger there"
            )
        return lines

    def __repr__(self):
        radius = self.radius()[self.known]
        within = (
            f"within {radius.min():.2g} to {radius.max():.2g} (95 %, at each frequency)"
        )
        return f"{super().__repr__()}\n{within}"


def estimated_response(log: xr.Dataset, of: str | None = None) -> EstimatedResponse:
    """Estimate a frequency response from a record; see :func:`rodlib.measured_response`."""
    if of is None:
        of = "w" if "reference" in log else "u"
    arguments.choice("of", of, ["u", "w"])
    if of == "w" and "reference" not in log:
        raise LogError("log has no reference, and so no w: take of = 'u'")
    if of == "u" and "u" not in log:
        raise LogError("log has no commands u: take of = 'w', or read them by `inputs`")
    u = log.u if of == "u" else log.reference + log.get("v", 0)
    u, y = (x.transpose("trial", "time", "channel").values for x in (u, log.y))
    names = [str(n) for n in (log.control if of == "u" else log.output).values]
    outputs = [str(n) for n in log.output.values]
    u = arguments.array(f"log.{of}", u, ("trial", "time", "channel"))
    y = arguments.array("log.y", y, u.shape)
    Ts = period_of(log)
    u, y, record = _moved(of, u, y, names, outputs)
    found = [impulse_of(u, y[:, :, i]) for i in range(len(outputs))]
    lags = max(one.drawn.shape[2] for one in found)
    omega = np.geomspace(np.pi / (2 * u.shape[1] * Ts), np.pi / Ts, LINES)
    F = np.exp(-1j * Ts * np.outer(np.arange(lags), omega))
    drawn, prior = (
        np.stack(
            [getattr(one, name) @ F[: one.drawn.shape[2]] for one in found], axis=1
        )
        for name in ("drawn", "prior")
    )  # (draw, output, input, n)
    impulse = np.stack([one.drawn.mean(axis=0) for one in found], axis=0)
    errors = drawn - drawn.mean(axis=0)
    sizes = u.std(axis=(0, 1)) / y.std(axis=(0, 1))[:, None]
    after, before, size = (
        np.sqrt(np.mean(np.abs(x * sizes[..., None]) ** 2, axis=(0, 1)))
        for x in (errors, prior, drawn.mean(axis=0, keepdims=True))
    )  # (input, n)
    known = (after < LEARNED * np.minimum(before.max(axis=0), size.max())).all(axis=0)
    g = np.moveaxis(impulse, 2, 0)[: u.shape[1]]
    left = y - np.einsum(
        "ktoi->kto", fftconvolve(u[:, :, None], g[None], axes=1)[:, : u.shape[1]]
    )
    off = np.sqrt((after**2).sum(axis=0) * len(outputs))
    alone, agrees = _seen(u / u.std((0, 1)), left / y.std((0, 1)), omega * Ts, off)
    alone /= size.max()
    known &= agrees & (alone < SEEN)
    findings = _started_apart(left, outputs) if len(left) > 1 else ()
    if not known.any():
        raise LogError(
            f"log tells P at no frequency: what {', '.join(names)} did drowns in noise, or they "
            "moved alike. Record longer, or move them more, each by itself"
        )
    lasting = [one.lasting for one in found]
    _check_settled(np.abs(impulse), lasting, outputs, u.shape[1])
    loop = loop_of(log) if of == "w" else None
    if loop is None:
        units = dict(zip(outputs, log.output_unit.values.tolist(), strict=True))
        loop = ClosedLoop(None, Ts, outputs, units=units)
    return EstimatedResponse(
        omega, np.moveaxis(impulse, 2, 0), np.moveaxis(errors, 3, 1), known, loop, record,
        Ts * max(lasting), alone, findings,
    )  # fmt: skip


def _seen(u, left, angles, off):
    """What a mean over neighbouring lines is off by, and where it agrees with the estimate; (n,).

    From inputs and what the estimate, which is off by `off`, leaves of the outputs, shape (trial,
    time, channel). Such a mean assumes nothing of an impulse response: what the estimate knows
    better, it knows from its prior; where what is left follows the inputs, the prior was wrong.
    """
    # steps do not leak so
    U, E = (np.fft.rfft(np.diff(x, axis=1), axis=1) for x in (u, left))
    K, F, m = U.shape
    line = angles * (u.shape[1] - 1) / (2 * np.pi)
    # lines, so that a narrow resonance is not averaged away
    few = min(-(-EACH * m // K), F - 2)
    first = np.clip(np.rint(line - few / 2).astype(int), 1, F - 1 - few)
    last = first + few

    def total(each):
        sums = np.cumsum(np.concatenate([np.zeros_like(each[:1]), each]), axis=0)
        return sums[last + 1] - sums[first]

    S, C = (total(np.einsum("kfi,kfj->fij", U.conj(), x)) for x in (U, E))
    power = np.linalg.eigvalsh(S)[:, 0]
    noise, count = total((np.abs(E) ** 2).sum(axis=0)), K * (last + 1 - first)
    D = np.linalg.pinv(S, hermitian=True) @ C
    left_over = noise.sum(axis=1) - np.einsum("nij,nij->n", C.conj(), D).real
    with np.errstate(divide="ignore"):
        own = np.sqrt(left_over / np.maximum(count - m, 1) / np.maximum(power, 0))
    return own, largest_singular_values(D) < BEYOND * np.hypot(own, off)


def _started_apart(left, outputs):
    """Whether trials begin further apart than noise lets them, in words."""
    K, N, _ = left.shape
    n = max(1, N // 10)
    first, later = ((x**2).mean(axis=(0, 1)) for x in (left[:, :n], left[:, N // 2 :]))
    apart = fdtrc(K * n, K * (N - N // 2), first / later) < SURE
    names = ", ".join(name for name, one in zip(outputs, apart, strict=True) if one)
    start = f"the trials start from different states ({names}), and the radius assumes that they "
    return (
        (f"{start}start alike: bring the plant back before each, or wait longer",)
        if names
        else ()
    )


def _moved(of, u, y, names, outputs):
    """Trials that are independent, and what they are, in words; an input must have moved."""
    K, N, _ = u.shape
    if N < FEWEST:
        raise LogError(
            f"log has {N} samples in a trial, but must have {FEWEST} or more"
        )
    span = np.ptp(u, axis=(0, 1))
    still = [name for name, x in zip(names, span, strict=True) if not x]
    if still:
        raise LogError(
            f"log.{of} of {', '.join(still)} never moved: what follows from it is not known. "
            "Record it while it moves, by a step or by noise"
        )
    flat = [
        name for name, x in zip(outputs, np.ptp(y, axis=(0, 1)), strict=True) if not x
    ]
    if flat:
        raise LogError(f"log.y of {', '.join(flat)} never moved: is it connected?")
    size = f"{K} trials" if K > 1 else "one trial"
    words = f"{size} of {N} samples, from {of} to y"
    if K == 1:
        return u, y, f"{words}; assumed: nothing but {of}, noise and drift moves y"
    H = helmert(K)
    if np.all(np.ptp(u, axis=0).max(axis=0) > STILL * span):
        words += ", by what the trials differ; assumed: they start alike"
        return np.tensordot(H, u, 1), np.tensordot(H, y, 1), words
    mean = u.mean(axis=0, keepdims=True), y.mean(axis=0, keepdims=True)
    return (
        *mean,
        f"{words}, in the mean of trials that are alike; assumed: no disturbance repeats",
    )


def _check_settled(impulse, lasting, outputs, n):
    """Refuse responses (output, input, lag) that do not end within n samples."""
    share = (impulse[..., n // 2 : n].sum(axis=2) / impulse[..., :n].sum(axis=2)).max(
        axis=1
    )
    for name, late, fall in zip(outputs, share, lasting, strict=True):
        if late > LATE or fall > LONGEST * n:
            raise LogError(
                f"{name} does not settle within the {n} samples of a trial: it integrates or rings "
                "on, or the record is too short. Record longer, or in a closed loop"
            )
