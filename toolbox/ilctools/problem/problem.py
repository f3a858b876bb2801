"""What is asked of the learning filter: the problems (39), (45), (46) as one checked object.

:func:`.pose.pose` states a problem and checks it; solvers and evidence take it whole.
Frequency responses have the frequency first. The channels of P, L and M are in units of `scale`,
so that singular values compare what counts as equally large.

M is affine in P. A bound on it for several plants, or for all within a radius of them, is as convex
as for one: *fast for the plant that one believes in, convergent for all that cannot be excluded*.
"""

from dataclasses import dataclass
from functools import cached_property

import control
import numpy as np
from scipy.interpolate import CubicSpline

from ilctools.base import RegularisedInverse, in_units
from ilctools.filters import LearningFilter, LearningOperator, ZeroPhaseButterworth
from ilctools.problem import defaults
from ilctools.problem.between import axis_of, missed
from ilctools.signals import Signals
from ilctools.singular_values import largest_singular_values

K_MAX = 4.0  # of sigma_max(K): more would show at the ends of a trial, where K e is cut off
MOST_GAIN = 1e7  # of Q P L: beyond it coefficients in doubles no longer determine M to about 1e-9
ROUNDING = 1e-9  # of an angle: two that are nearer are the same frequency


@dataclass(frozen=True, kw_only=True)
class Problem:
    """The problem of a learning filter. Made by :func:`.pose.pose`.

    M and L are bounded at `omega`; where Q is zero, L alone.
    """

    # P and Q on one grid, P in units of `scale`
    # (p, n, m, m), complex: frequency responses of the plants for which the bounds hold; the first
    # is the nominal one
    plants: np.ndarray
    models: tuple[control.StateSpace | None, ...]  # of the plants; None of samples
    Q: np.ndarray  # (n,): of the Q-filter
    butterworth: ZeroPhaseButterworth | None  # Q, if it is a model
    omega: np.ndarray  # (n,): frequencies at which M is bounded, rad/s
    Ts: float  # sampling period, s
    scale: np.ndarray  # (m,): what counts as equally large in each channel
    # (n,): bounds hold for P + Delta, ||Delta|| <= radius; None for P alone
    radius: np.ndarray | None
    basis: tuple[str, ...]  # what a measured P and its radius rest on; default choices
    labels: Signals  # of the nominal plant

    # what is asked of L
    order: int = 1  # number of samples that the learning filter looks ahead, or of those of K
    base: LearningOperator | None = None  # B of L = B K, in the plant's units
    pooled: bool = False  # whether B is of all plants
    M_max: float = 0.9  # bound on sigma_max(M)
    L_max: float | None = None  # bound on sigma_max(L)
    structure: str = "full"  # or "diagonal"
    # "sum", (39); "peak", (45); "gain": the least sigma_max(L), in units of L_max
    objective: str = "sum"
    everywhere: bool = False  # whether the bounds hold between the frequencies, too
    # over which "sum" sums, rad/s; None if a reference weights it: then there is the power of the
    # first trial's error at the design frequencies, (n, m, m), see `reference`
    band: tuple[float, float] | None = None
    first_error: np.ndarray | None = None
    weights: np.ndarray | None = None  # (n,): of sigma_max(M) in the sum; ones in the band

    # what was asked, without the frequencies of `grid` and its lower bounds; None if this is it
    stated: "Problem | None" = None

    @property
    def design(self) -> "Problem":
        """The problem as stated: at the design frequencies."""
        return self.stated or self

    @property
    def P(self) -> np.ndarray:
        """Frequency response of the nominal plant, shape (n, m, m)."""
        return self.plants[0]

    @property
    def model(self) -> tuple[control.StateSpace, ZeroPhaseButterworth] | None:
        """P and Q, if both are models."""
        known = self.models[0] is not None and self.butterworth is not None
        return (self.models[0], self.butterworth) if known else None

    @property
    def known(self) -> bool:
        """Whether P and Q are known between the frequencies, too: models without a radius."""
        exact = self.butterworth is not None and self.design.radius is None
        return exact and None not in self.models

    @property
    def channels(self) -> int:
        """Number m of channels."""
        return self.plants.shape[-1]

    @property
    def idle(self) -> float:
        """The objective without learning, L = 0."""
        return self.value(np.abs(self.Q))

    def unit(self, value) -> float:
        """Scale of relative gaps: the objective, at least a hundredth of that for L = 0.

        Below that, learning leaves next to nothing after one trial, and rounding decides the rest.
        """
        return max(value, 1e-2 * self.idle)

    @property
    def cutoff(self) -> float:
        """Cut-off of Q, rad/s."""
        if self.butterworth is not None:
            return self.butterworth.cutoff
        return defaults.cutoff(self.design.Q, self.design.omega)

    @property
    def delay(self) -> int:
        """Samples by which P lags at the cut-off of Q, see :mod:`.problem.defaults`."""
        return defaults.delay(self.design.P, self.design.omega, self.Ts, self.cutoff)

    @property
    def robust(self) -> bool:
        """Whether the bounds hold for more plants than the nominal one."""
        return self.design.radius is not None or len(self.plants) > 1

    @property
    def unusable(self) -> np.ndarray:
        """Whether the radius admits a singular plant, at each frequency, shape (n,)."""
        # In some direction no learning filter acts on such a plant: sigma_max(M) >= |Q|.
        if self.radius is None:
            return np.zeros(len(self.omega), dtype=bool)
        smallest = np.linalg.svd(self.plants, compute_uv=False)[..., -1].min(axis=0)
        return self.radius >= smallest

    def value(self, sigma_M, worst=None) -> float:
        """The objective, from the largest singular value of M at each frequency.

        `worst`, for the peak: the largest over all plants; by default that of the nominal one.
        """
        if self.objective == "sum":
            return float((self.weights * sigma_M)[self.weights > 0].sum())  # (39)
        return float((sigma_M if worst is None else worst).max())  # (45)

    def M(self, L, number: int = 0) -> np.ndarray:
        """M of a plant at `omega`, from the response of L there."""
        return convergence_matrix(self.plants[number], self.Q, L)

    @property
    def weight(self) -> np.ndarray:
        """W, shape (n, m, m), such that sigma_max(W L) <= 1 is the bound on L, or W K that on K.

        That is I / L_max, (46). Without a bound, coefficients in doubles determine M to about 1e-9
        only up to a gain of 1e7 of Q P L, counted for each input by itself: that is then the bound.
        """
        identity, L_max = np.eye(self.channels), self.L_max or np.inf
        if self.base is not None:  # sigma_max(B K) <= sigma_max(B) sigma_max(K)
            return np.maximum(self.sigma_B / L_max, 1 / K_MAX)[:, None, None] * identity
        if self.L_max is None:
            gains = np.linalg.norm(self.Q[:, None, None] * self.P, axis=1).max(axis=0)
            identity, L_max = np.diag(gains) / np.abs(self.Q).max(), MOST_GAIN
        return np.broadcast_to(identity / L_max, self.P.shape)

    @property
    def first(self) -> int:
        """The first sample of L, or of K: a K looks as far back as ahead."""
        return 1 if self.base is None else -((self.order - 1) // 2)

    @cached_property
    def of_K(self) -> np.ndarray | None:
        """What L is for K = z at omega, (n, m, m), in units of `scale`; None if L is K."""
        if self.base is None:
            return None
        shift = np.exp(1j * (self.first - 1) * self.omega * self.Ts)
        units = self.scale / self.scale[:, None]
        return self.base.frequency_response(self.omega) * shift[:, None, None] * units

    @cached_property
    def sigma_B(self) -> np.ndarray:
        """sigma_max(B) at omega, (n,)."""
        return largest_singular_values(self.of_K)

    def through_base(self, T, at):
        """T of G = F + T L as that of G = F + T K / z^(first - 1), at numbers of omega."""
        return T if self.base is None else T @ self.of_K[at]

    def Q_at(self, omega) -> np.ndarray:
        """Q at some frequencies; of samples, by a spline, and beyond their ends as there."""
        if self.butterworth is not None:
            return self.butterworth.frequency_response(omega)
        known = self.design.omega
        spline = CubicSpline(self.axis(known), self.design.Q)
        return spline(self.axis(np.clip(omega, known[0], known[-1])))

    @property
    def beyond(self) -> float | None:
        """The sigma_max(P) that is assumed above the last sample; None if P is known there."""
        design, sampled = self.design, [model is None for model in self.models]
        if not any(sampled) or design.omega[-1] * self.Ts >= np.pi - ROUNDING:
            return None
        size = largest_singular_values(design.plants[sampled, -1]).max()
        return float(size if design.radius is None else size + design.radius[-1])

    @cached_property
    def axis(self):
        """Of omega and log omega that over which samples are interpolated, see `between`."""
        return axis_of(self.design.P, self.design.Q, self.design.omega)

    @cached_property
    def missed(self) -> np.ndarray:
        """What splines miss of each plant at its samples, beyond the radius, (p, n)."""
        one = np.broadcast_to(np.eye(self.channels), self.P.shape)
        of_all = [missed(P, one, self.axis(self.omega)) for P in self.plants]
        return np.maximum(np.array(of_all) - (0 if self.radius is None else self.radius), 0)

    @property
    def assumed(self) -> tuple[str, ...]:
        """What is assumed above the last sample and between them, in words."""
        texts, last, Q = [], self.design.omega[-1], np.abs(self.design.Q[-1])
        if self.beyond is not None:
            of_Q = "" if self.butterworth else f", and |Q| {Q:.4g}, as at the last sample"
            texts.append(
                f"assumed: above {last:.4g} rad/s, where P is not known, sigma_max(P) is "
                f"{self.beyond:.4g} at most, at any phase{of_Q}"
            )
        sampled = self.butterworth is None or None in self.models
        splines = "cubic splines miss P by no more than they miss samples that are left out"
        known = [splines] if sampled else []
        if self.design.radius is not None:
            known.append("the radius is interpolated by straight lines")
        if known:
            axis = "log omega" if self.design.axis is np.log else "omega"
            texts.append(f"assumed: between omega, {' and '.join(known)}, over {axis}")
        return tuple(texts)

    @property
    def findings(self) -> tuple[str, ...]:
        """Why the bounds cannot hold where P is not known."""
        if self.beyond is None:
            return ()
        last = self.design.omega[-1]
        Q = np.abs(self.Q_at([last]))[0]
        if self.design.M_max > Q:
            return ()
        return (
            f"Q is {Q:.4g} above {last:.4g} rad/s, where P is not known: no filter bounds M "
            f"by {self.design.M_max:g} there; lower the cut-off of Q, or measure further",
        )

    def filter(self, coefficients) -> LearningFilter:
        """The learning filter, in the plant's own units, of coefficients in units of `scale`."""
        units = self.scale[:, None, None] / self.scale[None, :, None]
        # B of a model knows the end of a trial; K, cut off there, must not leave the error to it
        ends = "hold-last" if isinstance(self.base, RegularisedInverse) else "zero"
        return LearningFilter(coefficients * units, self.Ts, ends, self.first, self.base)

    def learned(self, solution: "Solution") -> LearningFilter:
        """The filter of a solution, in units of `scale`."""
        base = self.base and in_units(self.base, self.scale)
        return LearningFilter(solution.coefficients, self.Ts, first=self.first, base=base)

    def K(self, solution: "Solution") -> np.ndarray:
        """Response of K / z^(first - 1), or of L without a base, at omega, (n, m, m)."""
        return LearningFilter(solution.coefficients, self.Ts).frequency_response(self.omega)

    def response(self, solution: "Solution") -> np.ndarray:
        """Response of a solution's filter at omega, (n, m, m), in units of `scale`."""
        K = self.K(solution)
        return K if self.base is None else self.of_K @ K


@dataclass(frozen=True)
class Cuts:
    """Bounds on G = M for other plants, and on G = [M; |Q| r L] for a radius r, as multipliers."""

    plant: np.ndarray  # (c,): number of the plant of each bound
    frequency: np.ndarray  # (c,): index of its frequency
    N: np.ndarray  # (c, rows of G, m), complex: multipliers of G


@dataclass(frozen=True)
class Solution:
    """A learning filter, and the multipliers from which its optimality can be proven."""

    # (m, m, order): of L(z) = sum_k C_k z^k, in units of `scale`
    coefficients: np.ndarray
    # (n, m, m), complex: multipliers of the nominal M, and of L or K
    U: np.ndarray
    V: np.ndarray
    largest: float  # sigma_max(M); of W L, for the least gain
    iterations: int
    cuts: Cuts | None = None  # what was needed of them


def convergence_matrix(P, Q, L) -> np.ndarray:
    """M = P Q (P^-1 - L) = Q (I - P L) from responses P, L, (..., n, m, m), and Q, (n,)."""
    return Q[:, None, None] * (np.eye(P.shape[-1]) - P @ L)  # (36), (40)
