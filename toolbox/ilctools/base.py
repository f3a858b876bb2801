"""The base B of a learning filter L = B K: a regularised inverse of the plant P.

    B = (P* P + b^2)^-1 P*                                                                     (B)

Here P* is the conjugate transpose of the response P, b is a positive number, and K is a finite
filter with few coefficients. B is the operator of norm-optimal learning, see
:class:`.norm_optimal.NormOptimal`. B cancels poles and zeros of P near the unit circle. A finite
filter that cancels them would have to be as long as their responses last. In each direction in
which P has the singular value sigma,

    sigma(B) = sigma / (sigma^2 + b^2) <= 1 / (2 b),    1 - P B = b^2 / (sigma^2 + b^2) < 1.

If b = 1 / (2 L_max), then L = B meets the bound sigma_max(L) <= L_max for every plant, and
sigma_max(Q (I - P B)) is below one, where Q is the low-pass filter of the law. Where the gain of P
is above b, P B is nearly the identity. The filter K is then designed for P B in place of P. The
iteration matrix M = Q (I - P B K) depends on K in the same affine way as Q (I - P L) depends on L.

For p plants P_k, B e is the change of v that minimises ||e - P_k change||^2, averaged over the
plants, plus b^2 ||change||^2:

    B = (mean P_k* P_k + b^2)^-1 mean P_k* = (P* P + b^2)^-1 P* E,

Here P is the stack of all P_k, divided by sqrt(p). E is a stack of p identity matrices, also
divided by sqrt(p). The bound on B holds for several plants as well, because the gain of E is one. P
and E may be multiplied from the left by a matrix with orthonormal rows, if the row space of this
matrix contains the columns of [C, D], the output matrices of P. Then P* P and P* E do not change.
Therefore P needs no more outputs than it has states and inputs together. States that the plants
have in common are kept once, see :mod:`.pooled`.

The poles of B follow from the next equation. There, K is the gain of a linear-quadratic state
feedback, and R is a constant matrix. The A and B inside F are those of the state equation of P:

    P* P + b^2 = F* F,    F = R^(1/2) (I + K (z I - A)^-1 B),    B = F^-1 (P F^-1)* E,

F^-1 and P F^-1 are the responses of the input u and of the output y to the reference of the loop
that this feedback closes. The poles of the base are therefore the poles of this closed loop, which
are inside the unit circle, and their mirror images at the circle. The base has no other poles.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import control
import numpy as np
from scipy.fft import irfft, rfft
from scipy.linalg import block_diag

from ilctools import arguments
from ilctools.filters import WEIGHT_OF_CHANGE, Composition, LearningFilter
from ilctools.models import balanced, frequency_response, minimal_realisation, stable_plant
from ilctools.norm_optimal import NormOptimal, regularised_inverse
from ilctools.pooled import CHANGES, Pooled, isometry, pooled
from ilctools.singular_values import largest_singular_values

NEGLIGIBLE_IN_M = 1e-4  # B is truncated if sigma_max(M) changes by less than this value
POINTS = 2**15  # of the Fourier transform that gives the coefficients of B
FARTHEST_REACH = POINTS // 4  # largest number of samples that B looks ahead or back
EXACT_FACTORS = 1e-7  # a relative error of the factors up to this value is rounding


@dataclass(frozen=True, eq=False)
class RegularisedInverse:
    """The base B = (P* P + b^2)^-1 P* E of one or several models.

    On a trial of N samples, B is the matrix (P_N^T P_N + b^2 I)^-1 P_N^T E, where the matrix P_N
    maps the inputs of a trial to its outputs. P maps inputs divided by `scale` to outputs divided
    by `scale_y`. B itself acts on signals in their own units. If E is None, P is a single model.
    """

    P: control.StateSpace
    b: float
    scale: np.ndarray  # (m,)
    # (outputs of P, p), see :func:`.pooled.pooled`; the identity for one model
    E: np.ndarray | None = None
    scale_y: np.ndarray | None = None  # (p,); default: the scale of the inputs
    weight_of_change = WEIGHT_OF_CHANGE

    def __post_init__(self):
        P = stable_plant(self.P, "P")
        scale = arguments.array("scale", self.scale, (P.ninputs,))
        E = np.eye(P.noutputs) if self.E is None else self.E
        E = arguments.array("E", E, (P.noutputs, "p"))
        scale_y = scale if self.scale_y is None else self.scale_y
        scale_y = arguments.array("scale_y", scale_y, (E.shape[1],))
        b = arguments.positive("b", self.b)
        vars(self).update(P=P, b=b, scale=scale, E=E, scale_y=scale_y)

    @property
    def Ts(self) -> float:
        """Sampling period, s."""
        return self.P.dt

    @property
    def rows(self) -> int:
        """Number m of inputs of P."""
        return self.P.ninputs

    @property
    def columns(self) -> int:
        """Number p of outputs of each plant."""
        return self.E.shape[1]

    @cached_property
    def poles(self) -> np.ndarray:
        """Poles of B inside the unit circle.

        These are the poles of P with linear-quadratic state feedback.
        """
        # with P / b, whose b is one: otherwise the units of y would decide which digits are lost
        P = self.P * (1 / self.b)
        (A, B, C), D = balanced(P), P.D
        R, S = D.T @ D + np.eye(self.rows), C.T @ D
        K, _, poles = control.dlqr(A, B, C.T @ C, R, S)
        factor = control.ss(A, B, K, np.eye(self.rows), self.Ts)  # F, except for a constant
        omega = np.append(np.abs(np.angle(poles)), [0, np.pi]) / self.Ts
        F, P = (frequency_response(model, omega) for model in (factor, P))
        of_normal = np.prod(np.linalg.svd(P, compute_uv=False) ** 2 + 1, axis=1)
        ratio = np.abs(np.linalg.det(F)) ** 2 / of_normal  # F* F = P* P + b^2
        if ratio.max() > ratio.min() * (1 + EXACT_FACTORS):
            raise ValueError(
                f"b = {self.b} is too small for P, because rounding then decides "
                "the poles of B: take a smaller L_max, or a larger base"
            )
        return poles

    def __matmul__(self, K: LearningFilter) -> Composition:
        """Return the composition L = B K."""
        return Composition(self, K)

    def frequency_response(self, omega) -> np.ndarray:
        """Compute the frequency response of B at `omega` (rad/s).

        The result is complex and has the shape (n, m, p). B has this response far from the ends of
        a trial.
        """
        P = frequency_response(self.P, omega)
        return regularised_inverse(P, self.b) @ self.E * (self.scale[:, None] / self.scale_y)  # (B)

    def apply(self, signal) -> np.ndarray:
        """Filter errors of shape (..., time, p) on a trial; the result has shape (..., time, m)."""
        of_trial = _norm_optimal(self, np.shape(signal)[-2])
        return self.scale / self.b * of_trial.apply(signal / self.scale_y @ self.E.T)

    def apply_transposed(self, signal) -> np.ndarray:
        """Apply the transpose of the matrix that represents :meth:`apply` on a trial."""
        of_trial = _norm_optimal(self, np.shape(signal)[-2])
        return of_trial.apply_transposed(signal * self.scale) @ self.E / self.scale_y / self.b


@lru_cache(maxsize=4)
def _norm_optimal(base, samples):
    """Return the norm-optimal law for the plant P / b, with the weight one.

    The law acts on trials with this number of samples.
    """
    return NormOptimal(base.P * (1 / base.b), 1.0, samples)


def quadratic_law(P, b) -> np.ndarray:
    """Compute the frequency response of B from the frequency responses of plants.

    The responses of the plants have the shape (plants, n, p, m). The result has the shape
    (n, m, p).
    """
    E = isometry(len(P), P.shape[-2])
    return regularised_inverse(np.concatenate(P, axis=1) / np.sqrt(len(P)), b) @ E  # (B)


def in_units(L, of_v, of_y):
    """Convert a learning operator of scaled signals to an operator in the signals' own units.

    The operator L maps outputs divided by `of_y` to inputs divided by `of_v`.
    """
    if isinstance(L, Composition):
        # The signals between B and K have the units of the side of K, if their number is the same.
        (last, first), side = L.factors, of_y if L.K_first else of_v
        between = side if len(side) == first.rows else np.ones(first.rows)
        return _composed(L, in_units(last, of_v, between), in_units(first, between, of_y))
    if isinstance(L, RegularisedInverse):
        return replace(L, scale=of_v, scale_y=of_y)
    return replace(L, coefficients=L.coefficients * (of_v[:, None] / of_y)[..., None])


def extended(L, U, V):
    """Return V L U', an operator for the plant P.

    The operator L is made for the plant U' P V, see :mod:`.response.directions`.
    """
    if isinstance(L, Composition):
        last, first = L.factors
        one = np.eye(first.rows)
        return _composed(L, extended(last, one, V), extended(first, U, one))
    if isinstance(L, RegularisedInverse):
        return RegularisedInverse(L.P * V.T, L.b, np.ones(len(V)), L.E @ U.T, np.ones(len(U)))
    return replace(L, coefficients=np.einsum("vi,ijk,yj->vyk", V, L.coefficients, U))


def _composed(L, last, first):
    """Make a composition with other factors.

    The factor `first` acts on the signal first, and the factor `last` acts on the result.
    """
    B, K = (last, first) if L.K_first else (first, last)
    return replace(L, B=B, K=K)


def base_of_models(models, b, structure, most=np.inf) -> RegularisedInverse | None:
    """Make B from models.

    The result is None if B has more than `most` states, or if rounding decides the poles of B.
    """
    try:
        for change in CHANGES:
            P, E = _of_all(models, b, structure, change)
            if P.nstates <= most:
                break
        else:
            return None
        base = RegularisedInverse(P, b, np.ones(P.ninputs), E, np.ones(E.shape[1]))
        return base if len(base.poles) else None  # rounding may decide the poles
    except (np.linalg.LinAlgError, ValueError):
        return None


def _of_all(models, b, structure, change) -> Pooled:
    """Make P and E of the base from all models.

    If B is diagonal, each channel is treated by itself.
    """
    if structure != "diagonal":
        return pooled(models, b, change)
    channels = []
    for i in range(models[0].ninputs):
        # a channel without the effect of other inputs on its output
        alone = [minimal_realisation(P[i, i], [P.input_labels[i]]) for P in models]
        channels.append(pooled(alone, b, change))
    return Pooled(control.append(*(P for P, _ in channels)), block_diag(*(E for _, E in channels)))


def base_of_samples(response, lowpass, b, reach, count, structure) -> LearningFilter:
    """Make B as a finite filter, from the frequency responses of the first `count` plants."""
    omega = np.linspace(0, np.pi / response.Ts, POINTS // 2 + 1)
    P = np.array([_faded(response, k, lowpass.cutoff, omega) for k in range(count)])
    if structure == "diagonal":
        P = P * np.eye(P.shape[-1])
    size = np.max([*map(largest_singular_values, P)], axis=0)
    counts = np.abs(lowpass.frequency_response(omega)) * size
    farthest = reach or FARTHEST_REACH
    if response.models[0] is None:  # the spacing of omega limits the length of B
        first = response.omega[response.omega > 0][0]
        farthest = min(farthest, 2 * np.pi / (first * response.Ts))
    coefficients, N = _shortened(quadratic_law(P, b), counts, int(min(farthest, FARTHEST_REACH)))
    # Truncation must not take B above 1 / (2 b); between the points this holds by M. Riesz.
    peak = largest_singular_values(rfft(coefficients, 4 * POINTS, axis=0)).max()
    coefficients *= min(1, np.cos(np.pi * N / (4 * POINTS)) / (2 * b * peak))
    return LearningFilter(np.moveaxis(coefficients, 0, -1), response.Ts, first=-N)


def _shortened(B, counts, farthest):
    """Truncate B to its coefficients of q^-N ... q^N; return the coefficients and N.

    The coefficients have the shape (2 N + 1, m, p). N is the least power of two for which the
    response of the lost coefficients, multiplied by `counts`, is below NEGLIGIBLE_IN_M at each
    frequency. N is at most `farthest`.
    """
    N, middle, coefficients = 1, POINTS // 2, coefficients_of(B)
    while True:
        N = min(N, farthest)
        kept = slice(middle - N, middle + N + 1)
        lost = coefficients.copy()
        lost[kept] = 0
        missed = counts * largest_singular_values(rfft(lost, axis=0))
        if farthest == N or missed.max() < NEGLIGIBLE_IN_M:
            return coefficients[kept], N
        N *= 2


def coefficients_of(response) -> np.ndarray:
    """Compute a filter's coefficients of q^k for k = -n / 2, ..., n / 2 - 1.

    The coefficients have the shape (n, p, m). `response` is the filter's response at n / 2 + 1
    frequencies, evenly spaced from zero to the Nyquist frequency.
    """
    return np.fft.fftshift(irfft(response.conj(), axis=0), axes=0)


def _faded(response, number, cutoff, omega):
    """Compute the response of a plant at omega.

    If the response was measured, it may be faded out above the cut-off.
    """
    if (model := response.models[number]) is not None:
        return frequency_response(model, omega)
    last = response.omega[-1]
    P, _ = response.anywhere(number, np.minimum(omega, last))
    if response.beyond is None:
        return P
    start = min(cutoff, 0.9 * last)
    fading = np.clip((omega - start) / (last - start), 0, 1)
    return P * (np.cos(np.pi / 2 * fading) ** 2)[:, None, None]
