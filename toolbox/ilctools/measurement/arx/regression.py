"""Estimate P to one output from any signals, and how wrong the estimate may be.

    A(z) y(t) = B_1(z) u_1(t) + ... + B_m(z) u_m(t) + start(t) + line(t) + drift(t) + e(t)      (1)

The inputs u are the commanded inputs, followed by the known disturbances, which were measured. A
known disturbance has a B of its own, which is estimated like every other B. The terms start, line
and drift are explained in `unknowns`, and e is white noise. The response to the commanded inputs is
P = B / A. Each step has a module in this folder:

=============  =====================================================================  ==========
trials         the mean of trials and their differences, one by one
unknowns       what is estimated: A, each B with its parts, starts and drifts         (1)
parts          slow parts and resonant parts of each B                                (7)
regressors     the columns X of the unknowns, and the products X' X and X' y
prior          variances of the unknowns, by hyperparameters eta                      (2)
posterior      mean and covariance of the unknowns, at one eta                        (3)
likelihood     the likelihood of eta, its gradient and its maximum                    (4)
delay          the delay of each input, chosen by the posterior
resonances     resonances that the residual shows
quadrature     the covariance of the unknowns over eta                                (5)
regression     P, and the covariance of its error                                     (6)
=============  =====================================================================  ==========

*Error of P.* To first order, the error of P is normally distributed,

    dP_j = (dB_j - P_j dA) / A.                                                                 (6)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.fft import next_fast_len
from scipy.signal import fftconvolve

from ilctools.measurement.arx.delay import with_delays
from ilctools.measurement.arx.likelihood import polished
from ilctools.measurement.arx.posterior import Posterior, posterior
from ilctools.measurement.arx.quadrature import covariance
from ilctools.measurement.arx.regressors import Data
from ilctools.measurement.arx.resonances import with_resonances
from ilctools.measurement.arx.trials import Trials
from ilctools.measurement.arx.unknowns import Kind, coefficients

# With a smaller value, less of a response's tail is folded upon its beginning. With a larger value,
# there is less rounding.
FOLDED = 1e-10


class ErrorOfP(NamedTuple):
    """Covariances of the errors of P and of A at n angles omega Ts, by (6)."""

    of_P: np.ndarray  # covariance of dP, real parts first, (n, 2 m, 2 m)
    of_A: np.ndarray  # variances of the real and the imaginary part of dA / A, (2, n)


@dataclass(frozen=True)
class Regression:
    """The estimate of P from m commanded inputs to one output, and its possible error."""

    commanded: int  # m, the number of commanded inputs
    mean: np.ndarray  # x, (unknown,)
    data: Data
    posterior: Posterior  # for the likeliest hyperparameters
    C: np.ndarray  # covariance of x, over the points of the quadrature, (unknown, unknown)

    def response(self, omega: np.ndarray) -> np.ndarray:
        """Compute P at n angles omega Ts; the result has the shape (n, m)."""
        layout = self.data.layout
        B = [
            layout.waves_of_B(j, omega) @ self.mean[layout.where_B(j)]
            for j in range(self.commanded)
        ]
        return np.stack(B, axis=1) / self.denominator_at(omega)[:, None]

    def denominator_at(self, omega: np.ndarray) -> np.ndarray:
        """Compute A at n angles omega Ts."""
        layout = self.data.layout
        return 1 + layout.waves_of_A(omega) @ self.mean[layout.where(Kind.A)]

    def covariance(self, omega: np.ndarray) -> ErrorOfP:
        """Compute the covariance of dP, see (6), at n angles omega Ts."""
        layout, P = self.data.layout, self.response(omega)
        A = self.denominator_at(omega)[:, None]
        of_A = np.zeros((len(omega), layout.size), complex)  # dA / A by each unknown
        of_A[:, layout.where(Kind.A)] = layout.waves_of_A(omega) / A
        of_P = []  # dP_j by each unknown, input by input
        for j in range(self.commanded):
            slopes = -P[:, [j]] * of_A  # (6)
            slopes[:, layout.where_B(j)] = layout.waves_of_B(j, omega) / A
            of_P.append(slopes)
        both = np.stack([*np.real(of_P), *np.imag(of_P)], axis=1)
        parts = np.stack([of_A.real, of_A.imag])
        return ErrorOfP(
            of_P=both @ self.C @ both.swapaxes(1, 2), of_A=np.sum(parts @ self.C * parts, axis=2)
        )

    @property
    def denominator(self) -> np.ndarray:
        """The coefficients of the estimate of A, from lag 0 on."""
        return self.data.layout.denominator(self.mean)

    @property
    def stable(self) -> bool:
        """Whether the estimate of A has no zero outside the unit circle.

        The zeros are counted by the winding number of A.
        """
        return bool(abs(self._turns.sum()) < 1)

    @property
    def grows_at(self) -> float:
        """The angle omega Ts at which the phase of A turns most, if the estimate is unstable."""
        turns = self._turns
        return np.pi * np.argmax(np.sign(turns.sum()) * turns) / len(turns)

    @property
    def _turns(self):
        """The phase change of A between neighbouring angles, on a grid from zero to pi."""
        a = self.denominator
        A = np.fft.rfft(a, 2 * len(a) + 4096)
        return np.angle(A[1:] / A[:-1])

    def numerators(self, n: int) -> np.ndarray:
        """Compute the estimates of B over n lags; the result has the shape (m + d, n).

        The m commanded inputs stand first, and the d known disturbances stand last.
        """
        layout, B = self.data.layout, []
        for j, knots in enumerate(layout.knots_of_B):
            B.append(coefficients(self.mean[layout.where(Kind.B, j)], knots, n))
            B[j][1:] += self.mean[layout.where(Kind.PART, j)] @ layout.parts.impulses(n - 1)
        return np.array(B)

    def impulse(self, n: int) -> np.ndarray:
        """Compute the impulse responses to all inputs over n samples.

        The result has the shape (m + d, n). Impulse responses are the coefficients of the power
        series B / A, transformed back from values of the series on a circle. The transform adds
        each coefficient to the coefficient n_fft samples earlier, with the weight `FOLDED`.
        """
        longest = max(n, self.data.layout.lags + 1)
        n_fft = next_fast_len(4 * longest)
        circle = FOLDED ** (np.arange(longest) / n_fft)
        B = self.numerators(n)
        at_rest = np.cumsum(B != 0, axis=1) == 0  # until the delay is over
        A = np.fft.rfft(self.denominator * circle[: self.data.layout.lags + 1], n_fft)
        answers = np.fft.irfft(np.fft.rfft(B * circle[:n], n_fft) / A, n_fft)[:, :n] / circle[:n]
        return np.where(at_rest, 0.0, answers)

    def residual(self, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Compute A y - B u of trials that begin at rest.

        The result has the shape (trial, time). The start, the line and the drift of (1) are not
        subtracted.
        """
        B = self.numerators(y.shape[1])
        answer = fftconvolve(u, B.T[None], axes=1)[:, : y.shape[1]].sum(axis=2)
        return fftconvolve(y, self.denominator[None], axes=1)[:, : y.shape[1]] - answer


def regression(groups: Sequence[Trials], direct: bool, delays=0, gain=()) -> Regression:
    """Estimate P from all commanded inputs to one output.

    `direct` says whether y(t) may depend on the commanded inputs at the same time t, or at t minus
    their delay, and not only on earlier inputs. `delays` are the least delays of the commanded
    inputs in samples, (m,). Larger delays are tried if correlations show them. Resonant parts are
    added if the residual shows them. `gain` is P at zero
    frequency, (m,), or empty if this is not known.
    """
    commanded = groups[0].commanded
    least = np.zeros(groups[0].u.shape[2], int)  # no delay of a known disturbance is known
    least[:commanded] = delays
    fit = with_delays(groups, direct, least, gain)
    best, S = polished(with_resonances(fit, groups, direct, gain))
    at = posterior(best.eta, best.data)
    return Regression(commanded, at.mean, best.data, at, covariance(best.eta, S, best.data))
