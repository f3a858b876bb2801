"""Estimate a frequency response, with a radius of its error, from records with varying inputs.

Each output has a regression of its own, see :mod:`ilctools.measurement.arx.regression`. The
regression estimates a denominator A and numerators B_j, and P_j = B_j / A. The errors of these
estimates are dA and dB_j, whose distribution is the posterior. To first order in these errors, and
then without approximation,

    dP_j = (dB_j - P_j dA) / A,    P_j true - P_j = dP_j / (1 + dA / A).                        (1)

*Radius.* Let S be the covariance of all real and imaginary parts of dP. Then ||dP||^2 in the
Frobenius norm has the mean tr S and the variance 2 tr S^2. The Frobenius norm is no less than the
largest singular value. ||dP||^2 is taken to be gamma distributed (F. E. Satterthwaite, Biometrics
Bulletin 2 (1946) 110-114). The errors of different outputs may be correlated in any way. Then tr S
is the sum of the outputs' traces, and the root of tr S^2 is no more than the sum of the outputs'
roots. Let p be the probability that an error exceeds the radius. Let x be the quantile of ||dP||^2
at 1 - p, in units of the gamma distribution's scale theta. The division by 1 + a in (1) makes the
tail heavier. Here a = dA / A is complex and normal with variance sigma^2. For one circular and
independent entry of dP

    P(|dP|^2 > theta t |1 + a|^2) = exp(-t / (1 + t sigma^2)) / (1 + t sigma^2) = exp(-x),      (2)

which has one solution t by Wright's omega function. The radius is c (theta t)^(1/2). At each
frequency by itself, c is `FACTOR`. For all frequencies at once, c is `JOINT`, and p is divided by
`INDEPENDENT`. With these numbers, the radius covers the true P in the benchmarks
(docs/estimator.md).

*Stability.* If Re(1 + a) > 0 on the unit circle, 1 + a does not encircle zero. Then the true A has
as many zeros outside the circle as its estimate (Rouche). If there are such zeros, the plant is
unstable: its output does not settle. If zero is within `UNSTABLE` standard deviations of Re(1 + a)
at some frequency, the plant may or may not settle.
"""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import control
import numpy as np
import xarray as xr
from scipy.special import gammainccinv, wrightomega

from ilctools.errors import LogError
from ilctools.loop.closed import CurrentTrialLoop, Loop
from ilctools.measurement.arx.regression import Regression, regression
from ilctools.measurement.consistency import contradictions
from ilctools.measurement.record import Record
from ilctools.models import frequency_response
from ilctools.response.measured import CONFIDENCE, Measured
from ilctools.response.samples import SAME_FREQUENCY, Assumed
from ilctools.signals import check_match
from ilctools.singular_values import largest_singular_values
from ilctools.threads import on_one_thread

FACTOR, JOINT = 0.85, 1.36  # factors of radii, at each frequency and at all of them
INDEPENDENT = 50  # number of independent frequencies, by which p is divided for all frequencies
HANKEL_ROWS = 300  # samples; also the largest number of states of a model
ROUNDING_OF_HANKEL = 1e-12  # relative to the largest singular value: smaller ones are rounding
STATED_FREQUENCIES = 200  # number of frequencies at which P is stated
MODEL_NEAR = 0.1  # largest error of a model, relative to the largest P, if the radius is larger
SEEN = 0.02  # relative to P: smaller contradictions widen the radius, but are not reported
WORDS_AT_MOST = 5  # contradictions that a finding names, the largest first
# With a smaller value, fewer plants that do not settle give a warning. With a larger value, more
# plants that settle give a warning.
UNSTABLE = 0.77
# P rises like the P of an integrator if it grows by more than RISE from twice the lowest resolved
# frequency down to this frequency. An integrator grows by 2, and a first-order lag with a time
# constant of a sixth of the record grows by 1.6. P at rest must be SURE_OF_REST times its radius
# for a lag to be certain. Both numbers were found by counting.
RISE, SURE_OF_REST = 1.95, 3.0
SMALLER = (
    "the signals are as large as in the excitation, because the gain may differ for smaller "
    "ones: shake the loop with a second amplitude, and compare by P.check(log)"
)
LOOP = "learning presupposes a stable plant: record for longer, or in a closed loop"


class Moments(NamedTuple):
    """What determines the distribution of the errors at n frequencies."""

    trace: np.ndarray  # tr S, (n,)
    root: np.ndarray  # the root of tr S^2, or a bound on it, (n,)
    shares: np.ndarray  # variances of the real and the imaginary part of dA / A, (output, 2, n)


class Agreement(NamedTuple):
    """Whether an estimate agrees with another record.

    Attributes
    ----------
    contradicts : bool
        Whether, at some frequency, the distance between the two estimates exceeds the root of the
        sum of their squared radii. For records of one linear plant, the probability of this is 1 %.
    by : float
        The distance relative to P, at the frequency where the distance is largest relative to the
        radii. Zero if the records agree.
    """

    contradicts: bool
    by: float


@dataclass(frozen=True, repr=False)
class EstimatedResponse(Measured):
    """The estimated frequency response from an input to y, and how wrong the estimate may be.

    At frequencies where the records contain little information, the prior determines the radius.
    """

    omega: np.ndarray  # rad/s, shape (n,)
    fits: tuple[Regression, ...]  # the regression of each output
    record: Record
    units: np.ndarray  # shape (outputs, inputs): units of P, by which each fit is multiplied
    apart: float = 0.0  # relative to P: by how much records contradict one linear plant
    findings: tuple[str, ...] = ()
    lines: Measured | None = None  # P at the lines of an excitation, with no model between them
    linear: bool = True  # whether the lines show nothing that is not linear

    @property
    def loop(self) -> Loop:
        """The loop whose response is estimated.

        If the record names no loop, this is a ClosedLoop without P.
        """
        return self.record.loop

    @property
    def names(self) -> tuple[list[str], list[str]]:
        """The names of the inputs and of the outputs."""
        return self.record.inputs, self.loop.outputs

    @cached_property
    def response(self) -> np.ndarray:
        """The estimate at `omega`, shape (n, outputs, inputs), complex."""
        rows = [fit.response(self.omega * self.loop.Ts) for fit in self.fits]
        return self.units * np.stack(rows, axis=1)

    @cached_property
    def known(self) -> np.ndarray:
        """Mask of the frequencies at which P is identified, shape (n,).

        P is identified where the 95 % radius is below P.
        """
        return self.radius() < largest_singular_values(self.response)

    @cached_property
    def resolved(self) -> np.ndarray:
        """Mask of the frequencies at which a design may begin, shape (n,).

        P must be identified there, and one period of the frequency must fit into a record.

        A record of T seconds distinguishes frequencies that are 2 pi / T apart, like the
        frequencies of its discrete Fourier transform. Below 2 pi / T the record cannot distinguish
        a slow motion from an offset or a drift, and the prior decides. If P is identified only
        below 2 pi / T, a design may begin there.
        """
        fits = self.omega >= self._lowest
        return self.known & fits if np.any(self.known & fits) else self.known

    @property
    def _lowest(self):
        """The lowest frequency (rad/s) of which one period fits into the longest trial.

        This frequency is 2 pi / T, where T is the duration of that trial.
        """
        return 2 * np.pi / (self.record.longest * self.loop.Ts)

    def _unsettled(self):
        """Yield a sentence on each output that may not settle.

        If an output certainly does not settle, a LogError is raised.
        """
        shares = UNSTABLE * np.sqrt(self._moments.shares[:, 0].max(axis=1))
        outputs, lowest = self.loop.outputs, self._lowest
        for name, fit, share, rises in zip(outputs, self.fits, shares, self._rises(), strict=True):
            if not fit.stable and (share < 1 or not self.known.any()):
                grows = fit.grows_at / self.loop.Ts
                where = f"at about {grows:.2g} rad/s"
                if grows < lowest:
                    where = (
                        f"more slowly than at {lowest:.2g} rad/s, the lowest frequency "
                        "that the record resolves"
                    )
                raise LogError(f"{name} does not settle, but grows {where}: {LOOP}")
            if not fit.stable or share >= 1:
                yield f"{name} may not settle, or a periodic disturbance acts on it: {LOOP}"
            elif rises and not self.apart:
                yield (
                    f"{name} may not settle, because P rises like an integrator down to "
                    f"{lowest:.2g} rad/s, the lowest frequency that the record resolves: "
                    f"{LOOP}"
                )

    def _rises(self):
        """Whether P to each output rises like an integrator, and is uncertain at low frequency."""
        lowest = replace(self, omega=self._lowest * np.array([1.0, 2.0]))
        one, two = np.linalg.norm(lowest.response, axis=2)
        at_rest = largest_singular_values(self.response[:1]) < SURE_OF_REST * self.radius()[0]
        return at_rest & (one > RISE * two)

    @cached_property
    def _moments(self):
        """The moments of the errors of all outputs."""
        trace, root, shares = 0.0, 0.0, []
        for fit, units in zip(self.fits, self.units, strict=True):
            S, share = fit.covariance(self.omega * self.loop.Ts)
            S = S * np.outer(np.tile(units, 2), np.tile(units, 2))
            trace = trace + np.trace(S, axis1=1, axis2=2)
            root = root + np.linalg.norm(S, axis=(1, 2))
            shares.append(share)
        return Moments(trace, root, np.array(shares))

    def _radius(self, confidence, jointly):
        c, p = (JOINT, (1 - confidence) / INDEPENDENT) if jointly else (FACTOR, 1 - confidence)
        return c * quantile(self._moments, p) + self.apart * largest_singular_values(self.response)

    def _anywhere(self, omega, confidence):
        there = replace(self, omega=omega)
        return there.response, there.radius(confidence, jointly=True)

    def _scaled(self, of_P):
        return replace(self, units=self.units * of_P)

    def model(self) -> control.StateSpace:
        """Compute a state-space model near P, of the lowest order that is sufficient.

        A model is near P if its error is within the joint 99 % radius. At frequencies of which a
        period fits into a record, the error must also be within a tenth of the largest P. The model
        is therefore near the estimate even if the record contains little information.

        The model is balanced, by the Hankel matrix of the impulse response (S. Kung, 12th Asilomar
        Conference (1978) 705-714). A delay of P adds states to the model. If no order is
        sufficient, a LogError is raised.
        """
        radius, (inputs, outputs) = self.radius(CONFIDENCE, jointly=True), self.names
        fits = self.omega >= self._lowest  # below, a record cannot show what P is
        most = MODEL_NEAR * largest_singular_values(self.response[fits]).max()
        radius[fits] = np.minimum(radius[fits], most)
        rows = min(HANKEL_ROWS, self.record.longest - 1)
        impulses = [fit.impulse(2 * rows + 1)[: len(inputs)] for fit in self.fits]
        full, S = control.eigensys_realization(self.units[..., None] * impulses, rows, rows, rows)

        def of_order(n):
            parts = full.A[:n, :n], full.B[:n], full.C[:, :n], full.D
            return control.ss(*parts, self.loop.Ts, inputs=inputs, outputs=outputs)

        def within(n):
            off = frequency_response(of_order(n), self.omega) - self.response
            return np.all(largest_singular_values(off) <= radius)

        orders = range(1 + np.count_nonzero(S[:rows] > ROUNDING_OF_HANKEL * S[0]))
        n = bisect_left(orders, True, key=within)
        if n < len(orders):
            return of_order(n)
        raise LogError(
            f"no model of up to {n - 1} states is near enough to P: take its frequency "
            "response, by frd(), or move the input less at high frequencies"
        )

    def check(self, log: xr.Dataset) -> Agreement:
        """Check whether another record contradicts the estimate, and by how much.

        Parameters
        ----------
        log : xarray.Dataset
            A record of the same plant, from the same input, that was not used for the estimate.

        Returns
        -------
        Agreement
            The result, with ``contradicts`` and ``by``.
        """
        other = estimated_response([log], self.record.source)
        check_match(P=self.loop, log=other.loop)
        P, radius = self.on(other.omega, CONFIDENCE)
        apart = largest_singular_values(P - other.response)
        likely = apart / np.hypot(radius, other.radius(CONFIDENCE, jointly=True))
        worst = np.argmax(likely)
        contradicts, by = bool(likely[worst] > 1), apart[worst] / largest_singular_values(P)[worst]
        return Agreement(contradicts, float(contradicts * by))

    def _resonances(self):
        """State at which frequencies the regressions have resonant parts, for the assumptions."""
        found = np.concatenate([fit.data.layout.resonances for fit in self.fits])
        words = dict.fromkeys(f"{omega:.3g}" for omega in np.sort(found / self.loop.Ts))
        return f", and with resonant parts at {', '.join(words)} rad/s" if words else ""

    def _basis(self, omega, confidence):
        lines = [
            f"P is estimated from {self.record}; the true P is within the radius with "
            f"confidence {confidence:g}",
            Assumed(
                "the plant is linear and constant, and A(z) y = B(z) u describes it, with "
                f"{self.fits[0].data.layout.lags} past samples in A and, after a delay, in B, "
                f"and with two slow parts{self._resonances()}"
            ),
        ]
        if not self.known.all():
            low, high = self.omega[self.known][[0, -1]]
            lines.append(
                f"P is identified from {low:.3g} to {high:.3g} rad/s, at "
                f"{self.known.mean():.0%} of the frequencies; elsewhere the input had too "
                "little power, and the radius follows from the assumptions"
            )
        if self.lines is not None and omega[0] < (lowest := self.lines.omega[0]):
            below = (
                f"below {lowest:.4g} rad/s, the lowest excited frequency, P is extrapolated by "
                "the regression: an excitation with a lower `lowest` would measure P there"
            )
            lines.append(Assumed(below))
        if not self.linear:
            lines.append(Assumed(SMALLER))
        first = self.omega[self.resolved][0]
        if self.omega[self.known][0] < first <= omega[0] * (1 + SAME_FREQUENCY):
            below = (
                f"below {first:.3g} rad/s, where no period fits into a record, the cut-off and "
                "the filter need no knowledge of P"
            )
            lines.append(Assumed(below))
        return lines

    def __repr__(self):
        radius = self.radius()[self.known]
        within = f"the radius is {radius.min():.2g} to {radius.max():.2g} (95 %, at each frequency)"
        lines = [super().__repr__(), within]
        if self.lines is not None:
            lines.append(self.lines.deviations + ("" if self.linear else self.lines.advice))
        return "\n".join(lines)


@on_one_thread
def estimated_response(
    logs: Sequence[xr.Dataset], of: str | None = None, delay=None
) -> EstimatedResponse:
    """Estimate a frequency response from records.

    The arguments are those of :func:`ilctools.measured_response`.
    """
    record = Record.of(logs, of, delay)
    units = record.sizes.outputs[:, None] / record.sizes.inputs
    noted = record.source == "w" or all("reference" in log for log in logs)
    fits, contradictory, apart = [], [], 0.0
    for i, (name, gain) in enumerate(
        zip(record.loop.outputs, _at_rest(record, units), strict=True)
    ):
        groups = [replace(group, y=group.y[..., [i]]) for group in record.groups]
        fits.append(regression(groups, record.direct, record.delay, gain))
        found = sorted(contradictions(fits[i], groups, noted), key=lambda one: -one.by)
        apart = max([apart, *(one.by for one in found)])  # also what is too small to report
        if said := [one for one in found if one.by > SEEN]:
            contradictory.append(_in_words(name, said))
    nyquist = np.pi / record.loop.Ts
    omega = np.geomspace(nyquist / (2 * record.longest), nyquist, STATED_FREQUENCIES)
    estimate = EstimatedResponse(omega, tuple(fits), record, units, apart)
    findings = (*estimate._unsettled(), *contradictory)
    if not estimate.known.any():
        known = f", or as {', '.join(record.disturbances)} did" if record.disturbances else ""
        raise LogError(
            "; ".join(contradictory)
            or (
                "P is identified at no frequency, because the response to "
                f"{', '.join(record.inputs)} is below the noise, or because they moved "
                f"alike{known}: record for longer, or move the inputs more, each of them "
                "independently"
            )
        )
    return replace(estimate, findings=findings)


def quantile(moments: Moments, p: float) -> np.ndarray:
    """Compute by (2) the value that ||dP|| / |1 + a| exceeds with the probability p, shape (n,)."""
    shape = moments.trace**2 / (2 * moments.root**2)
    x = gammainccinv(shape, p)  # ||dP||^2 in units of trace / shape
    sigma2 = np.maximum(moments.shares.sum(axis=1).max(axis=0), 1e-8)  # below which t is x
    w = wrightomega(1 / sigma2 - x - np.log(sigma2))  # 1 / (1 + t sigma2) = w sigma2, (2)
    t = (1 - w * sigma2) / (w * sigma2**2)
    return np.sqrt(t * moments.trace / shape)


def _at_rest(record, units):
    """Return P(0) of each output if it is known, because the loop's observer integrates.

    P(0) is in the given units. For each output, the result is empty if P(0) is not known.
    """
    if record.source == "w" and isinstance(record.loop, CurrentTrialLoop):
        return np.eye(len(units)) / units
    return [()] * len(units)


def _in_words(name, said):
    """State the contradictions of one output as a finding, the largest first."""
    words = "; ".join(f"{one.words} (by {one.by:.0%} of P)" for one in said[:WORDS_AT_MOST])
    return (
        f"{name} does not respond as in one linear plant: {words}. The radius is larger for "
        "this reason: leave these trials or times out, by isel, or move the input less"
    )
