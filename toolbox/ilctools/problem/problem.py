"""The design problem of the learning filter: (39), (45), (46) of the paper as one checked object.

:func:`.pose.pose` makes and checks a problem. The solver and the certificate use the same object.
Frequency responses have the frequency as their first dimension. The channels of P, L and M are in
units of `scale`, see :mod:`ilctools.response.scale`, so that equally important signals are equally
large.

P has p outputs and m learned inputs. M maps the error e, or the ILC signal v, from one trial
to the next. M is taken for the signal with fewer channels, for which M can be a contraction:

    M = Q (I - P L)   of the error, if m >= p,    M = Q (I - L P)   of v, if m < p.

The second M is the transpose of the first M for P^T and L^T. The solver therefore always bounds a
matrix G = F + T K with a square K. If m >= p, L = B K with the base B, and G contains P B K. If m <
p, L = K B, and G contains P^T B^T K^T. A response that is transposed if m < p is called *turned*
here.

M is affine in P. A bound on M for several plants, or for all plants within a radius, is therefore
as convex as a bound for one plant. The aim is *fast learning for the nominal plant, and convergence
for all plants that cannot be excluded*.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ilctools.base import RegularisedInverse
from ilctools.filters import Filter, LearningFilter, ZeroPhaseButterworth
from ilctools.findings import Finding
from ilctools.problem import defaults
from ilctools.problem.bounds import Bounds
from ilctools.problem.lowpass import SampledQ
from ilctools.response.response import Response
from ilctools.response.samples import Assumed
from ilctools.response.scale import Scale
from ilctools.singular_values import largest_singular_values

K_MAX = 4.0  # bound on sigma_max(K): with more, the truncation of K e at a trial's ends would show
MOST_GAIN = 1e7  # of Q P L: with more, coefficients in doubles determine M worse than to 1e-9


@dataclass(frozen=True)
class Objective:
    """The objective of the design, which is minimised."""

    # "sum": (39); "peak": (45); "gain": the largest sigma_max(L), in units of L_max
    kind: str
    weights: np.ndarray  # (n,): weights of sigma_max(M) in the sum; ones in the band
    # band of the sum, rad/s; None if a reference weights the sum: `first_error` then has angles
    # (k,) and the spectrum of the first trial's error at these angles, (k, m), see
    # `problem.reference`
    band: tuple[float, float] | None = None
    first_error: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def summed(self) -> np.ndarray:
        """The frequencies that count in the sum, (n,), bool."""
        return (self.weights > 0) & (self.kind == "sum")

    def value(self, sigma_M, worst=None) -> float:
        """Compute the objective from sigma_max(M) of the nominal plant at each frequency.

        For the peak, `worst` (n,) is the largest sigma_max(M) over all plants. Default: `sigma_M`.
        """
        if self.kind == "sum":
            return float((self.weights * sigma_M)[self.summed].sum())  # (39)
        return float((sigma_M if worst is None else worst).max())  # (45)


@dataclass(frozen=True)
class Problem:
    """The design problem of a learning filter, as :func:`.pose.pose` makes it.

    M and L are bounded at the design frequencies `omega`. Where Q is zero, only L is bounded.
    """

    response: Response  # what is known of P
    lowpass: ZeroPhaseButterworth | SampledQ
    Q: np.ndarray  # (n,): response of the low-pass at omega; zero where only L is bounded
    objective: Objective
    bounds: Bounds
    order: int  # number of coefficients of L, or of K in L = B K
    structure: str = "full"  # or "diagonal"
    base: LearningFilter | RegularisedInverse | None = None  # B of L = B K, in units of `scale`
    formula_will_do: bool = False  # whether L = B is the design if L = B meets all bounds
    defaults_chosen: tuple[str, ...] = ()  # the defaults that were chosen, in words
    costs: tuple[Finding, ...] = ()  # warnings about defaults that cost much performance

    @property
    def M_max(self) -> float:
        """Bound on sigma_max(M)."""
        return self.bounds.M_max

    @property
    def L_max(self) -> float | None:
        """Bound on sigma_max(L)."""
        return self.bounds.L_max

    @property
    def omega(self) -> np.ndarray:
        """Frequencies at which M and L are bounded, rad/s, (n,)."""
        return self.response.omega

    @property
    def Ts(self) -> float:
        """Sampling period, s."""
        return self.response.Ts

    @property
    def plants(self) -> np.ndarray:
        """Frequency responses of the plants for which the bounds hold, (plants, n, p, m)."""
        return self.response.P

    @property
    def P(self) -> np.ndarray:
        """Frequency response of the nominal plant, shape (n, p, m)."""
        return self.response.P[0]

    @property
    def p(self) -> int:
        """Number p of outputs."""
        return self.P.shape[1]

    @property
    def m(self) -> int:
        """Number m of learned inputs."""
        return self.P.shape[2]

    @property
    def square(self) -> bool:
        """Whether there are as many outputs as learned inputs."""
        return self.p == self.m

    @property
    def of_v(self) -> bool:
        """Whether M acts on v, because there are fewer learned inputs than outputs."""
        return self.m < self.p

    def turned(self, X) -> np.ndarray:
        """Return P, L or B turned, which means transposed if M acts on v."""
        return X.mT if self.of_v else X

    @property
    def radius(self) -> np.ndarray | None:
        """Radius r, (n,), or None if r is zero.

        The bounds hold for all P + Delta with ||Delta|| <= r.
        """
        return self.response.radius

    @property
    def scale(self) -> Scale:
        """The sizes that count as equally large in each output and learned input."""
        return self.response.scale

    @property
    def proven(self) -> bool:
        """Whether P and Q are also known between the frequencies, as models without a radius."""
        exact = self.radius is None and not self.response.sampled
        return exact and isinstance(self.lowpass, ZeroPhaseButterworth)

    @property
    def channels(self) -> int:
        """Number of channels of M: the smaller of p and m."""
        return min(self.p, self.m)

    @property
    def idle(self) -> float:
        """The objective without learning, L = 0."""
        return self.objective.value(np.abs(self.Q))

    def gap_scale(self, value) -> float:
        """Return the number by which a duality gap is divided.

        The number is the objective, but at least a hundredth of the objective for L = 0. If the
        objective is smaller than this hundredth, one trial leaves almost no error, and rounding
        decides the digits of the objective.
        """
        return max(value, 1e-2 * self.idle)

    @property
    def delay_samples(self) -> int:
        """Delay of P at the cut-off of Q, in samples, see :mod:`.problem.defaults`."""
        return defaults.delay(self.P, self.omega, self.Ts, self.lowpass.cutoff)

    @property
    def robust(self) -> bool:
        """Whether the bounds hold for further plants in addition to the nominal plant."""
        return self.radius is not None or len(self.plants) > 1

    @property
    def singular_within_radius(self) -> np.ndarray:
        """Whether the radius contains a singular plant, at each frequency, shape (n,)."""
        # A singular plant has a direction without gain, in which sigma_max(M) >= |Q| for any L.
        if self.radius is None:
            return np.zeros(len(self.omega), dtype=bool)
        smallest = np.linalg.svdvals(self.plants)[..., -1].min(axis=0)
        return self.radius >= smallest

    def M(self, L, number: int = 0) -> np.ndarray:
        """Return M of the plant with this number at `omega`, from the response L of the filter."""
        return convergence_matrix(self.plants[number], self.Q, L)

    def affine(self, plant, at, radius) -> tuple[np.ndarray, np.ndarray]:
        """Return F and T of the bounded matrices G = F + T K.

        `plant` and `at` are the numbers of plants and the indices of frequencies. If `radius` is
        None, G is M = Q I - Q P L. With a radius r, G is [M; |Q| r L], see :class:`Cuts`. If P is
        not square, let B = U R with U* U = I. G then contains R K instead of L = B K. R K and B K
        have the same singular values.
        """
        Q = self.Q[at, None, None]
        T = self.through_base(-Q * self.turned(self.plants[plant, at]), at)
        if radius is not None:
            if self.square:
                of_L = self.through_base(np.eye(self.channels), at)
            else:
                of_L = np.linalg.qr(self.of_K[at], mode="r")
            T = np.concatenate([T, np.abs(Q) * radius[at, None, None] * of_L], axis=1)
        return Q * np.eye(T.shape[1], self.channels), T

    @cached_property
    def L_bound(self) -> np.ndarray:
        """W, shape (n, m, m), with which sigma_max(W L) <= 1 expresses all bounds on L.

        If L = B K, sigma_max(W K) <= 1 expresses the bounds on L and K. Otherwise W is the identity
        divided by the least limit at each frequency, (46). If L has no bound, each input gets a
        bound that keeps the gain of Q P L below `MOST_GAIN`, 1e7. For a larger gain, coefficients
        in doubles would not determine M to about 1e-9. If the objective is the least gain, W
        contains only L_max; `L_bound_beside` then has the bound L_high.
        """
        bounds, identity = self.bounds, np.eye(self.channels)
        if self.objective.kind == "gain":
            bounds = replace(bounds, L_high=None)
        limit = bounds.limit_on_L(self.omega)
        if self.base is not None:  # sigma_max(B K) <= sigma_max(B) sigma_max(K)
            sigma_B = largest_singular_values(self.of_K)
            return np.maximum(sigma_B / limit, 1 / K_MAX)[:, None, None] * identity
        W = identity / limit[:, None, None]
        if np.isinf(limit).any():
            gains = np.linalg.norm(self.Q[:, None, None] * self.P, axis=1).max(axis=0)
            free = np.diag(gains) / np.abs(self.Q).max() / MOST_GAIN
            W = np.where(np.isinf(limit)[:, None, None], free, W)
        return W

    @property
    def L_bound_beside(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequency indices, and W (k, m, m), of the bound L_high that `L_bound` leaves out.

        Only the objective "gain" has such a bound.
        """
        limit = replace(self.bounds, L_max=None).limit_on_L(self.omega)
        at = np.flatnonzero(np.isfinite(limit) & (self.objective.kind == "gain"))
        return at, np.eye(self.channels) / limit[at, None, None]

    @property
    def first_sample(self) -> int:
        """The power of z that belongs to the first coefficient.

        K uses samples ahead and back. L uses only samples ahead.
        """
        return 1 if self.base is None else -((self.order - 1) // 2)

    @cached_property
    def of_K(self) -> np.ndarray | None:
        """B times a shift in time, turned, at omega.

        The product of this response and `K(solution)` is L.

        The response is in units of `scale`. It is None if there is no base, so that L is K.
        """
        if self.base is None:
            return None
        shift = np.exp(1j * (self.first_sample - 1) * self.omega * self.Ts)
        return self.turned(self.base.frequency_response(self.omega)) * shift[:, None, None]

    def through_base(self, T, at):
        """Convert T of G = F + T L into T of G = F + T K / z^(first_sample - 1)."""
        return T if self.base is None else T @ self.of_K[at]

    @property
    def assumptions(self) -> tuple[str | Assumed, ...]:
        """The chosen defaults, and the assumptions on P, its radius and Q, in words."""
        more, response, lost = [], self.response, self.singular_within_radius
        chosen = [f"chosen: {'; '.join(self.defaults_chosen)}"] if self.defaults_chosen else []
        if isinstance(self.lowpass, SampledQ):
            last = np.abs(self.lowpass.samples[-1])
            text = (
                f"Q is interpolated by splines between its samples, and is {last:.4g} above "
                "the last one"
            )
            more.append(Assumed(text))
        if lost.any():
            low, high = self.omega[lost][[0, -1]]
            more.append(
                f"nothing can be learned at {lost.sum()} frequencies from {low:.4g} to "
                f"{high:.4g} rad/s, where the radius of P contains singular plants; "
                "sigma_max(M) is at least |Q| there, which is up to "
                f"{np.abs(self.Q[lost]).max():.4g}"
            )
        return (*chosen, *response.assumptions, *response.assumed, *more)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """A finding if no filter can meet M_max above the last sample of P.

        Otherwise, there is no finding.
        """
        Q = np.abs(self.Q[-1])
        if self.response.beyond is None or self.M_max > Q:
            return ()
        return (Finding("unmeasured", Q, self.M_max, f"above {self.omega[-1]:.4g} rad/s"),)

    def scaled_filter(self, coefficients) -> Filter:
        """Return L from coefficients of L, or of K in L = B K, all in units of `scale`."""
        # B of a model treats the end of a trial exactly: K must not truncate the error there
        ends = "hold-last" if isinstance(self.base, RegularisedInverse) else "zero"
        K = LearningFilter(coefficients, self.Ts, ends, self.first_sample)
        if self.base is None:
            return K
        if self.of_v:
            return replace(K, coefficients=coefficients.swapaxes(0, 1)) @ self.base
        return self.base @ K

    @property
    def poles_of_L(self) -> np.ndarray:
        """The poles of L for any coefficients of this order, see :mod:`.evidence.peak`."""
        return self.scaled_filter(np.zeros((self.channels, self.channels, self.order))).poles

    def K(self, solution: "Solution") -> np.ndarray:
        """Return the turned frequency response of a solution's filter at omega.

        This is K / z^(first_sample - 1) if L = B K, and L otherwise.
        """
        return LearningFilter(solution.coefficients, self.Ts).frequency_response(self.omega)

    def L(self, solution: "Solution") -> np.ndarray:
        """Return the response of a solution's filter at omega, (n, m, p), in units of `scale`."""
        K = self.K(solution)
        return K if self.base is None else self.turned(self.of_K @ K)


@dataclass(frozen=True)
class Cuts:
    """Bounds that the solver had to add for further plants or a radius r, with multipliers N.

    The bounded matrix is G = M, or G = [M; |Q| r L] for a radius r.
    """

    plant: np.ndarray  # (c,): number of the plant of each bound
    frequency: np.ndarray  # (c,): index of the frequency of each bound
    N: np.ndarray  # (c, rows of G, m), complex: multipliers of G


@dataclass(frozen=True)
class Solution:
    """A learning filter, and the multipliers by which its optimality can be proven."""

    # (s, s, order): C_k of L(z) = sum_k C_k z^k, or of K in L = B K, turned, in units of `scale`
    coefficients: np.ndarray
    # (n, s, s), complex: multipliers of the nominal M, and of L or K
    U: np.ndarray
    V: np.ndarray
    largest: float  # sigma_max(M), or sigma_max(W L) if the objective is the least gain
    cuts: Cuts | None = None  # the bounds that the solver had to add


def convergence_matrix(P, Q, L) -> np.ndarray:
    """Compute M from responses P (..., n, p, m), L (..., n, m, p) and Q (n,).

    M = P Q (P^-1 - L) = Q (I - P L). With fewer inputs than outputs, M = Q (I - L P).
    """
    PL = P @ L if P.shape[-1] >= P.shape[-2] else L @ P
    return Q[:, None, None] * (np.eye(PL.shape[-1]) - PL)  # (36), (40)
