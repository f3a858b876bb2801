"""H-infinity synthesis with finite preview, by one Riccati equation in discrete time."""

import control
import numpy as np
from scipy.linalg import LinAlgError, block_diag, schur, solve_discrete_are
from scipy.signal import tf2ss

from ilctools import arguments
from ilctools.alternatives.inversion import square
from ilctools.alternatives.two_sided import TwoSidedFilter
from ilctools.filters import ZeroPhaseButterworth
from ilctools.models import by_substitution
from ilctools.signals import check_match

ROUNDING = 1e-9  # relative, of the solution of the Riccati equation


def h_infinity(
    P: control.StateSpace,
    Q: ZeroPhaseButterworth,
    level: float,
    effort: float,
    preview: int = 10,
    emphasis: float = 1.0,
    corner: float | None = None,
) -> TwoSidedFilter:
    """L(z) = z^preview K(z) with a causal K such that, at all frequencies,

        sigma_max([W Q (I - P L); effort L]) < level.

    The gain of L is bought with a weight, as in the paper's [9], [11], and speed in a band with
    another one, W, as in [12], [13]: a lag that is `emphasis` below `corner` and one far above.

    Parameters
    ----------
    P : control.StateSpace
        In discrete time, m inputs and m outputs, stable.
    Q : ZeroPhaseButterworth
        Enters as the square of the causal Butterworth filter, which has its magnitude.
    level : float
        Above zero, a bound on the rate of convergence. If none reaches it, a ValueError says so.
    effort : float
        Above zero, unit of y per unit of w.
    preview : int
        Samples by which L looks ahead, one or more.
    emphasis : float
        One or more.
    corner : float, optional
        rad/s, below the Nyquist frequency; needed if `emphasis` is not one.

    Notes
    -----
    K sees the disturbance of the generalised plant, e, and so its state: the problem is one of full
    information, with a single Riccati equation of indefinite weight, and K has as many states as
    the generalised plant. P. A. Iglesias and K. Glover, State-space approach to discrete-time
    H-infinity control, International Journal of Control 54 (1991) 1031-1073. The smallest level is
    that of python-control's ``hinfsyn`` after a bilinear transform, where that reaches what it
    claims (tested); it needs slycot, and took more than a hundred times as long for the rod.
    """
    plant = generalised_plant(P, Q, effort, preview, emphasis, corner)
    m, Ts = P.noutputs, P.dt
    K = full_information(plant, m, level)

    T, U = schur(K.A, output="complex")
    triangular = T, U.conj().T @ K.B, K.C @ U, K.D

    def response(omega):
        z = np.exp(1j * omega * Ts)
        return z[:, None, None] ** preview * by_substitution(*triangular, z)

    return TwoSidedFilter(response, m, Ts)


def generalised_plant(P, Q, effort, preview, emphasis=1.0, corner=None) -> control.StateSpace:
    """From e, `preview` samples early, and u = K e to [W Q (z^-preview e - P u); effort u].

    Parameters as for :func:`h_infinity`.
    """
    m, Ts = square(P)
    arguments.instance("Q", Q, ZeroPhaseButterworth)
    check_match(P=P, Q=Q)
    effort = arguments.positive("effort", effort)
    preview = arguments.whole("preview", preview, 1)
    emphasis = arguments.number("emphasis", emphasis, "one or more", least=1)
    if emphasis > 1 and corner is None:
        raise ValueError(f"emphasis = {emphasis} must be one, or more with a corner in rad/s")
    if corner is not None:
        corner = arguments.number("corner", corner, "in (0, Nyquist)", 0, np.pi / Ts)
    delay_A, delay_B = np.eye(m * preview, k=-m), np.eye(m * preview, m)
    delay_C = np.eye(m, m * preview, k=m * (preview - 1))
    A, B = block_diag(delay_A, P.A), block_diag(delay_B, P.B)
    D = np.hstack([np.zeros((m, m)), -P.D])
    plant = control.ss(A, B, np.hstack([delay_C, -P.C]), D, Ts)
    weights = [(s[:3], s[3:]) for s in [*Q.sections, *Q.sections]]
    if emphasis > 1:
        a = np.tan(corner * Ts / 2)
        weights.append(([1 + emphasis * a, emphasis * a - 1], [1 + a, a - 1]))
    for numerator, denominator in weights:
        A, B, C, D = (np.kron(np.eye(m), X) for X in tf2ss(numerator, denominator))
        plant = control.ss(A, B, C, D, Ts) * plant
    C = np.vstack([plant.C, np.zeros((m, plant.nstates))])
    D = np.vstack([plant.D, np.hstack([np.zeros((m, m)), effort * np.eye(m)])])
    return control.ss(plant.A, plant.B, C, D, Ts)


def full_information(plant: control.StateSpace, m: int, level: float) -> control.StateSpace:
    """K of u = K w that keeps what a plant makes of its disturbance below a level.

    Parameters
    ----------
    plant : control.StateSpace
        In discrete time; m inputs w, known when u is chosen, then u.
    m : int
    level : float
        Bound on the largest singular value from w, at all frequencies. If no K reaches it, a
        ValueError says so.
    """
    arguments.state_space("plant", plant)
    m = arguments.whole("m", m, 1, plant.ninputs - 1)
    level = arguments.positive("level", level)
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    R = D.T @ D - np.diag([level**2] * m + [0.0] * (plant.ninputs - m))
    refusal = (
        f"level = {level:.6g} is not reached by any filter: raise it, or preview, or lower effort"
    )
    try:
        X = solve_discrete_are(A, B, C.T @ C, R, s=C.T @ D)
    except (LinAlgError, ValueError):
        raise ValueError(refusal) from None
    R, S = R + B.T @ X @ B, B.T @ X @ A + D.T @ C
    R_w, R_wu, R_uw, R_u = R[:m, :m], R[:m, m:], R[m:, :m], R[m:, m:]
    F, G = np.linalg.solve(R_u, S[m:]), np.linalg.solve(R_u, R_uw)
    B_w, B_u = B[:, :m], B[:, m:]
    K = control.ss(A - B_u @ F, B_w - B_u @ G, -F, -G, plant.dt)
    schur_complement = R_w - R_wu @ G
    u_minimises = np.linalg.eigvalsh(R_u).min() > 0
    w_maximises = np.linalg.eigvalsh(schur_complement).max() < 0
    stable = np.abs(np.linalg.eigvals(K.A)).max() < 1
    energy = np.linalg.eigvalsh(X)  # of a state: not negative
    positive = energy[0] > -ROUNDING * energy[-1]
    if not (u_minimises and w_maximises and stable and positive):
        raise ValueError(refusal)
    return K
