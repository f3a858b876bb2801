"""Estimate P of an excited rig by the robust method, with a radius of error.

At a line, which is an excited frequency, Y_rp is the spectrum of the outputs in period p of
realisation r of the phases, (output, experiment). W_r is the spectrum of the inputs, (input,
experiment). There are m experiments, and R realisations of N periods. Then

    G_rp = Y_rp W_r^-1,    G_r = mean of G_rp over p,    P = mean of G_r over r,                (1)
    noise^2 = sum_rp ||G_rp - G_r||^2 / (R^2 N (N - 1)),                                        (2)
    error^2 = sum_r ||G_r - P||^2 / (R (R - 1))                                                 (3)

All norms are Frobenius norms. Periods differ by noise alone. Realisations also differ because a
nonlinear loop responds differently to other phases (R. Pintelon and J. Schoukens, System
Identification, 2012, section 4.3.1). P is the best linear approximation, which does not depend on
the phases.

*Known disturbances* of the log are not used. Their effect counts as noise if it differs between
periods. The effect counts as not linear if it differs between realisations only. The radius
contains the noise and the nonlinear part. The regression of :mod:`.estimation` (``of="w"``) takes
known disturbances as inputs.

*Variance.* The estimates (2) and (3) scatter like numbers with a gamma distribution. Their
logarithms are smoothed over the logarithm of the frequency, by straight lines through the nearest
excited frequencies. (2) is smoothed directly. (3) is divided by the sum of (2) and a share of
||P||^2 before it is smoothed. The smoothed (3) may therefore have the same resonances as P. If
noise would cause the variance at a line in only one of 10,000 cases, a disturbance such as mains
hum is taken to act at this line. The line then keeps its own variance.

*Radius.* Let Delta be the error of P, and let d be the number of independent entries of Delta. In
the Frobenius norm, ||Delta||^2 / error^2 has an F distribution with 2 d and 2 f degrees of freedom.
The Frobenius norm is no less than the largest singular value. The trace of the covariance of the
entries, and the trace of its square, determine d (F. E. Satterthwaite, Biometrics Bulletin 2 (1946)
110-114). The scatter of the smoothed variance determines f.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import fdtri, polygamma, psi

from ilctools.law.limits import commands_beyond
from ilctools.loop.closed import CurrentTrialLoop, Loop
from ilctools.measurement.excitation import Excitation
from ilctools.response.measured import Measured
from ilctools.response.samples import Assumed, Samples

# NEIGHBOURING_LINES, divided by the number of realisations after the first one, is the number of
# neighbouring lines with which the variance at a line is smoothed. With fewer lines radii are
# larger. With more lines, the variance is not a straight line over the frequency, and distortion is
# similar at neighbouring lines.
MOSTLY = 3.0  # ratio of distortion to noise above which another amplitude is advised
NEIGHBOURING_LINES = 8


@dataclass(frozen=True, repr=False)
class ExcitedResponse(Measured):
    """The measured best linear approximation from w to y, and how wrong it may be."""

    omega: np.ndarray  # rad/s, shape (n,)
    periods: np.ndarray  # G_rp, shape (realisation, period, n, m, m), complex
    loop: Loop  # whose controller ran; if its observer integrates, P(0) = I
    # what speaks against the measurement, and what follows from that
    findings: tuple[str, ...] = ()

    @cached_property
    def realisations(self) -> np.ndarray:
        """The response to each realisation of the phases, shape (realisation, n, m, m)."""
        return self.periods.mean(axis=1)  # G_r, (1)

    @cached_property
    def response(self) -> np.ndarray:
        """The mean of the responses over all realisations, shape (n, m, m)."""
        return self.realisations.mean(axis=0)  # P, (1)

    @cached_property
    def noise(self) -> np.ndarray:
        """Standard deviation of P by noise alone, shape (n,), in the Frobenius norm."""
        R, N = self.periods.shape[:2]
        off = self.periods - self.realisations[:, None]
        variance = self._variance(off, R**2 * N * (N - 1))  # (2)
        return np.sqrt(self._smoothed(off, variance, R * (N - 1))[0])

    @property
    def error(self) -> np.ndarray:
        """Standard deviation of P by noise and by nonlinearity, shape (n,)."""
        return np.sqrt(self._error[0])

    @property
    def distortion(self) -> np.ndarray:
        """Standard deviation of P by nonlinearity, drift or late settling, shape (n,).

        Late settling means that a transient had not decayed after the first period.
        """
        return np.sqrt(np.maximum(self.error**2 - self.noise**2, 0))

    def _variance(self, off, count):
        """Compute the variance of errors at each line, shape (n,).

        The result is not below the variance of rounding errors.
        """
        return np.maximum(_squares(off) / count, 1e-24 * _squares(self.response) + 1e-300)

    @cached_property
    def _error(self):
        """The square of `error`, and the numbers d and f.

        The radius has 2 d and 2 f degrees of freedom.
        """
        off, R, noise = self.realisations - self.response, len(self.periods), self.noise**2
        both, size = self._variance(off, R * (R - 1)), _squares(self.response)  # (3)
        shape = noise + max(np.sum(both - noise), 0) / size.sum() * size
        return self._smoothed(off, both, R - 1, shape)

    def _smoothed(self, off, variance, freedom, shape=1.0):
        """Smooth the variance of errors; return the smooth variance, d and f.

        The errors have the shape (..., n, p, m). The variance, d and f have the shape (n,).
        `freedom` is the number of degrees of freedom of each line. The ratio of the variance to a
        `shape` is smoothed.
        """
        weights = self._straight()
        mean = np.exp(weights @ np.log(variance / shape)) * shape
        left, _, right = np.linalg.svd(self.response, full_matrices=False)
        turn = (left @ right).conj().swapaxes(1, 2)  # errors turn from line to line like P
        # on the side with fewer channels: what is left out there makes the radius larger
        turned = turn @ off if left.shape[1] >= right.shape[2] else off @ turn
        d = _directions(turned / np.sqrt(mean)[:, None, None], (weights != 0) * 1.0, freedom)
        a = freedom * d  # the shape of the gamma distribution of the variance
        f = 1 / (polygamma(1, a) * np.sum(weights**2, axis=1)) + 0.5
        mean = mean * a / np.exp(psi(a))
        alone = variance > mean * fdtri(2 * a, 2 * f, 0.9999)  # a disturbance of this line only
        return np.where(alone, variance, mean), d, np.where(alone, a, f)

    def _straight(self):
        """Compute the weights with which a straight line is fitted to the nearest frequencies.

        The weights have the shape (n, n).
        """
        x, n = np.log(self.omega), len(self.omega)
        count = max(3, 1 + NEIGHBOURING_LINES // (len(self.periods) - 1))
        weights = np.zeros((n, n))
        for k in range(n):
            first = np.clip(k - count // 2, 0, max(n - count, 0))
            near = slice(first, first + count)
            weights[k, near] = np.linalg.pinv(np.vander(x[near] - x[k], 2))[1]
        return weights

    def _radius(self, confidence, jointly):
        miss = 1 - (confidence ** (1 / len(self.omega)) if jointly else confidence)
        square, d, f = self._error
        return np.sqrt(square * fdtri(2 * d, 2 * f, 1 - miss))

    def _samples(self, confidence):
        """Return samples of P at positive and negative frequencies.

        If P(0) = I is known, a sample I at the frequency zero is included.
        """
        radius = self.radius(confidence, jointly=True)
        rest = np.eye(*self.response.shape[1:])[None, :][: self.anchored]
        return Samples(
            np.concatenate([-self.omega[::-1], [0.0] * self.anchored, self.omega]),
            np.concatenate([self.response[::-1].conj(), rest, self.response]),
            np.concatenate([radius[::-1], [0.0] * self.anchored, radius]),
        )

    @property
    def lines(self) -> "ExcitedResponse":
        """P at the lines, which is this object itself."""
        return self

    @property
    def anchored(self) -> bool:
        """Whether P(0) = I is known, because the loop's observer integrates."""
        return isinstance(self.loop, CurrentTrialLoop)

    def _scaled(self, of_P):
        return replace(self, periods=self.periods * of_P)

    def _basis(self, omega, confidence):
        low, high = self.omega[[0, -1]]
        return (
            f"P is measured at {len(self.omega)} frequencies from {low:.4g} to {high:.4g} "
            "rad/s; at all of them, the true P is within the radius with confidence "
            f"{confidence:g}",
            *self._between(omega, confidence),
            *[Assumed("P(0) is the identity, because the loop integrates")] * self.anchored,
        )

    def __repr__(self):
        radius = self.radius()
        lines = [
            f"P at {len(self.omega)} frequencies from {self.omega[0]:.3g} to "
            f"{self.omega[-1]:.3g} rad/s{', and P(0) = I' if self.anchored else ''}",
            f"the radius is {radius.min():.2g} to {radius.max():.2g} (95 %, at each frequency)",
            self.deviations + self.advice,
        ]
        return "\n".join([*lines, *self.findings])

    @property
    def deviations(self) -> str:
        """A sentence on the standard deviations of P by noise and by nonlinearity."""
        return (
            f"the standard deviation is up to {self.noise.max():.2g} by noise, and up to "
            f"{self.distortion.max():.2g} by nonlinearity or drift"
        )

    @property
    def advice(self) -> str:
        """Advice on what would make P more certain, if noise is not the main cause."""
        curved = self.distortion.max() > MOSTLY * self.noise.max()
        return ": a smaller amplitude may help more than a longer record" if curved else ""


def _squares(off):
    """Compute the sum of the squares of errors at each line.

    The errors have the shape (..., n, m, m), and the result has the shape (n,).
    """
    return np.sum(np.abs(off.reshape(-1, *off.shape[-3:])) ** 2, axis=(0, 2, 3))


def _directions(off, near, freedom):
    """Count the independent entries of errors of the shape (..., n, m, m).

    An independent real number counts as 1/2.
    """
    parts = np.stack([off.real, off.imag], axis=-1).reshape(-1, len(near), 2 * off.shape[-1] ** 2)
    C = np.tensordot(near, np.einsum("rki,rkj->kij", parts, parts), 1)
    square, squares = np.trace(C, axis1=1, axis2=2) ** 2, np.linalg.norm(C, axis=(1, 2)) ** 2
    nu = freedom * near.sum(axis=1)  # a small number by itself makes both traces larger
    below = (squares - square / nu) / (1 + 2 / nu) / np.maximum(1 - 1 / nu, 1e-9)
    above = square - 2 * below / nu
    return float(np.clip(above.sum() / max(below.sum(), 1e-300), 1, parts.shape[-1])) / 2


def excited_response(w, y, asked, limits, excitation: Excitation, loop: Loop) -> ExcitedResponse:
    """Compute P from the signals of all evaluated periods.

    The signals have the shape (experiment, time, channel).
    """
    W, Y = excitation.spectra(w), excitation.spectra(y)
    findings = ()
    if beyond := commands_beyond(asked, loop.commands, limits):
        findings = (
            f"{beyond}: the measured response is not the response of the loop, and the radius "
            "does not cover the difference. Shake the loop with a smaller amplitude",
        )
    return ExcitedResponse(excitation.omega, Y @ np.linalg.inv(W), loop, findings)  # (1)
