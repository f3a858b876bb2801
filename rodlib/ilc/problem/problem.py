"""What is asked of the learning filter: the problems (39), (45), (46) as one checked object.

:func:`rodlib.ilc.problem.pose` states a problem and checks it; solvers and evidence take it whole.
Frequency responses have the frequency first. The channels of P, L and M are in units of `scale`,
so that singular values compare what counts as equally large.

M is affine in P. A bound on it for several plants, or for all within a radius of them, is as convex
as for one: *fast for the plant that one believes in, convergent for all that cannot be excluded*.
"""

from dataclasses import dataclass

import control
import numpy as np

from rodlib.ilc.filters import LearningFilter, ZeroPhaseButterworth

MOST_GAIN = 1e7  # of Q P L, from which on the rounding of coefficients shows
ROUNDING = 1e-9  # of an angle; what is nearer to pi is at the Nyquist frequency
TIED = 1e-6  # relative distance at which rounding, or the accuracy of a solver, decides an order


@dataclass(frozen=True)
class Problem:
    """The problem of a learning filter. Made by :func:`rodlib.ilc.problem.pose`."""

    P: (
        np.ndarray
    )  # (n, m, m), complex: frequency response of the plant, the current-trial loop
    Q: np.ndarray  # (n,): of the Q-filter
    omega: np.ndarray  # (n,): design frequencies, rad/s
    Ts: float  # sampling period, s
    scale: np.ndarray  # (m,): what counts as equally large in each channel
    others: (
        np.ndarray
    )  # (p, n, m, m): plants 1 to p, for which the bounds hold as for P, plant 0
    models: tuple[
        control.StateSpace | None, ...
    ]  # all plants, as far as they are models
    butterworth: ZeroPhaseButterworth | None  # Q, if it is a model
    asked: (
        np.ndarray
    )  # (n,), bool: False where only L is bounded; P and Q stand as zero there
    limit_L: (
        np.ndarray
    )  # (n,): bound on sigma_max(L) beside L_max, see `weight`; infinite if none
    share_L: (
        np.ndarray
    )  # (n,): of L_max that L may have at a sample, so that it keeps it between
    band: tuple[float, float]  # over which "sum" sums, rad/s
    L_max: float | None  # bound on sigma_max(L)
    order: int = 10  # number of samples that the learning filter looks ahead
    M_max: float = 0.9  # bound on sigma_max(M)
    structure: str = "diagonal"  # or "full"
    objective: str = (
        "sum"  # or "peak"; or "gain": the least sigma_max(L), in units of L_max
    )
    radius: np.ndarray | None = (
        None  # (n,): the bounds hold for all P + Delta, ||Delta|| <= radius
    )
    basis: tuple[
        str, ...
    ] = ()  # what nobody gave; what a measured P and its radius rest on
    beyond: float | None = (
        None  # sigma_max(P) is at most that above the last sample; None if known
    )
    findings: tuple[str, ...] = ()  # what the statement itself leaves in doubt
    everywhere: bool = (
        False  # whether the bounds shall hold between the frequencies omega, too
    )

    @property
    def model(self) -> tuple[control.StateSpace, ZeroPhaseButterworth] | None:
        """P and Q, if both are models."""
        known = self.models[0] is not None and self.butterworth is not None
        return (self.models[0], self.butterworth) if known else None

    @property
    def channels(self) -> int:
        """Number m of channels."""
        return self.P.shape[1]

    @property
    def angles(self) -> np.ndarray:
        """omega Ts."""
        return self.omega * self.Ts

    @property
    def in_band(self) -> np.ndarray:
        """Which of the frequencies that were asked for lie in the band, shape (n,)."""
        return self.asked & (self.omega >= self.band[0]) & (self.omega <= self.band[1])

    @property
    def idle(self) -> float:
        """The objective without learning, L = 0."""
        return self.value(np.abs(self.Q))

    def unit(self, value) -> float:
        """What a gap is relative to: the objective, or a thousandth of that without learning."""
        return max(value, 1e-3 * self.idle)  # a billionth of that is as good as nothing

    @property
    def robust(self) -> bool:
        """Whether the bounds hold for more plants than P."""
        return self.radius is not None or len(self.others) > 0

    @property
    def unusable(self) -> np.ndarray:
        """Whether the radius admits a singular plant, at each frequency, shape (n,)."""
        # Of such a plant, in some direction, no learning filter sees anything: the largest singular
        # value of M is |Q| or more for one of those within the radius.
        if self.radius is None:
            return np.zeros(len(self.omega), dtype=bool)
        plants = np.concatenate([self.P[None], self.others])
        smallest = np.linalg.svd(plants, compute_uv=False)[..., -1].min(axis=0)
        return self.asked & (self.radius >= smallest)

    def plant(self, number: int) -> np.ndarray:
        """Frequency response of a plant; 0 is the nominal one, P."""
        return self.P if number == 0 else self.others[number - 1]

    def value(self, sigma_M, worst=None) -> float:
        """The objective, from the largest singular value of M at each frequency.

        `worst`, for the peak: the largest over all plants; by default that of the nominal one.
        """
        if self.objective == "sum":
            return float(sigma_M[self.in_band].sum())  # (39)
        return float((sigma_M if worst is None else worst).max())  # (45)

    def M(self, L, number: int = 0) -> np.ndarray:
        """M of a plant, from the frequency response of L."""
        return convergence_matrix(self.plant(number), self.Q, L)

    @property
    def weight(self) -> np.ndarray:
        """W, shape (n, m, m), such that sigma_max(W L) <= 1 is the bound on the learning filter.

        That is I / L_max, (46); less than L_max counts where a coarse grid would let L pass it
        between two samples, and where P is not known. Without a bound, filters are still compared
        only up to where their coefficients, held in doubles, determine M to about 1e-9: up to a
        gain of 1e7 of Q P L, counted for each input by itself. What larger ones could gain on
        paper, no computer can apply.
        """
        identity = np.eye(self.channels)
        if self.L_max is not None:
            limit = np.minimum(self.L_max * self.share_L, self.limit_L)
            return identity / limit[:, None, None]  # (46)
        gains = np.linalg.norm(self.Q[:, None, None] * self.P, axis=1).max(axis=0)
        most = np.diag(gains / np.abs(self.Q).max() / MOST_GAIN)
        return np.where(
            np.isfinite(self.limit_L)[:, None, None],
            identity / self.limit_L[:, None, None],
            most,
        )

    def passed_L(self, L) -> float:
        """The largest sigma_max(W L) of a frequency response of L, where a bound on it was asked.

        That bound is one.
        """
        bounded = np.full(len(self.omega), self.L_max is not None) | np.isfinite(
            self.limit_L
        )
        return float(largest_singular_values((self.weight @ L)[bounded]).max(initial=0))

    def Q_beyond(self, omega) -> np.ndarray:
        """|Q| at frequencies from the last sample on; of samples, the last."""
        if self.butterworth is not None:
            return np.abs(self.butterworth.frequency_response(omega))
        return np.full(len(omega), np.abs(self.Q[self.asked][-1]))

    @property
    def assumed(self) -> tuple[str, ...]:
        """What is assumed of P and Q above the last sample, in words."""
        if self.beyond is None:
            return ()
        last, Q = self.omega[self.asked][-1], self.Q[self.asked][-1]
        as_there = (
            ""
            if self.butterworth
            else f", and |Q| {np.abs(Q):.4g}, as at the last sample"
        )
        return (
            f"assumed: above {last:.4g} rad/s, where P is not known, sigma_max(P) is "
            f"{self.beyond:.4g} at most, at any phase{as_there}",
        )

    def filter(self, coefficients) -> LearningFilter:
        """The learning filter, in the plant's own units, of coefficients in units of `scale`."""
        units = self.scale[:, None, None] / self.scale[None, :, None]
        return LearningFilter(coefficients * units, self.Ts)

    def response(self, solution: "Solution") -> np.ndarray:
        """Frequency response of a solution's filter, shape (n, m, m), in units of `scale`."""
        return LearningFilter(solution.coefficients, self.Ts).frequency_response(
            self.omega
        )


@dataclass(frozen=True)
class Cuts:
    """Bounds on G = M for other plants, and on G = [M; |Q| r L] for a radius r, as multipliers."""

    plant: np.ndarray  # (c,): number of the plant of each bound
    frequency: np.ndarray  # (c,): index of its frequency
    N: np.ndarray  # (c, rows of G, m), complex: multipliers of G
    split: (
        np.ndarray
    )  # (c, 1), or (c, 0) without r: share of the bound left to the rows below M


@dataclass(frozen=True)
class Solution:
    """A learning filter, and the multipliers from which its optimality can be proven."""

    coefficients: (
        np.ndarray
    )  # (m, m, order): of L(z) = sum_k C_k z^k, in units of `scale`
    U: np.ndarray  # (n, m, m), complex: multipliers of the nominal M
    V: np.ndarray  # (n, m, m), complex: multipliers of L
    largest: float  # sigma_max(M); of W L, for the least gain
    method: str
    iterations: int
    cuts: Cuts | None = None  # what was needed of them


def convergence_matrix(P, Q, L) -> np.ndarray:
    """M = P Q (P^-1 - L) = Q (I - P L) from responses P, L, (..., n, m, m), and Q, (n,)."""
    return Q[:, None, None] * (np.eye(P.shape[-1]) - P @ L)  # (36), (40)


def tied(values):
    """Which of several values are the largest, as far as rounding leaves it open."""
    return values >= values.max(axis=0) * (1 - TIED)


def largest_singular_values(G):
    """Largest singular value of each matrix, shape (n, p, m) to (n,)."""
    if min(G.shape[1:]) > 2:
        return np.linalg.norm(G, 2, axis=(1, 2))
    # Below three by three the Hermitian eigenvalue problem has a closed form, ten times faster.
    G = G if G.shape[1] <= G.shape[2] else np.swapaxes(G, 1, 2)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        power = (G.real**2 + G.imag**2).sum(axis=2)
        total = power.sum(axis=1)
        if G.shape[1] == 1:
            sigma = np.sqrt(total)
        else:
            coupling = np.abs((G[:, 0] * G[:, 1].conj()).sum(axis=1))
            sigma = np.sqrt(
                total / 2 + np.hypot((power[:, 0] - power[:, 1]) / 2, coupling)
            )
    if not (total.min(initial=1) > 1e-280 and total.max(initial=1) < 1e280):
        extreme = ~(
            (total > 1e-280) & (total < 1e280)
        )  # the squares may have left the doubles
        sigma[extreme] = np.linalg.norm(G[extreme], 2, axis=(1, 2))
    return sigma
