"""What is asked of the learning filter: the problems (39), (45), (46) as one checked object.

:func:`pose` states a problem and checks it; solvers and evidence take it whole. Frequency responses
have the frequency first. The channels of P, L and M are in units of `scale`, so that singular
values compare what counts as equally large.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import control
import numpy as np

from rodlib import arguments
from rodlib.feedback import CurrentTrialLoop, frequency_response
from rodlib.filters import LearningFilter, ZeroPhaseButterworth

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

    def value(self, sigma_M) -> float:
        """The objective, from the largest singular value of M at each frequency."""
        return float(sigma_M[self.in_band].sum() if self.objective == "sum" else sigma_M.max())

    def M(self, L) -> np.ndarray:
        """M of (40) from the frequency response of L."""
        return convergence_matrix(self.P, self.Q, L)

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
class Solution:
    """A learning filter, and the multipliers from which its optimality can be proven.

    Attributes
    ----------
    coefficients : ndarray, shape (m, m, order)
        L(z) = sum_k coefficients[:, :, k - 1] z^k, in units of `scale`.
    U, V : ndarray, shape (n, m, m), complex
        Multipliers of M and of L.
    peak : float
        Largest sigma_max(M); of W L, for the least gain.
    method : str
        That found it.
    iterations : int
    """

    coefficients: np.ndarray
    U: np.ndarray
    V: np.ndarray
    peak: float
    method: str
    iterations: int


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
) -> Problem:
    """State the problem (39), or (45) with (46), and check it.

    Parameters and errors as for :func:`rodlib.synthesise`.

    Returns
    -------
    Problem
    """
    Ts = arguments.sampling_period("Ts", Ts)
    omega = _frequencies(omega, Ts)
    plant, P = _response("P", P, omega, Ts)
    q, Q = _q_response(Q, omega, Ts)
    order = arguments.whole("order", order, 1, len(omega))
    what = "in (0, 1), or the trials do not converge"
    M_max = arguments.number("M_max", M_max, what, 0, 1)
    if L_max is not None:
        L_max = arguments.positive("L_max", L_max, "a positive number, or None for no bound")
    arguments.choice("structure", structure, ["diagonal", "full"])
    arguments.choice("objective", objective, ["sum", "peak"])
    in_band = _in_band(Q, omega, band, objective)
    scale = _scale(scale, P.shape[1])
    if scale is not None:
        P = P * scale / scale[:, None]
        if plant is not None:
            S, R = np.diag(scale), np.diag(1 / scale)
            plant = control.ss(plant.A, plant.B @ S, R @ plant.C, R @ plant.D @ S, plant.dt)
    else:
        scale = np.ones(P.shape[1])
    _refuse_singular(P, omega)
    model = None if plant is None or q is None else (plant, q)
    return Problem(
        P, Q, omega, Ts, order, M_max, L_max, in_band, structure, objective, scale, model
    )


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
