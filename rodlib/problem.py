"""What is asked of the learning filter: the problems (39), (45), (46) as one checked object.

:func:`pose` states a problem and checks it; solvers and evidence take it whole. Frequency responses
have the frequency first. The channels of P, L and M are in units of `scale`, so that singular
values compare what counts as equally large.

M is affine in P. A bound on it for several plants, or for all within a radius of them, is as convex
as for one: *fast for the plant that one believes in, convergent for all that cannot be excluded*.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import control
import numpy as np

from rodlib import arguments
from rodlib.filters import LearningFilter, ZeroPhaseButterworth
from rodlib.loop import CurrentTrialLoop
from rodlib.realisation import frequency_response

LARGEST = 1e7  # gain of Q P L from which on the rounding of coefficients shows


@dataclass(frozen=True)
class Problem:
    """The problem of a learning filter. Made by :func:`pose`.

    Attributes
    ----------
    P : ndarray, shape (n, m, m), complex
        Frequency response of the plant, that is, of the current-trial loop.
    Q : ndarray, shape (n,)
        Frequency response of the Q-filter.
    omega : ndarray, shape (n,)
        Design frequencies, rad/s.
    Ts : float
        Sampling period, s.
    order : int
        Number of samples that the learning filter looks ahead.
    M_max, L_max : float, float or None
        Bounds on sigma_max(M) and sigma_max(L).
    in_band : ndarray of bool, shape (n,)
        Frequencies over which "sum" sums.
    structure : {"diagonal", "full"}
    objective : {"sum", "peak", "gain"}
        "gain" minimises the largest sigma_max(L), with `L_max` for its unit and no bound.
    scale : ndarray, shape (m,)
        What counts as equally large in each channel.
    model : tuple of control.StateSpace and ZeroPhaseButterworth, or None
        P and Q, if both were given as models.
    others : ndarray, shape (p, n, m, m), complex
        Further plants for which the bounds hold; plant number 0 is P, these are 1 to p.
    other_models : tuple of control.StateSpace or None
        As far as they were given as models.
    radius : ndarray, shape (n,) or (n, m, m), or None
        The bounds hold for all P + Delta with ||Delta|| <= radius at each frequency, or with
        |Delta_ij| <= radius_ij, and likewise for the other plants.
    """

    P: np.ndarray
    Q: np.ndarray
    omega: np.ndarray
    Ts: float
    order: int
    M_max: float
    L_max: float | None
    in_band: np.ndarray
    structure: str
    objective: str
    scale: np.ndarray
    model: tuple[control.StateSpace, ZeroPhaseButterworth] | None
    others: np.ndarray
    other_models: tuple[control.StateSpace | None, ...] = ()
    radius: np.ndarray | None = None

    @property
    def channels(self) -> int:
        """Number m of channels."""
        return self.P.shape[1]

    @property
    def angles(self) -> np.ndarray:
        """omega Ts."""
        return self.omega * self.Ts

    @property
    def idle(self) -> float:
        """The objective without learning, L = 0."""
        return self.value(np.abs(self.Q))

    @property
    def robust(self) -> bool:
        """Whether the bounds hold for more plants than P."""
        return self.radius is not None or len(self.others) > 0

    def plant(self, number: int) -> np.ndarray:
        """Frequency response of a plant; 0 is the nominal one, P."""
        return self.P if number == 0 else self.others[number - 1]

    def value(self, sigma_M, worst=None) -> float:
        """The objective, from the largest singular value of M at each frequency.

        `worst`, for the peak: the largest over all plants; by default that of the nominal one.
        """
        if self.objective == "sum":
            return float(sigma_M[self.in_band].sum())
        return float((sigma_M if worst is None else worst).max())

    def M(self, L, number: int = 0) -> np.ndarray:
        """M of (40) of a plant, from the frequency response of L."""
        return convergence_matrix(self.plant(number), self.Q, L)

    @property
    def weight(self) -> np.ndarray:
        """W, shape (m, m), such that sigma_max(W L) <= 1 is the bound on the learning filter.

        That is I / L_max. Without a bound (46), filters are still compared only up to where their
        coefficients, held in doubles, determine M to about 1e-9: up to a gain of 1e7 of Q P L,
        counted for each input by itself. What larger ones could gain on paper, no computer can
        apply.
        """
        if self.L_max is not None:
            return np.eye(self.channels) / self.L_max
        gains = np.linalg.norm(self.Q[:, None, None] * self.P, axis=1).max(axis=0)
        return np.diag(gains / np.abs(self.Q).max() / LARGEST)

    def filter(self, coefficients) -> LearningFilter:
        """The learning filter, in the plant's own units, of coefficients in units of `scale`."""
        units = self.scale[:, None, None] / self.scale[None, :, None]
        return LearningFilter(coefficients * units, self.Ts)


@dataclass(frozen=True)
class Cuts:
    """Bounds on M for other plants than the nominal one, or for a radius, with their multipliers.

    For a plant P and a frequency, the matrix that is bounded is G = M = Q (I - P L) if there is no
    radius r, and otherwise

        G = [M; |Q| r L]                            for a radius of the norm, 2m x m,
        G = [M; |Q| r_ij (row j of L), all i, j]    entry by entry, m + m^2 x m, i first.

    Attributes
    ----------
    plant, frequency : ndarray of int, shape (c,)
        Of each bound: number of the plant, index of the frequency.
    N : ndarray, shape (c, rows of G, m), complex
        Multipliers of G.
    split : ndarray, shape (c, k)
        Share d of the bound b that is left to the rows below M: diag(b - d, d) for its rows. One
        for a radius of the norm; entry by entry m^2, and b - sum_j d_ij for row i of M. Empty
        without a radius.
    """

    plant: np.ndarray
    frequency: np.ndarray
    N: np.ndarray
    split: np.ndarray


@dataclass(frozen=True)
class Solution:
    """A learning filter, and the multipliers from which its optimality can be proven.

    Attributes
    ----------
    coefficients : ndarray, shape (m, m, order)
        L(z) = sum_k coefficients[:, :, k - 1] z^k, in units of `scale`.
    U, V : ndarray, shape (n, m, m), complex
        Multipliers of the nominal M and of L.
    peak : float
        Largest sigma_max(M); of W L, for the least gain.
    method : str
        That found it.
    iterations : int
    cuts : Cuts or None
        What was needed of the bounds on M for other plants, and for a radius.
    """

    coefficients: np.ndarray
    U: np.ndarray
    V: np.ndarray
    peak: float
    method: str
    iterations: int
    cuts: Cuts | None = None


def convergence_matrix(P, Q, L) -> np.ndarray:
    """Evaluate M = Q (I - P L) of (40) from frequency responses.

    Parameters
    ----------
    P, L : ndarray, shape (n, m, m)
    Q : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n, m, m), complex
    """
    return Q[:, None, None] * (np.eye(P.shape[1]) - P @ L)


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
            sigma = np.sqrt(total / 2 + np.hypot((power[:, 0] - power[:, 1]) / 2, coupling))
    if not (total.min(initial=1) > 1e-280 and total.max(initial=1) < 1e280):
        extreme = ~((total > 1e-280) & (total < 1e280))  # the squares may have left the doubles
        sigma[extreme] = np.linalg.norm(G[extreme], 2, axis=(1, 2))
    return sigma


def pose(
    P,
    Q,
    omega,
    Ts,
    *,
    order=10,
    M_max=0.9,
    L_max=50.0,
    band=(1e-4, 0.02),
    structure="diagonal",
    objective="sum",
    scale=None,
    uncertainty=None,
) -> Problem:
    """State the problem (39), or (45) with (46), and check it.

    Parameters and errors as for :func:`rodlib.synthesise`.

    Returns
    -------
    Problem
    """
    Ts = arguments.sampling_period("Ts", Ts)
    omega = _frequencies(omega, Ts)
    given = _plants(P)
    plant, P = _response("P" if len(given) == 1 else "P[0]", given[0], omega, Ts)
    q, Q = _q_response(Q, omega, Ts)
    order = arguments.whole("order", order, 1, len(omega))
    what = "in (0, 1), or the trials do not converge"
    M_max = arguments.number("M_max", M_max, what, 0, 1)
    if L_max is not None:
        L_max = arguments.positive("L_max", L_max, "a positive number, or None for no bound")
    arguments.choice("structure", structure, ["diagonal", "full"])
    arguments.choice("objective", objective, ["sum", "peak"])
    in_band = _in_band(Q, omega, band, objective)
    n, m, _ = P.shape
    others = np.empty((len(given) - 1, n, m, m), dtype=complex)
    other_models = []
    for k, other in enumerate(given[1:], 1):
        model, response = _response(f"P[{k}]", other, omega, Ts)
        others[k - 1] = arguments.array(f"P[{k}]", response, (n, m, m), complex)
        other_models.append(model)
    radius = _radius(uncertainty, n, m)
    scale = _scale(scale, m)
    if scale is not None:
        units = scale / scale[:, None]
        P, others = P * units, others * units
        plant, *other_models = (_scaled(model, scale) for model in (plant, *other_models))
        if radius is not None and radius.ndim == 3:
            radius = radius * units
    else:
        scale = np.ones(m)
    _refuse_singular(P, omega)
    model = None if plant is None or q is None else (plant, q)
    return Problem(
        P, Q, omega, Ts, order, M_max, L_max, in_band, structure, objective, scale, model,
        others, tuple(other_models), radius,
    )  # fmt: skip


def _plants(P):
    """A list of plants, the nominal one first, from one plant or several."""
    several = isinstance(P, np.ndarray) and P.ndim == 4
    if isinstance(P, list | tuple):
        one = (CurrentTrialLoop, control.FrequencyResponseData, control.LTI)
        several = any(isinstance(p, one) or getattr(p, "ndim", 0) == 3 for p in P)
    return [*P] if several else [P]


def _scaled(model, scale):
    if model is None:
        return None
    S, R = np.diag(scale), np.diag(1 / scale)
    return control.ss(model.A, model.B @ S, R @ model.C, R @ model.D @ S, model.dt)


def _radius(uncertainty, n, m):
    """Radius at each frequency, of the norm or entry by entry; None if it is zero throughout."""
    if uncertainty is None:
        return None
    shape = (n, m, m) if np.ndim(uncertainty) == 3 else (n,)
    radius = arguments.array("uncertainty", uncertainty, shape)
    if radius.min() < 0:
        raise ValueError(
            f"uncertainty reaches {radius.min():.6g}, but a radius cannot be negative: pass the "
            "largest ||Delta|| (or |Delta_ij|) at each frequency"
        )
    return radius if radius.any() else None


def _frequencies(omega, Ts):
    omega = arguments.array("omega", omega, ("frequency",))
    if len(omega) < 2 or not np.all(np.diff(omega) > 0):
        raise ValueError(f"omega, of shape {omega.shape}, must be a row of increasing frequencies")
    nyquist = np.pi / Ts
    if omega[0] < 0 or omega[-1] > nyquist * (1 + 1e-9):
        raise ValueError(
            f"omega spans [{omega[0]:.6g}, {omega[-1]:.6g}] rad/s, but must lie in "
            f"[0, {nyquist:.6g}] rad/s, up to the Nyquist frequency of Ts = {Ts} s"
        )
    return omega


def _response(name, P, omega, Ts):
    """The plant as a model, or None, and its frequency response on omega."""
    if isinstance(P, CurrentTrialLoop):
        P = P.P
    model = None
    if isinstance(P, control.FrequencyResponseData):
        P = _of_frd(name, P, omega)
    elif isinstance(P, control.TransferFunction | control.StateSpace):
        if P.dt != Ts:
            raise ValueError(
                f"{name}.dt = {P.dt!r} differs from Ts = {Ts!r}: sample the model at Ts"
            )
        if isinstance(P, control.StateSpace):
            model = arguments.state_space(name, P)
        elif P.ninputs == P.noutputs == 1:
            model = control.ss(P)
        radius = np.abs(P.poles()).max(initial=0)
        if radius >= 1:
            raise ValueError(
                f"{name} is unstable: it has a pole of modulus {radius:.6g}, 1 or more"
            )
        if model is not None:
            P = frequency_response(model, omega)
        else:
            P = np.moveaxis(np.reshape(P(np.exp(1j * omega * Ts)), (*P.shape, len(omega))), -1, 0)
    return model, arguments.array(name, P, (len(omega), "m", "m"), complex)


def _of_frd(name, P, omega):
    """Samples of python-control's frequency response data, which must be those on omega."""
    same = len(P.omega) == len(omega) and np.allclose(P.omega, omega, rtol=1e-9, atol=0)
    if not same:
        raise ValueError(
            f"{name} is known at {len(P.omega)} frequencies from {P.omega[0]:.6g} to "
            f"{P.omega[-1]:.6g} rad/s, which are not those of omega: pass omega = {name}.omega"
        )
    return np.moveaxis(P.frdata, -1, 0)


def _q_response(Q, omega, Ts):
    """The Q-filter as a model, or None, and its frequency response."""
    model = Q if isinstance(Q, ZeroPhaseButterworth) else None
    if model is not None:
        arguments.one_period(P=Ts, Q=Q.Ts)
        Q = Q.frequency_response(omega)
    Q = arguments.array("Q", Q, (len(omega),), complex)
    return model, Q if Q.imag.any() else Q.real


def _in_band(Q, omega, band, objective):
    """Which frequencies lie in the band; there must be some, and something to learn."""
    low, high = arguments.array("band", band, (2,))
    slack = 1e-9 * omega[-1]
    if not omega[0] - slack <= low < high <= omega[-1] + slack:
        raise ValueError(
            f"band = {band!r} must be two increasing frequencies within omega, "
            f"[{omega[0]:.6g}, {omega[-1]:.6g}] rad/s"
        )
    in_band = (omega >= low) & (omega <= high)
    if not in_band.any():
        raise ValueError(f"band = {band!r} contains none of the frequencies omega")
    learned = np.abs(Q[in_band] if objective == "sum" else Q).max()
    if learned < 1e-6:  # of an error, which the certificate could not tell from nothing
        raise ValueError(
            f"Q has a gain of {learned:.3g} at most where the objective counts: it learns nothing"
        )
    return in_band


def _scale(scale: Sequence[float] | None, m):
    if scale is None:
        return None
    scale = arguments.array("scale", scale, (m,))
    if scale.min() <= 0:
        raise ValueError(f"scale = {scale.tolist()} must be positive, one number per channel")
    return scale


def _refuse_singular(P, omega):
    singular_values = np.linalg.svd(P, compute_uv=False)
    smallest = np.maximum(1e-12 * singular_values[:, 0], 1 / arguments.LARGEST)
    singular = np.flatnonzero(singular_values[:, -1] <= smallest)
    if singular.size:
        raise ValueError(
            f"P is singular at omega = {omega[singular[0]]:.6g} rad/s (smallest singular value "
            f"{singular_values[singular[0], -1]:.3g}): P^-1 in (40) does not exist there"
        )
