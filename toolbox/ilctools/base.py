"""The base B of a learning filter L = B K, where K is short: the inverse of P, as far as it goes.

    B = (P* P + b^2)^-1 P*                                                                     (B)

is the operator of norm-optimal learning, see :class:`.alternatives.NormOptimal`. It undoes poles
and zeros of P next to the unit circle, for which a finite filter would have to be as long as they
ring. In each direction in which P has the singular value sigma,

    sigma(B) = sigma / (sigma^2 + b^2) <= 1 / (2 b),    1 - P B = b^2 / (sigma^2 + b^2) < 1,

so that b = 1 / (2 L_max) keeps the bound on L = B for every plant, and Q (I - P B) is below one.
P B is nearly the identity where the gain of P is above b, so that a short K, designed for P B in
the place of P, does the rest; M = Q (I - P B K) is affine in K as it is in L.

Of several plants P_k it is the law that minimises the mean of ||e - P_k change||^2:

    B = (mean P_k* P_k + b^2)^-1 mean P_k* = (P* P + b^2)^-1 P* E,

with P for the P_k one below the other, divided by sqrt(p), and E for p identities, divided so, too.
The bound on B holds for them as well, since the gain of E is one.

By the factors of linear-quadratic control, with F* F = P* P + b^2 and F causal, as its inverse,

    B = J H* E,    J = F^-1,    H = P F^-1,    H* H + b^2 J* J = I,

where J and H are what the reference of a state feedback does to u and to y. So B has the poles of
that closed loop, inside the circle and mirrored at it, and none else.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import control
import numpy as np
from scipy.fft import irfft, rfft
from scipy.linalg import block_diag, solve_discrete_are

from ilctools import arguments
from ilctools.alternatives import NormOptimal
from ilctools.filters import LearningFilter
from ilctools.models import frequency_response, minimal_realisation, sampled_plant
from ilctools.singular_values import largest_singular_values

NEGLIGIBLE = 1e-4  # change of sigma_max(M) for which B is truncated
POINTS = 2**15  # of the transform that gives the impulse response of B
FARTHEST = POINTS // 4  # samples that B reaches at most, each way
EXACT = 1e-7  # relative error of the factors that is rounding


@dataclass(frozen=True, eq=False)
class RegularisedInverse:
    """B = (P* P + b^2)^-1 P* E of models, with the ends of a trial.

    On N samples it is (P_N^T P_N + b^2 I)^-1 P_N^T E, of the channels divided by `scale`, if that
    is given: P is in these units, B is not. P has m inputs, and m outputs for each model.
    """

    P: control.StateSpace
    b: float
    scale: np.ndarray

    def __post_init__(self):
        P = sampled_plant(self.P, "P")
        arguments.stable("P", P.poles())
        scale = arguments.array("scale", self.scale, (P.ninputs,))
        vars(self).update(P=P, b=arguments.positive("b", self.b), scale=scale)

    def __eq__(self, other):
        return isinstance(other, RegularisedInverse) and self._values == other._values

    def __hash__(self):
        return hash(self._values)

    @property
    def _values(self):
        """All that it is, to be compared."""
        arrays = self.P.A, self.P.B, self.P.C, self.P.D, self.scale
        return self.b, self.Ts, *(array.tobytes() for array in arrays)

    @property
    def Ts(self) -> float:
        """Sampling period, s."""
        return self.P.dt

    @property
    def channels(self) -> int:
        """Number m of inputs."""
        return self.P.ninputs

    @property
    def E(self) -> np.ndarray:
        """Identities one below the other, an isometry: one for each model."""
        copies = self.P.noutputs // self.channels
        return np.tile(np.eye(self.channels), (copies, 1)) / np.sqrt(copies)

    @cached_property
    def closed(self) -> control.StateSpace:
        """[E* H; J], from the reference of the state feedback to y and u."""
        A, B, C, D = self.P.A, self.P.B, self.P.C, self.P.D
        one = np.eye(self.channels)
        R, S = D.T @ D + self.b**2 * one, C.T @ D
        X = solve_discrete_are(A, B, C.T @ C, R, s=S)
        R = R + B.T @ X @ B
        G = np.linalg.solve(R, B.T @ X @ A + S.T)
        w, V = np.linalg.eigh(R)
        root = (V / np.sqrt(w)) @ V.T  # R^(-1/2)
        C, D = self.E.T @ C, self.E.T @ D
        C, D = np.vstack([C - D @ G, -G]), np.vstack([D, one]) @ root
        return control.ss(A - B @ G, B @ root, C, D, self.P.dt)

    @property
    def poles(self) -> np.ndarray:
        """Those inside the unit circle."""
        return np.linalg.eigvals(self.closed.A)

    def frequency_response(self, omega) -> np.ndarray:
        """B far from the ends of a trial, at `omega` (rad/s), (n, channels, channels), complex."""
        H, J = np.split(frequency_response(self.closed, omega), 2, axis=1)
        return J @ H.conj().swapaxes(1, 2) * (self.scale[:, None] / self.scale)  # (B)

    def apply(self, signal) -> np.ndarray:
        """Filter a signal of shape (..., time, channels)."""
        of_trial = self._on(np.shape(signal)[-2])
        return self.scale * of_trial.apply(signal / self.scale @ self.E.T)

    def apply_transposed(self, signal) -> np.ndarray:
        """Filter a signal by the transpose of the matrix that :meth:`apply` is on a trial."""
        of_trial = self._on(np.shape(signal)[-2])
        return of_trial.apply_transposed(signal * self.scale) @ self.E / self.scale

    def _on(self, samples):
        return _norm_optimal(self, samples)


@lru_cache(maxsize=4)
def _norm_optimal(base, samples):
    """On trials of so many samples: factored once."""
    return NormOptimal(base.P, base.b**2, samples)


def base_of_models(models, b, scale, structure) -> RegularisedInverse | None:
    """B of models in units of `scale`, diagonal if asked for; None if rounding hides it."""
    try:
        if structure == "diagonal":
            models = [
                control.append(
                    *(minimal_realisation(P[i, i], [x]) for i, x in enumerate(P.input_labels))
                )
                for P in models
            ]
        A, C = (block_diag(*(getattr(P, X) for P in models)) for X in "AC")
        B, D = (np.vstack([getattr(P, X) for P in models]) for X in "BD")
        root = np.sqrt(len(models))
        P = control.ss(A, B, C / root, D / root, models[0].dt)
        base = RegularisedInverse(P, b, scale)
        at = np.append(np.abs(np.angle(base.poles)), [0, np.pi]) / P.dt
    except (np.linalg.LinAlgError, ValueError):
        return None
    H, J = np.split(frequency_response(base.closed, at), 2, axis=1)
    response = frequency_response(P, at)
    adjoint = response.conj().swapaxes(1, 2)
    B = J @ H.conj().swapaxes(1, 2)
    off = (adjoint @ response + b**2 * np.eye(len(scale))) @ B - adjoint @ base.E  # (B)
    return base if np.abs(off).max() < EXACT * np.abs(response).max() else None


def in_units(base, scale):
    """A base of the plant's units in units of `scale`."""
    if isinstance(base, RegularisedInverse):
        return RegularisedInverse(base.P, base.b, base.scale / scale)
    units = scale[None, :, None] / scale[:, None, None]
    return LearningFilter(base.coefficients * units, base.Ts, base.ends, base.first)


def base_of_samples(response, lowpass, b, reach, count, structure) -> LearningFilter:
    """B of the first plants, as many as `count`, as a finite filter."""
    Ts, n = response.Ts, POINTS
    omega = np.linspace(0, np.pi / Ts, n // 2 + 1)
    P = np.array([_faded(response, k, lowpass.cutoff, omega) for k in range(count)])
    if structure == "diagonal":
        P = P * np.eye(P.shape[-1])
    B = quadratic_law(P, b)
    taps = np.roll(irfft(B, n, axis=0), n // 2, axis=0)  # lag p at n / 2 + p
    size = np.max([*map(largest_singular_values, P)], axis=0)
    size *= np.abs(lowpass.frequency_response(omega))
    N, most = 1, reach or FARTHEST
    if response.models[0] is None:  # lines that are so far apart show no longer response
        most = min(most, 2 * np.pi / (response.omega[response.omega > 0][0] * Ts))
    most = int(min(most, FARTHEST))
    while most > N:
        middle = np.zeros_like(taps)
        middle[n // 2 - N : n // 2 + N + 1] = taps[n // 2 - N : n // 2 + N + 1]
        lost = rfft(np.roll(taps - middle, n // 2, axis=0), axis=0)
        if (size * largest_singular_values(lost)).max() < NEGLIGIBLE:
            break
        N = min(2 * N, most)
    kept = taps[n // 2 - N : n // 2 + N + 1][::-1]  # from q^-N on
    # what is cut off must not take B above 1 / (2 b), between the points by M. Riesz
    peak = largest_singular_values(rfft(kept, 4 * n, axis=0)).max()
    kept = kept * min(1, np.cos(np.pi * N / (4 * n)) / (2 * b * peak))
    units = response.scale[:, None] / response.scale
    return LearningFilter(np.moveaxis(kept * units, 0, -1), Ts, first=-N)


def quadratic_law(P, b) -> np.ndarray:
    """B, (n, m, m), of plants by their responses, (p, n, m, m)."""
    adjoint = P.conj().swapaxes(2, 3)
    normal = (adjoint @ P).mean(axis=0) + b**2 * np.eye(P.shape[-1])
    return np.linalg.solve(normal, adjoint.mean(axis=0))  # (B)


def _faded(response, number, cutoff, omega):
    """A plant at any frequency; samples are held below them, and faded out beyond Q's cut-off."""
    if (model := response.models[number]) is not None:
        return frequency_response(model, omega)
    first, last = response.omega[[0, -1]]
    P, _ = response.anywhere(number, np.clip(omega, first, last))
    if first > 0:  # P is real at rest
        P.imag *= np.minimum(omega / first, 1)[:, None, None]
    if response.beyond is None:
        return P
    start = min(cutoff, 0.9 * last)
    fading = np.clip((omega - start) / (last - start), 0, 1)
    return P * (np.cos(np.pi / 2 * fading) ** 2)[:, None, None]
