"""Are the bounds also met between the design frequencies? The peak over all frequencies.

The peak is the largest sigma_max(M) or sigma_max(L) over frequency. If P is known by samples, or
within a radius, the peak is estimated by the largest value on a dense grid and between its points.
Between the points, a parabola through three points gives the top of a local maximum, here called a
crest.

If P is a model, an upper bound on the peak is proved, because the poles of a system limit how much
its response can rise between two frequencies. Let G(theta) = C (exp(j theta) I - A)^-1 B + D be the
response of the system. Let a_1 ... a_n be the eigenvalues of A. If G is multiplied by a real
Q = |H|^2 with a Butterworth filter H, the poles of H are counted among a_1 ... a_n. Let

    phi(theta) = sum_j integral from 0 to theta of (1 - |a_j|^2) / |exp(j t) - a_j|^2 dt,

the phase of the all-pass B(z) = prod_j (z - a_j) / (1 - conj(a_j) z). This phase increases with
theta. Let g be the peak of Q sigma_max(G), with Q = 1 if there is no Q. Let theta* = omega* Ts be
the angle at which the peak is attained. Then

    Q sigma_max(theta) >= g cos(phi(theta) - phi(theta*))  if  |phi(theta) - phi(theta*)| <= pi.

*Proof.* Take the unit vectors u, v with Q u* G(theta*) v = g and let T(theta) = Q Re u* G v / g.
Then |T| <= Q sigma_max(G) / g <= 1 everywhere, and T(theta*) = 1. Let W(theta) = prod_j |exp(j
theta) - a_j|^2. Q and Re u* G v are trigonometric polynomials over the factors |exp(j theta) -
a_j|^2 of their poles. T is therefore a trigonometric polynomial of degree n or less over W.
S(theta) = cos(phi(theta) - phi(theta*)) = Re(B(exp(j theta)) / B(exp(j theta*))) has the same form,
and so has D = S - T. D has no more than 2n zeros in a period, unless D is zero throughout. S takes
the values +1 and -1 in turn at theta* = t_0 < t_1 < ... < t_2n = t_0 + 2 pi. Because |T| <= 1, D is
>= 0 at t_0, t_2, ... and <= 0 at t_1, t_3, .... Each of the 2n - 2 intervals [t_1, t_2] ...
[t_2n-2, t_2n-1] therefore contains a zero of D. If the zero is at an end of an interval, T = +1 or
-1 is stationary there, as S is. The zero is then double, and counts once for each of its two
intervals. The zero at t_0 is double, too. Together these are 2n zeros. Now suppose that T < S at
some angle in (t_0, t_1). Then D > 0 there and D(t_1) <= 0, which makes one more zero in (t_0, t_1]:
a contradiction. The proof for (t_2n-1, t_2n) is the mirror image. (The theorem is the inequality of
Bernstein and Szego for rational functions; see Borwein and Erdelyi, Mathematika 43 (1996) 413-423.
For a finite impulse response of length n + 1, phi = n theta, and the theorem is Riesz's lemma of
1914.)

Let a and b be two neighbouring angles of a grid, with phi(b) - phi(a) = h < pi. If theta* lies
between a and b, phi(theta*) differs by at most h / 2 from phi(a) or from phi(b). The peak is then
at most max(sigma(a), sigma(b)) / cos(h / 2), with sigma = Q sigma_max(G). The values on a grid
therefore prove an upper bound on the peak. Real systems have the same singular values at negative
frequencies, so that the frequencies in [0, pi / Ts] are enough.

The filter L = B K of :mod:`ilctools.base` is not a causal model. B also has poles outside the unit
circle, which are its inner poles mirrored at the circle. On the circle, each factor of B is a
trigonometric polynomial over |exp(j theta) - a|^2, with a pole a inside the circle. K uses at most
k samples ahead or back. K is therefore a trigonometric polynomial of degree k, and counts as k
poles at zero. In a product of systems, the degrees and the phases of the systems add.

The responses are computed from a Schur form of A, whose diagonal contains the poles that the bound
uses. The proof is exact for a system whose matrices differ from the given matrices by rounding. The
proof does not include how much this rounding may change a peak. The change is about 1e-16 divided
by the distance of a pole from the circle, or 1e-9 for the paper's M.
"""

from dataclasses import dataclass, replace
from functools import partial

import control
import numpy as np
from scipy.signal import find_peaks

from ilctools import arguments
from ilctools.evidence.robustness import NEAR_LEVEL, within_radius
from ilctools.filters import LONG, LearningFilter, ZeroPhaseButterworth
from ilctools.models import frequency_response, schur_form
from ilctools.problem.grid import FREQUENCIES_PER_SAMPLE
from ilctools.problem.problem import Problem, convergence_matrix
from ilctools.response.phase import phase, phase_grid, subdivided
from ilctools.response.response import Response
from ilctools.singular_values import TIED, largest_singular_values

FINE_PHASE_STEP = 0.01  # in phi, of a grid that estimates a peak: peaks between are 1e-5 higher
# in phi, of the first grid of a proof. Each of its steps between which the peak may be higher than
# all computed values is divided into PARTS. This is repeated once: h is then 0.002, and the bound
# is 5e-7 above the peak.
FIRST_PHASE_STEP = np.pi / 6
PARTS, PASSES_OF_A_PROOF = 16, 3
MOST_IN_A_PASS = 300_000  # frequencies; a flat response of L with thousands of samples needs more
PEAK_TOLERANCE = 1e-6  # relative, by how much a proven bound may exceed the peak
CHUNK = 2**21  # numbers held at a time while frequency responses are computed
DEAF, PASSES_NOTHING = "where P passes nothing", 1e-3  # with a smaller gain of P L
BELOW = "assumed below the first sample"


def peak_of_L(L: LearningFilter, lowest=0.0) -> tuple[float, float]:
    """Find the peak of sigma_max(L) over all frequencies from `lowest` on.

    Return the peak and its frequency.

    If `lowest` is zero, the peak is proven. Otherwise the peak is estimated by the largest value on
    a grid and at the tops of the local maxima between its points. The steps of the grid are
    `FINE_PHASE_STEP` in the phase of the all-pass with the poles of L.
    """

    def sigma(omega):
        return largest_singular_values(in_parts(L.frequency_response, omega, 4 * LONG))

    if lowest <= 0:
        return proven_peak(sigma, L.poles, L.Ts)
    grid = phase_grid([L.poles], FINE_PHASE_STEP, MOST_IN_A_PASS)
    omega = np.append(lowest, grid[grid > lowest * L.Ts] / L.Ts)
    omega, values = with_tops(sigma, omega)
    return float(values.max()), float(omega[values.argmax()])


def peak_of_M(P: control.StateSpace, L: LearningFilter, Q) -> tuple[float, float]:
    """Find a proven bound on the peak of sigma_max(M) for a model P.

    Return the bound, and the frequency of the peak in rad/s.
    """

    def sigma(omega):
        of_P = in_parts(partial(frequency_response, P), omega, P.B.size)
        of_L = in_parts(L.frequency_response, omega, 4 * LONG)  # in long doubles
        M = convergence_matrix(of_P, Q.frequency_response(omega), of_L)
        return largest_singular_values(M)

    # Q is not made a part of a system: the poles of a filter of high order with a low cut-off lie
    # so close together that a Schur form tears them apart.
    poles = np.diag(schur_form(P)[0])
    return proven_peak(sigma, np.concatenate([poles, L.poles, Q.poles]), L.Ts)


def proven_peak(sigma, poles, Ts: float) -> tuple[float, float]:
    """Find an upper bound on the peak of a function sigma(omega).

    Return the bound, and the frequency of the peak in rad/s.

    `sigma` is the largest singular value of a system with these `poles`.
    """
    arguments.stable("system", poles)
    theta, peak, place = phase_grid([poles], FIRST_PHASE_STEP)[None], 0.0, 0.0
    for _ in range(PASSES_OF_A_PROOF):
        values = sigma(theta.ravel() / Ts).reshape(theta.shape)
        if values.max() > peak:
            peak, place = values.max(), theta.ravel()[values.argmax()]
        h = np.diff(phase(poles, theta.ravel()).reshape(theta.shape))
        bound = np.maximum(values[:, 1:], values[:, :-1]) / np.cos(np.minimum(h, np.pi) / 2)
        high = bound > peak
        if not high.any() or high.sum() * PARTS > MOST_IN_A_PASS:
            break
        parts = np.linspace(0, 1, PARTS + 1)
        theta = theta[:, :-1][high][:, None] + parts * np.diff(theta)[high][:, None]
    return float(bound[high].max(initial=peak)), float(place / Ts)


def in_parts(function, points, size):
    """Evaluate a function at many points, in parts that fit into memory.

    For each point, the function stores `size` numbers.
    """
    parts = np.array_split(points, 1 + len(points) * size // CHUNK)
    return np.concatenate([function(part) for part in parts])


@dataclass(frozen=True)
class Peak:
    """The highest peak of sigma_max(M) over all frequencies among some plants of a problem."""

    sigma: float  # if proven, an upper bound, which exceeds the peak by PEAK_TOLERANCE at most
    omega: float  # the frequency of the peak, rad/s
    plant: int  # the number of the plant with this peak; the first plant if several are tied


def peaks_of_M(problem: Problem, L, level) -> dict[str, Peak]:
    """Find the highest peaks of sigma_max(M), one for each way in which peaks are computed.

    The keys of the returned dict are "proven", `DEAF`, "estimated", `BELOW` and "assumed". A key
    without peaks is left out. If a plant is a model and Q is a filter, the peak for this plant,
    computed without its radius, has the key "proven". Where P has no gain, sigma_max(M) is |Q| for
    any L. The key of a proven peak at such a frequency is `DEAF`.

    If P or Q is known by samples, or if P has a radius, peaks come from a dense grid. Between the
    first and the last frequency of P, the key is "estimated". Below the first frequency, the key is
    `BELOW`. Above the last frequency, the key is "assumed". A crest is a local maximum on the grid.
    Crests near `level` or above are also evaluated at their tops. The values of lower crests are
    only upper bounds.
    """
    peaks = {"proven": [], DEAF: [], "estimated": [], BELOW: [], "assumed": []}
    for k, model in enumerate(problem.response.models):
        if model is not None and isinstance(problem.lowpass, ZeroPhaseButterworth):
            peak = Peak(*peak_of_M(model, L, problem.lowpass), k)
            peaks["proven" if passes(model, L, peak) else DEAF].append(peak)
            if problem.radius is None:
                continue
        for how, peak in estimated_peaks(problem, L, level, k):
            peaks[how].append(peak)
    return {how: highest(found) for how, found in peaks.items() if found}


def estimated_peaks(problem: Problem, L, level, k):
    """Yield pairs of a key and a peak of plant k, for the peaks that are not proven.

    The keys say whether a peak is between, below or above the frequencies of P.
    """
    response = problem.response
    sigma_M = partial(_sigma_M, problem, L, level, k)
    omega, sigma = with_tops(sigma_M, dense_grid(response, k, L), NEAR_LEVEL * level)
    below, above = response.unsampled(k, omega), omega > response.omega[-1]
    for how, there in (("estimated", ~below & ~above), (BELOW, below), ("assumed", above)):
        if there.any():
            at = np.where(there, sigma, -1).argmax()
            yield how, Peak(float(sigma[at]), float(omega[at]), k)


def _sigma_M(problem, L, level, k, omega):
    """Compute the worst sigma_max(M) of plant k within its radius, at frequencies omega.

    Below the first sample, the plant may be anywhere in a region, see :mod:`.response.samples`.
    """
    response = problem.response
    (P, radius), Q = response.anywhere(k, omega), problem.lowpass.frequency_response(omega)
    of_L = in_parts(L.frequency_response, omega, 4 * LONG)  # in long doubles
    sigma = within_radius(P, Q, of_L, radius, level)
    if (low := response.unsampled(k, omega)).any():
        region, Q, of_L = response.samples[k].below(omega[low]), Q[low], of_L[low]
        moves = np.abs(Q) * region.moves * largest_singular_values(region.W @ of_L)
        sigma[low] = within_radius(region.P, Q, of_L, region.radius, 0) + moves
    return sigma


def passes(P, L, peak) -> bool:
    """Return whether P L has a gain at a peak.

    If P has no gain at the peak, sigma_max(M) is |Q| there for any L.
    """
    if not 1 - PASSES_NOTHING <= peak.sigma <= 1 + PEAK_TOLERANCE:
        return True
    [of_P], [of_L] = frequency_response(P, [peak.omega]), L.frequency_response([peak.omega])
    return np.linalg.norm(of_P, -2) * np.linalg.norm(of_L, 2) > PASSES_NOTHING


def with_tops(function, omega, height=None) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate a function at frequencies, and at the tops of its crests between them.

    A crest is a local maximum on the grid. A parabola through the maximum and its two neighbours
    gives the top of the crest. Only crests of at least `height` get a top. The default height is
    `NEAR_LEVEL` times the largest value. Return the frequencies and the values.
    """
    values = function(omega)
    height = NEAR_LEVEL * values.max() if height is None else height
    crests, _ = find_peaks(values, height=height, plateau_size=(1, 1))
    if not len(crests):
        return omega, values
    (a, b, c), (x, y, z) = (v[np.add.outer([-1, 0, 1], crests)] for v in (omega, values))
    left, right = (y - x) / (b - a), (z - y) / (c - b)
    tops = (a + b) / 2 - left * (c - a) / (right - left) / 2
    return np.append(omega, tops), np.append(values, function(tops))


def dense_grid(response: Response, number, L) -> np.ndarray:
    """Return a grid that subdivides omega and resolves the poles of L, and of P if P is a model.

    If P is known by samples, the grid runs from zero to the Nyquist frequency. Above its last
    sample, P has a radius, see :mod:`.response.response`.
    """
    model, (low, *_, high) = response.models[number], response.omega
    grids = [
        subdivided(response.omega, FREQUENCIES_PER_SAMPLE),
        phase_grid([L.poles], np.pi / FREQUENCIES_PER_SAMPLE) / response.Ts,
    ]
    if model is not None:
        grids.append(
            phase_grid([model.poles()], np.pi / (2 * FREQUENCIES_PER_SAMPLE)) / response.Ts
        )
    else:
        grids.append(np.linspace(0, np.nextafter(low, 0), 1 + FREQUENCIES_PER_SAMPLE))
        low = 0
        if response.beyond is not None:
            grids.append([np.nextafter(high, np.inf)])
            high = np.inf
    omega = np.unique(np.concatenate(grids))
    return omega[(omega >= low) & (omega <= high)]


def highest(peaks: list[Peak]) -> Peak:
    """Return the highest of several peaks.

    If several peaks are equally high, the peak of the first plant is returned.
    """
    sigma = max(peak.sigma for peak in peaks)
    level = [peak for peak in peaks if peak.sigma >= sigma * (1 - TIED)]
    return replace(min(level, key=lambda peak: peak.plant), sigma=sigma)
