"""P of one output from signals as they come, and how far off it may be: the estimator.

    A(z) y(t) = B_1(z) u_1(t) + ... + B_m(z) u_m(t) + start(t) + line(t) + drift(t) + e(t)      (1)

The inputs u are those that were commanded, of which P is asked, and then the known disturbances,
which were measured. A known disturbance has a B of its own, which is estimated like the others.
P = B / A, of the commanded inputs. The steps, each in a module of this room:

=============  =====================================================================  ==========
trials         a mean and differences of trials, one by one
unknowns       what is estimated: A, each B with slow parts, starts and drifts        (1)
regressors     X of them, and the products X' X and X' y
prior          variances of the unknowns, by hyperparameters eta                      (2)
posterior      of the unknowns, at one eta                                            (3)
likelihood     of eta, its gradient and its maximum                                   (4)
delay          of each input, where the posterior is larger for it
quadrature     the covariance of the unknowns over eta                                (5)
regression     P, and the covariance of its error                                     (6)
=============  =====================================================================  ==========

*Error of P.* To first order it is normal,

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
from ilctools.measurement.arx.trials import Trials
from ilctools.measurement.arx.unknowns import Kind, coefficients

# Smaller, less of the tail of a response is folded upon its beginning; larger, less rounding.
FOLDED = 1e-10


class ErrorOfP(NamedTuple):
    """What (6) makes of the covariance of the unknowns, at n angles omega Ts."""

    of_P: np.ndarray  # covariance of dP, real parts first, (n, 2 m, 2 m)
    of_A: np.ndarray  # variances of the real and the imaginary part of dA / A, (2, n)


@dataclass(frozen=True)
class Regression:
    """P from m commanded inputs to one output, and the error that it may have."""

    commanded: int  # m: inputs of which P is asked
    mean: np.ndarray  # x, (unknown,)
    data: Data
    posterior: Posterior  # for the likeliest hyperparameters
    C: np.ndarray  # covariance of x, over the points of the quadrature, (unknown, unknown)

    def response(self, omega: np.ndarray) -> np.ndarray:
        """P at angles omega Ts, shape (n, m)."""
        A, layout = self._A(omega), self.data.layout
        B = [
            layout.waves_of_B(j, omega) @ self.mean[layout.where_B(j)]
            for j in range(self.commanded)
        ]
        return np.stack(B, axis=1) / A[:, None]

    def _A(self, omega):
        layout = self.data.layout
        return 1 + layout.waves_of_A(omega) @ self.mean[layout.where(Kind.A)]

    def covariance(self, omega: np.ndarray) -> ErrorOfP:
        """The covariance of (6) at angles omega Ts, (n,)."""
        layout, P, A = self.data.layout, self.response(omega), self._A(omega)[:, None]
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
        """The estimate of A, lag by lag."""
        layout = self.data.layout
        past = coefficients(self.mean[layout.where(Kind.A)], layout.knots_of_A, layout.lags + 1)
        past[0] = 1.0  # A is monic
        return past

    @property
    def stable(self) -> bool:
        """Whether the estimate of A has no zero outside the unit circle, by how often it turns."""
        return bool(abs(self._turns.sum()) < 1)

    @property
    def grows_at(self) -> float:
        """The angle omega Ts about which an estimate of A turns that is not stable."""
        turns = self._turns
        return np.pi * np.argmax(np.sign(turns.sum()) * turns) / len(turns)

    @property
    def _turns(self):
        """By how much A turns from each angle to the next, from zero to pi."""
        a = self.denominator
        A = np.fft.rfft(a, 2 * len(a) + 4096)
        return np.angle(A[1:] / A[:-1])

    def denominator_at(self, omega: np.ndarray) -> np.ndarray:
        """A at angles omega Ts, (n,)."""
        return self._A(omega)

    def numerators(self, n: int) -> np.ndarray:
        """The estimates of B over n lags, (m + d, n): disturbances stand last."""
        layout, poles, B = self.data.layout, self.data.layout.poles, []
        for j, knots in enumerate(layout.knots_of_B):
            B.append(coefficients(self.mean[layout.where(Kind.B, j)], knots, n))
            slow = self.mean[layout.where(Kind.SLOW, j)]
            B[j][1:] += slow * (1 - poles) @ poles[:, None] ** np.arange(n - 1)
        return np.array(B)

    def impulse(self, n: int) -> np.ndarray:
        """Impulse responses over n samples to all inputs, (m + d, n).

        Coefficients of the power series B / A: its values on a circle, transformed back. What
        comes n_fft samples later is folded upon them, with the weight `FOLDED`.
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
        """A y - B u of trials from rest, (trial, time), without start, line and drift of (1)."""
        B = self.numerators(y.shape[1])
        answer = fftconvolve(u, B.T[None], axes=1)[:, : y.shape[1]].sum(axis=2)
        return fftconvolve(y, self.denominator[None], axes=1)[:, : y.shape[1]] - answer


def regression(groups: Sequence[Trials], direct: bool, delays=0, gain=None) -> Regression:
    """Estimate P to one output.

    `direct`: whether y(t) may depend on the commanded inputs at t, or when their delay is over.
    `delays`, (m,): the least delays of the commanded inputs, samples; more are tried where
    correlations show them. `gain`, (m,): P at rest, if it is known.
    """
    commanded = groups[0].commanded
    least = np.zeros(groups[0].u.shape[2], int)  # of a known disturbance nothing is known
    least[:commanded] = delays
    best, S = polished(with_delays(groups, direct, least, gain))
    at = posterior(best.eta, best.data)
    return Regression(commanded, at.mean, best.data, at, covariance(best.eta, S, best.data))
