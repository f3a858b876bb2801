"""Are the bounds met between the samples? The peak over all frequencies.

From samples, and within a radius, it is that of a dense grid, with a zoom into its crests. For a
model it has a proof. No grid is fine enough by itself; what can happen between two samples must be
bounded, and the poles bound it. Let a_1 ... a_n be the eigenvalues of A, and the poles of the
Butterworth filter H if there is Q = |H|^2, which is real; and let

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

Rounding: the values are those of a Schur form of A, whose diagonal holds the very poles that the
bound uses. The proof is therefore exact for a system whose matrices differ from the given ones by
rounding. Where that matters most, at the peak and at the angles of the poles closest to the circle,
the gain is computed once more from A itself, with a bound of its error: if R approximates
(z I - A)^-1 and leaves the residual S = I - (z I - A) R, then

    C (z I - A)^-1 B = C R B + C R (S + S^2 + ...) B.

What this adds to the peak is added to the gain, 1e-9 of it or less for the paper's M.
"""

from dataclasses import dataclass, replace

import control
import numpy as np
from scipy.linalg import schur
from scipy.optimize import elementwise

from ilctools import arguments
from ilctools.evidence.robustness import NEAR, within_radius
from ilctools.filters import LearningFilter, ZeroPhaseButterworth
from ilctools.models import balanced, by_substitution
from ilctools.problem.between import between, missed
from ilctools.problem.problem import TIED, Problem, convergence_matrix, largest_singular_values

MOST_POINTS = 2_000_000  # frequencies at which to give up
CHUNK = 2**21  # numbers held at a time while frequency responses are computed
CLOSEST = 20  # poles next to the unit circle at which rounding is looked into
DENSER = 10  # the grid between the samples, against theirs
DENSE = 20  # samples for which a base counts in the grid beyond them
MOST_CRESTS = 100  # the highest, into which is zoomed


def peak_gain(
    system: control.StateSpace, Q: ZeroPhaseButterworth | None = None, tolerance: float = 1e-8
) -> tuple[float, float]:
    """Peak over all frequencies of Q sigma_max, as an upper bound with a proof, and where it is."""
    # Q is not made a part of the system: the poles of a filter of high order with a low cut-off lie
    # so close together that a Schur form tears them apart. The gain is at least the supremum, and
    # above (1 + tolerance) times it only by a bound of the rounding error; the cost grows like the
    # inverse square root of the tolerance, unless sigma_max is nearly equal to its peak over a wide
    # range, as of an all-pass filter.
    if system.nstates == 0:  # and Q is one at zero
        return float(np.linalg.norm(system.D, 2)), 0.0
    gain = _Through([_Model(system)], Q)
    return proven_peak(gain, system.dt, tolerance)


def proven_peak(gain: "_Through", Ts: float, tolerance: float = 1e-8) -> tuple[float, float]:
    """Peak over all frequencies of a gain, and where it is."""
    poles = gain.poles
    radius = arguments.stable("system", poles)

    def nodes(theta):
        return np.stack([theta, gain(theta), _phase(poles, theta)])

    points = nodes(np.linspace(0, np.pi, 4 * len(poles) + 1))
    place, peak, _ = points[:, points[1].argmax()]
    left, right = points[:, :-1], points[:, 1:]
    bound, count = peak, points.shape[1]
    while True:
        ceiling = _ceiling(left[1], right[1], right[2] - left[2])
        high = ceiling > peak * (1 + tolerance)
        bound = max(bound, ceiling[~high].max(initial=0))
        if not high.any():
            break
        left, right = left[:, high], right[:, high]
        middle = (left[0] + right[0]) / 2
        count += middle.size
        if count > MOST_POINTS or np.any((middle == left[0]) | (middle == right[0])):
            raise RuntimeError(
                f"the peak gain is between {peak:.12g} and {ceiling.max():.12g}; to close in "
                f"further takes more than {MOST_POINTS} frequencies"
            )
        middle = nodes(middle)
        best = middle[:, middle[1].argmax()]
        if best[1] > peak:
            place, peak, _ = best
        left, right = np.hstack([left, middle]), np.hstack([middle, right])

    closest = poles[np.argsort(-np.abs(poles))][:CLOSEST]
    angles = {place, *np.abs(np.angle(closest))}
    highest = max(gain.rounded_up(theta) for theta in angles)
    if highest == np.inf:
        raise RuntimeError(
            f"the peak gain, {peak:.6g} as computed, is not proven: system has a pole of "
            f"modulus {radius:.17g}, which rounding could make unstable"
        )
    bound += max(highest - peak, 0)
    return float(bound), float(place / Ts)


def _ceiling(a, b, h):
    """Highest peak that a curve through a and b, a phase h apart, can have in between."""
    with np.errstate(divide="ignore", invalid="ignore"):
        crest = np.hypot(a - b, 2 * np.sqrt(a) * np.sqrt(b) * np.sin(h / 2)) / np.sin(h)
    inside = np.minimum(a, b) > np.maximum(a, b) * np.cos(h)
    return np.where(h < np.pi / 2, np.where(inside, crest, np.maximum(a, b)), np.inf)


def _phase(poles, theta):
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


class _Model:
    """The response of a model at angles omega Ts, and a bound of its rounding error."""

    def __init__(self, system):
        self.matrices = *balanced(system.A, system.B, system.C), system.D
        A, B, C, self.D = self.matrices
        self.T, Z = schur(A, output="complex")
        self.B, self.C = Z.conj().T @ B, C @ Z
        self.poles = np.diag(self.T)

    def __call__(self, theta):
        model = self.T, self.B, self.C, self.D
        return in_parts(lambda x: by_substitution(*model, np.exp(1j * x)), theta, self.B.size)

    def with_error(self, theta):
        return _with_error(*self.matrices, theta)


class _Taps:
    """The same of a finite filter, whose poles are at zero."""

    def __init__(self, L):
        self.L = L
        self.poles = np.zeros(max(abs(L.first), abs(L.last)))

    def __call__(self, theta):
        return self.L.frequency_response(theta / self.L.Ts)

    def with_error(self, theta):
        size = np.linalg.norm(np.abs(self.L.coefficients).sum(axis=2), 2)
        steps = 2 + max(abs(self.L.first), abs(self.L.last))  # the rounding of angles, too
        return self(np.array([theta]))[0], 4 * steps * np.finfo(float).eps * size


class _Inverse:
    """The same of a base, J H*."""

    def __init__(self, base):
        self.factors, self.units = _Model(base.closed), base.scale[:, None] / base.scale
        self.poles = self.factors.poles

    def __call__(self, theta):
        H, J = np.split(self.factors(theta), 2, axis=1)
        return J @ H.conj().swapaxes(1, 2) * self.units

    def with_error(self, theta):
        factors, error = self.factors.with_error(theta)
        H, J = np.split(factors, 2)
        B, error = _product((J, error), (H.conj().T, error))
        return B * self.units, error * self.units.max()


def _product(first, second):
    """Of two matrices, each with a bound of its error."""
    (X, x), (Y, y) = first, second
    a, b = np.linalg.norm(X, 2), np.linalg.norm(Y, 2)
    return X @ Y, x * b + a * y + x * y + 10 * len(X) * np.finfo(float).eps * a * b


class _Through:
    """Q sigma_max of a product of responses, or of the identity less it, at angles omega Ts."""

    def __init__(self, factors, Q=None, less=False):
        self.factors, self.Q, self.less = factors, Q, less
        poles = [factor.poles for factor in factors]
        self.poles = np.concatenate(poles if Q is None else [*poles, Q.poles])

    def __call__(self, theta):
        G = self.factors[0](theta)
        for factor in self.factors[1:]:
            G = G @ factor(theta)
        sigma = largest_singular_values(np.eye(G.shape[1]) - G if self.less else G)
        return sigma if self.Q is None else sigma * self.Q.frequency_response(theta / self.Q.Ts)

    def rounded_up(self, theta):
        """Upper bound at one angle whatever the rounding."""
        G, error = self.factors[0].with_error(theta)
        for factor in self.factors[1:]:
            G, error = _product((G, error), factor.with_error(theta))
        G = np.eye(len(G)) - G if self.less else G
        return (np.linalg.norm(G, 2) + error) * _filter_rounded_up(self.Q, theta)


def _factors_of(L):
    """B, if there is one, and K."""
    if L.base is None:
        return [_Taps(L)]
    base = L.base
    K = LearningFilter(L.coefficients, L.Ts, first=L.first)
    return [_Taps(base) if isinstance(base, LearningFilter) else _Inverse(base), _Taps(K)]


def peak_of_L(L: LearningFilter) -> tuple[float, float]:
    """Peak over all frequencies of sigma_max(L), and where it is."""
    if L.base is None:
        return peak_gain(learning_model(L))
    return proven_peak(_Through(_factors_of(L)), L.Ts)


def peak_of_M(P: control.StateSpace, L: LearningFilter, Q) -> tuple[float, float]:
    """Peak over all frequencies of sigma_max(M), and where it is."""
    if L.base is None and L.first == 1:
        return peak_gain(error_model(P, L), Q)
    return proven_peak(_Through([_Model(P), *_factors_of(L)], Q, less=True), L.Ts)


def _with_error(A, B, C, D, theta):
    """The response at one angle, and a bound of its error whatever the rounding."""
    unit, z = (len(A) + 2) * np.finfo(float).eps, np.exp(1j * theta)
    identity = np.eye(len(A))
    R = np.linalg.inv(z * identity - A)
    CR = C @ R
    a, b, c, d, r, cr = (np.abs(X) for X in (A, B, C, D, R, CR))
    S = np.abs(identity - (z * R - A @ R)) + unit * (identity + r + a @ r)
    size = np.linalg.norm(S)
    if not size < 1:
        return CR @ B + D, np.inf
    first = cr @ S @ b + unit * (c @ r @ b + d)
    further = cr.sum() * size**2 / (1 - size) * b.sum()
    return CR @ B + D, np.linalg.norm(first, 2) + further


def _filter_rounded_up(Q, theta):
    """Upper bound of Q at one angle whatever the rounding; one if there is none."""
    if Q is None:
        return 1.0
    # numerator and denominator of each section
    polynomials = Q.sections.reshape(-1, 2, 3)
    value = np.abs(polynomials @ np.exp(-1j * theta * np.arange(3)))
    error = 10 * np.finfo(float).eps * np.abs(polynomials).sum(axis=-1)
    most, least = (value + error)[:, 0], (value - error)[:, 1]
    return np.prod(most / least) ** 2 if least.min() > 0 else np.inf


def learning_model(L: LearningFilter) -> control.StateSpace:
    """Causal model of z^-n_L L(z), whose singular values are those of L of (44)."""
    # y(p) = c_nL e(p) + ... + c_1 e(p - nL + 1), with m (n_L - 1) states e(p - 1), e(p - 2) ...
    # A delay has gain one at every frequency, so it changes no singular value.
    m, states = L.channels, L.channels * (L.order - 1)
    newest_first = np.hstack(np.moveaxis(L.coefficients, 2, 0)[::-1])
    A, B = np.eye(states, k=-m), np.eye(states, m)
    return control.ss(A, B, newest_first[:, m:], newest_first[:, :m], L.Ts)


def error_model(P: control.StateSpace, L: LearningFilter) -> control.StateSpace:
    """Causal model of z^-n_L (I - P L): |Q| times its singular values are those of M of (40)."""
    m, n, chain = L.channels, P.nstates, L.channels * L.order
    # The taps of z^-n_L L and the delay of the direct path share a chain, e(p-1) ... e(p-n_L).
    taps = learning_model(L)
    taps_C = np.hstack([taps.C, np.zeros((m, m))])
    shift, delay_C = np.eye(chain, k=-m), np.eye(m, chain, k=chain - m)
    A = np.block([[shift, np.zeros((chain, n))], [P.B @ taps_C, P.A]])
    B = np.vstack([np.eye(chain, m), P.B @ taps.D])
    C = np.hstack([delay_C - P.D @ taps_C, -P.C])
    return control.ss(A, B, C, -P.D @ taps.D, L.Ts)


@dataclass(frozen=True)
class Peak:
    """The highest peak of sigma_max(M) over all frequencies among some plants of a problem."""

    sigma: float  # an upper bound to 1e-8 if proven
    omega: float  # where it is, rad/s
    plant: int  # whose it is; of those that are tied, the first
    # the largest error of splines of M in cross-validation; NaN if proven
    missed: float = np.nan


def proven_peaks(problem: Problem, L) -> list[Peak]:
    """Of the plants that are models, proven; none if Q is not one."""
    Q = problem.butterworth
    if Q is None:
        return []
    models = [(k, model) for k, model in enumerate(problem.models) if model is not None]
    return [Peak(*peak_of_M(model, L, Q), k) for k, model in models]


def unproven(problem: Problem) -> list[int]:
    """Plants that have no proof between the frequencies: samples, and all if there is a radius."""
    if problem.butterworth is None or problem.radius is not None:
        return list(range(len(problem.plants)))
    return [k for k, model in enumerate(problem.models) if model is None]


def estimated_peaks(problem: Problem, L, level) -> list[Peak]:
    """Of these, between the frequencies and within the radius; those below a level only bounded."""
    design, estimates = problem.design, []
    on_grid = L.frequency_response(design.omega)
    for k, omega, sigma in crests(problem, L, level):
        off = np.nan
        if problem.butterworth is None or problem.models[k] is None:
            known = design.plants[k], design.Q, design.omega, on_grid, design.axis
            off = missed(*known, 0 if design.radius is None else design.radius)
        estimates.append(Peak(sigma.max(), omega[sigma.argmax()], k, off))
    return estimates


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

        def fall(omega, response=None, k=k):
            """- sigma_max(M)."""
            if not len(omega):
                return omega
            response = L.frequency_response(omega) if response is None else response
            P, Q, radius = between(problem, k, omega)
            rho_L = None if radius is None else (np.abs(Q) * radius)[:, None, None] * response
            return -within_radius(convergence_matrix(P, Q, response), rho_L, level)

        sigma = -fall(dense, response)
        inner, beside = sigma[1:-1], np.maximum(sigma[:-2], sigma[2:])
        top = 1 + np.flatnonzero((inner >= NEAR * level) & (inner >= beside))
        top = top[np.argsort(-sigma[top])][:MOST_CRESTS]
        brackets = dense[top - 1], dense[top], dense[top + 1]
        found, at = elementwise.find_minimum(fall, brackets), np.append(top, sigma.argmax())
        yield k, np.append(dense[at], found.x), np.append(sigma[at], -found.f_x)
        dense = dense if model is None else None


def dense_grid(problem, number, L, times=DENSER) -> np.ndarray:
    """Some frequencies for each of a design, and those that resolve the poles of L and a model."""
    known, model = problem.design.omega, problem.models[number]
    steps = np.linspace(0, 1, times, endpoint=False)
    samples = np.append((known[:-1, None] + np.outer(np.diff(known), steps)).ravel(), known[-1])
    poles = [factor.poles for factor in _factors_of(L)] + ([] if model is None else [model.poles()])
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
    """The highest of some peaks, if any, and the most that splines miss for any of them."""
    if not peaks:
        return None
    sigma = max(peak.sigma for peak in peaks)
    missed = np.fmax.reduce([peak.missed for peak in peaks])
    level = [peak for peak in peaks if peak.sigma >= sigma * (1 - TIED)]
    first = min(level, key=lambda peak: peak.plant)
    return replace(first, sigma=sigma, missed=missed)
