"""Are the bounds met between the samples? The peak over all frequencies.

From samples, and within a radius, it is that of a dense grid and of the parabolas through its
crests. For a model it has a proof. No grid is fine enough by itself; what can happen between two
samples must be bounded, and the poles bound it. Let a_1 ... a_n be the eigenvalues of A, and the
poles of the Butterworth filter H if there is Q = |H|^2, which is real; and let

    phi(theta) = sum_j integral from 0 to theta of (1 - |a_j|^2) / |exp(j t) - a_j|^2 dt,

the phase of the all-pass B(z) = prod_j (z - a_j) / (1 - conj(a_j) z). It increases. Let g be the
peak of Q sigma_max, with Q = 1 if there is none, and theta* = omega* Ts where it is attained. Then

    Q sigma_max(theta) >= g cos(phi(theta) - phi(theta*))  if  |phi(theta) - phi(theta*)| <= pi.

*Proof.* Take the unit vectors u, v with Q u* G(theta*) v = g and let T(theta) = Q Re u* G v / g.
Then |T| <= Q sigma_max / g <= 1 everywhere and T(theta*) = 1. Q and Re u* G v are trigonometric
polynomials over the |exp(j theta) - a_j|^2 of their poles, so that T is one of degree n or less
over W(theta) = prod_j |exp(j theta) - a_j|^2, and so is S(theta) = cos(phi(theta) - phi(theta*))
= Re(B(exp(j theta)) / B(exp(j theta*))), and hence D = S - T, which has no more than 2n zeros in a
period unless it is zero throughout. S runs through +1 and -1 in turn at theta* = t_0 < t_1 < ... <
t_2n = t_0 + 2 pi. Because |T| <= 1, D is >= 0 at t_0, t_2, ... and <= 0 at t_1, t_3, ..., so each
of the 2n - 2 intervals [t_1, t_2] ... [t_2n-2, t_2n-1] holds a zero. If it is at an end, T = +1 or
-1 is stationary there, as S is; the zero is double and counts once for each of the two intervals it
belongs to. So is the zero at t_0. These are 2n. If T < S at some place in (t_0, t_1), D > 0 there
and D(t_1) <= 0, which makes one more zero in (t_0, t_1]: contradiction. The other side is the
mirror image. (This is the inequality of Bernstein and Szego for rational functions; see Borwein and
Erdelyi, Mathematika 43 (1996) 413-423. For a finite impulse response of length n + 1, phi = n theta
and it is Riesz's lemma of 1914.)

So if theta* lies between two samples a < b with h = phi(b) - phi(a) < pi / 2, the peak is no higher
than the sinusoid in phi through (0, sigma_max(a)) and (h, sigma_max(b)), or than the higher of the
two if the sinusoid has its crest elsewhere. An interval is dropped once that bound is within the
tolerance of the highest value seen, and halved if not. When none is left, the bound is proven; near
the peak h is then about sqrt(8 tolerance). Real systems have the same singular values at negative
frequencies, so [0, pi / Ts] is enough.

With L = B K of :mod:`ilctools.base` there is no model: B has poles mirrored at the circle, too. On
the circle each is a trigonometric polynomial over |exp(j theta) - a|^2 of a pole a inside, and K,
which looks k samples ahead or back at most, one of degree k, as of k poles at zero. Of a product
the degrees add, and so do the phases.

Values are those of a Schur form of A, whose diagonal holds the poles that the bound uses: the proof
is exact for a system whose matrices differ from the given ones by rounding. What rounding may add
to a peak is no part of it: some 1e-16 over the distance of a pole to the circle, 1e-9 for the
paper's M.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import control
import numpy as np
from scipy.linalg import schur

from ilctools import arguments
from ilctools.evidence.robustness import NEAR, within_radius
from ilctools.filters import LearningFilter, ZeroPhaseButterworth
from ilctools.models import balanced, by_substitution
from ilctools.problem.between import between
from ilctools.problem.problem import Problem, convergence_matrix
from ilctools.singular_values import TIED, largest_singular_values

CLOSE = 1e-8  # relative, of a proven bound: the cost grows like its inverse square root
MOST_POINTS = 2_000_000  # frequencies at which to give up
CHUNK = 2**21  # numbers held at a time while frequency responses are computed
DENSER = 10  # the grid between the samples, against theirs
DENSE = 20  # samples for which a base counts in the grid beyond them


@dataclass(frozen=True)
class Factor:
    """A response at angles omega Ts, shape (k,) to (k, m, m), and its poles within the circle."""

    response: Callable
    poles: np.ndarray


def of_model(system: control.StateSpace) -> Factor:
    """C (z I - A)^-1 B + D, by a Schur form of A."""
    A, B, C = balanced(system.A, system.B, system.C)
    T, Z = schur(A, output="complex")
    model = T, Z.conj().T @ B, C @ Z, system.D

    def response(theta):
        return in_parts(lambda x: by_substitution(*model, np.exp(1j * x)), theta, B.size)

    return Factor(response, np.diag(T))


def of_taps(L: LearningFilter) -> Factor:
    """A finite filter, whose poles are at zero."""
    poles = np.zeros(max(abs(L.first), abs(L.last)))
    return Factor(lambda theta: L.frequency_response(theta / L.Ts), poles)


def of_inverse(base) -> Factor:
    """The base J H*."""
    closed, units = of_model(base.closed), base.scale[:, None] / base.scale

    def response(theta):
        H, J = np.split(closed.response(theta), 2, axis=1)
        return J @ H.conj().swapaxes(1, 2) * units

    return Factor(response, closed.poles)


def factors_of(L: LearningFilter) -> list[Factor]:
    """B, if there is one, and K."""
    base, K = L.base, LearningFilter(L.coefficients, L.Ts, first=L.first)
    if base is None:
        return [of_taps(K)]
    return [of_taps(base) if isinstance(base, LearningFilter) else of_inverse(base), of_taps(K)]


def peak_of_L(L: LearningFilter) -> tuple[float, float]:
    """Peak over all frequencies of sigma_max(L), and where it is."""
    return proven_peak(factors_of(L), L.Ts)


def peak_of_M(P: control.StateSpace, L: LearningFilter, Q) -> tuple[float, float]:
    """Peak over all frequencies of sigma_max(M), and where it is."""
    return proven_peak([of_model(P), *factors_of(L)], L.Ts, Q, of_M=True)


def proven_peak(
    factors: list[Factor], Ts: float, Q: ZeroPhaseButterworth | None = None, of_M=False
) -> tuple[float, float]:
    """Peak over all frequencies of Q sigma_max(G), an upper bound, and where it is, rad/s.

    G is the product of the factors; of M, the identity less it. The bound is CLOSE to the peak.
    """
    # Q is not made a part of a system: the poles of a filter of high order with a low cut-off lie
    # so close together that a Schur form tears them apart.
    poles = np.concatenate([factor.poles for factor in factors] + ([] if Q is None else [Q.poles]))
    arguments.stable("system", poles)

    def nodes(theta):
        G = factors[0].response(theta)
        for factor in factors[1:]:
            G = G @ factor.response(theta)
        sigma = largest_singular_values(np.eye(G.shape[1]) - G if of_M else G)
        if Q is not None:
            sigma = sigma * Q.frequency_response(theta / Ts)
        return np.stack([theta, sigma, phase(poles, theta)])

    points = nodes(np.linspace(0, np.pi, 4 * len(poles) + 2))
    place, peak, _ = points[:, points[1].argmax()]
    left, right = points[:, :-1], points[:, 1:]
    bound, count = peak, points.shape[1]
    while True:
        highest = ceiling(left[1], right[1], right[2] - left[2])
        high = highest > peak * (1 + CLOSE)
        bound = max(bound, highest[~high].max(initial=0))
        if not high.any():
            return float(bound), float(place / Ts)
        left, right = left[:, high], right[:, high]
        middle = (left[0] + right[0]) / 2
        count += middle.size
        if count > MOST_POINTS or np.any((middle == left[0]) | (middle == right[0])):
            raise RuntimeError(
                f"the peak gain is between {peak:.12g} and {highest.max():.12g}; to close in "
                f"further takes more than {MOST_POINTS} frequencies"
            )
        middle = nodes(middle)
        best = middle[:, middle[1].argmax()]
        if best[1] > peak:
            place, peak, _ = best
        left, right = np.hstack([left, middle]), np.hstack([middle, right])


def ceiling(a, b, h):
    """Highest peak that a curve through a and b, a phase h apart, can have in between."""
    with np.errstate(divide="ignore", invalid="ignore"):
        crest = np.hypot(a - b, 2 * np.sqrt(a) * np.sqrt(b) * np.sin(h / 2)) / np.sin(h)
    inside = np.minimum(a, b) > np.maximum(a, b) * np.cos(h)
    return np.where(h < np.pi / 2, np.where(inside, crest, np.maximum(a, b)), np.inf)


def phase(poles, theta):
    """Phase phi of the all-pass with these poles, shape of theta."""
    others = poles[poles != 0]  # a pole at zero, as of each tap, adds theta alone
    r, angle = np.abs(others)[:, None], np.angle(others)[:, None]
    shift = theta - angle
    # 1 - r cos(shift), without cancellation for poles next to the circle
    real = (1 - r) + 2 * r * np.sin(shift / 2) ** 2
    return len(poles) * theta + 2 * np.arctan(r * np.sin(shift) / real).sum(axis=0)


def in_parts(function, points, size):
    """Its values at the points: so many at a time as memory admits, `size` numbers for each."""
    parts = np.array_split(points, 1 + len(points) * size // CHUNK)
    return np.concatenate([function(part) for part in parts])


@dataclass(frozen=True)
class Peak:
    """The highest peak of sigma_max(M) over all frequencies among some plants of a problem."""

    sigma: float  # an upper bound to 1e-8 if proven
    omega: float  # where it is, rad/s
    plant: int  # whose it is; of those that are tied, the first


def proven_peaks(problem: Problem, L) -> list[Peak]:
    """Of the plants that are models, proven; none if Q is not one."""
    Q = problem.butterworth
    if Q is None:
        return []
    models = [(k, model) for k, model in enumerate(problem.models) if model is not None]
    return [Peak(*peak_of_M(model, L, Q), k) for k, model in models]


def unproven(problem: Problem) -> list[int]:
    """Plants that have no proof between the frequencies: samples, and all if there is a radius."""
    if problem.butterworth is None or problem.design.radius is not None:
        return list(range(len(problem.plants)))
    return [k for k, model in enumerate(problem.models) if model is None]


def estimated_peaks(problem: Problem, L, level) -> list[Peak]:
    """Of these, between the frequencies and within the radius; those below a level only bounded."""
    return [
        Peak(float(sigma.max()), float(omega[sigma.argmax()]), k)
        for k, omega, sigma in crests(problem, L, level)
    ]


def crests(problem, L, level):
    """Where between the frequencies sigma_max(M) is highest, of each plant that has no proof.

    Yields its number, frequencies and values: all crests near the level, or above, and the highest.
    """
    dense = None  # one for all samples
    for k in unproven(problem):
        model = problem.models[k]
        if dense is None or model is not None:
            dense = dense_grid(problem, k, L)
            response = in_parts(L.frequency_response, dense, 4 * L.order)  # in long doubles

        def sigma_M(omega, response, k=k):
            P, Q, radius = between(problem, k, omega)
            rho_L = None if radius is None else (np.abs(Q) * radius)[:, None, None] * response
            return within_radius(convergence_matrix(P, Q, response), rho_L, level)

        sigma = sigma_M(dense, response)
        top = np.array(vertices(dense, sigma, NEAR * level))
        more = sigma_M(top, L.frequency_response(top)) if len(top) else top
        highest = sigma.argmax()
        yield k, np.append(top, dense[highest]), np.append(more, sigma[highest])
        dense = dense if model is None else None


def vertices(omega, sigma, limit) -> list[float]:
    """Where the parabola through three samples, of which the middle one is highest, passes it."""
    a, b, c = omega[:-2], omega[1:-1], omega[2:]
    x, y, z = sigma[:-2], sigma[1:-1], sigma[2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        left, right = (y - x) / (b - a), (z - y) / (c - b)
        curvature = (left - right) / (c - a)
        slope = (left * (c - b) + right * (b - a)) / (c - a)
        top = y + slope**2 / (4 * curvature)
        place = b + slope / (2 * curvature)
    crest = (y >= np.maximum(x, z)) & (curvature > 0) & (top > limit)
    return place[crest].tolist()


def dense_grid(problem, number, L, times=DENSER) -> np.ndarray:
    """Some frequencies for each of a design, and those that resolve the poles of L and a model."""
    known, model = problem.design.omega, problem.models[number]
    steps = np.linspace(0, 1, times, endpoint=False)
    samples = np.append((known[:-1, None] + np.outer(np.diff(known), steps)).ravel(), known[-1])
    poles = [factor.poles for factor in factors_of(L)] + ([] if model is None else [model.poles()])
    further = np.concatenate([_resolved(each) for each in poles]) / problem.Ts
    return np.union1d(samples, further[(further > known[0]) & (further < known[-1])])


def _resolved(poles):
    """Angles close enough to resolve a response with these poles."""
    r, angle = np.abs(poles), np.abs(np.angle(poles))
    turns = np.linspace(0, np.pi, DENSER * np.count_nonzero(r < 0.5) + 1)
    bends = angle[r >= 0.5] + np.outer(np.tan(np.linspace(-1.5, 1.5, 61)), 1 - r[r >= 0.5])
    return np.append(turns, bends)


def peak_beyond(problem: Problem, L) -> Peak | None:
    """The highest above the last sample of P, of any phase and assumed size; None if P is known."""
    if problem.beyond is None:
        return None
    first, nyquist = problem.design.omega[-1], np.pi / problem.Ts
    omega = np.linspace(first, nyquist, 1 + 64 * (L.order + DENSE * (L.base is not None)))
    sigma_L = largest_singular_values(L.frequency_response(omega))
    sigma_M = problem.Q_beyond(omega) * (1 + problem.beyond * sigma_L)
    at = sigma_M.argmax()
    return Peak(float(sigma_M[at]), float(omega[at]), 0)


def highest(peaks: list[Peak]) -> Peak | None:
    """The highest of some peaks, if any; of those that are tied, that of the first plant."""
    if not peaks:
        return None
    sigma = max(peak.sigma for peak in peaks)
    level = [peak for peak in peaks if peak.sigma >= sigma * (1 - TIED)]
    return replace(min(level, key=lambda peak: peak.plant), sigma=sigma)
