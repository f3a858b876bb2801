"""Are the bounds met between the samples? The peak over all frequencies.

From samples, and within a radius, it is that of a dense grid and of the tops of its crests, by the
parabolas through three points. For a model it has a proof: what can happen between two frequencies
is bounded by poles. Let a_1 ... a_n be the eigenvalues of A, and the poles of the Butterworth
filter H if there is Q = |H|^2, which is real; and let

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

So between two frequencies, phi(b) - phi(a) = h < pi, of which one is no farther than h / 2 from
theta*, the peak is max(sigma(a), sigma(b)) / cos(h / 2) at most: a grid proves it. Real systems
have the same singular values at negative frequencies, so that [0, pi / Ts] is enough.

With L = B K of :mod:`ilctools.base` there is no model: B has poles mirrored at the circle, too. On
the circle each is a trigonometric polynomial over |exp(j theta) - a|^2 of a pole a inside, and K,
which looks k samples ahead or back at most, one of degree k, as of k poles at zero. Of a product
the degrees add, and so do the phases.

Values are those of a Schur form of A, whose diagonal holds the poles that the bound uses: the proof
is exact for a system whose matrices differ from the given ones by rounding. What rounding may add
to a peak is no part of it: some 1e-16 over the distance of a pole to the circle, 1e-9 for the
paper's M.
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

FINE_PHASE_STEP = 0.01  # in phi, of a grid to read a peak from: crests between are 1e-5 higher
FIRST_PHASE_STEP = np.pi / 6  # in phi, of the grid on which the highest value is looked for;
# where the peak may be higher than all values so far, each step is divided, and again: h is then
# 0.002, and the bound 5e-7 above the peak
PARTS, PASSES_OF_A_PROOF = 16, 3
MOST_IN_A_PASS = 300_000  # frequencies: fewer passes for a flat base of thousands of samples
PEAK_TOLERANCE = 1e-6  # relative, by how much such a bound may be above the peak
CHUNK = 2**21  # numbers held at a time while frequency responses are computed
DEAF, PASSES_NOTHING = "where P passes nothing", 1e-3  # of P L
BELOW = "assumed below the first sample"


def peak_of_L(L: LearningFilter, lowest=0.0) -> tuple[float, float]:
    """Peak of sigma_max(L) over all frequencies from the lowest on, and where it is.

    Proven over all frequencies. From another lowest one on, it is the largest value on a grid with
    steps of `FINE_PHASE_STEP` in the phase of L, and at the tops of its crests.
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
    """Peak over all frequencies of sigma_max(M), and where it is."""

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
    """Peak over all frequencies of a sigma with these poles, an upper bound; where it is, rad/s."""
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
    """Its values at the points: so many at a time as memory admits, `size` numbers for each."""
    parts = np.array_split(points, 1 + len(points) * size // CHUNK)
    return np.concatenate([function(part) for part in parts])


@dataclass(frozen=True)
class Peak:
    """The highest peak of sigma_max(M) over all frequencies among some plants of a problem."""

    sigma: float  # an upper bound, to PEAK_TOLERANCE, if proven
    omega: float  # where it is, rad/s
    plant: int  # whose it is; of those that are tied, the first


def peaks_of_M(problem: Problem, L, level) -> dict[str, Peak]:
    """The highest peaks by how they are known: "proven", "estimated" and "assumed", if there are.

    Proven is that of the plants that are models, without the radius, if Q is one, too; where P
    passes nothing M is |Q| for any L, and that peak is named `DEAF` instead. Else it is
    estimated between the frequencies, and assumed above P's last and, named `BELOW`, below P's
    first: on a dense grid and, near the level or above, at the tops of its crests; where it is
    lower, only bounded.
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
    """Those of plant k between, below and above P's frequencies, and how they are known."""
    response = problem.response
    sigma_M = partial(_sigma_M, problem, L, level, k)
    omega, sigma = with_tops(sigma_M, dense_grid(response, k, L), NEAR_LEVEL * level)
    below, above = response.unsampled(k, omega), omega > response.omega[-1]
    for how, there in (("estimated", ~below & ~above), (BELOW, below), ("assumed", above)):
        if there.any():
            at = np.where(there, sigma, -1).argmax()
            yield how, Peak(float(sigma[at]), float(omega[at]), k)


def _sigma_M(problem, L, level, k, omega):
    """sigma_max(M) of plant k within its radius, and within what is assumed below its samples."""
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
    """Whether P L passes something at a peak; else M is |Q| there, and no L makes it less."""
    if not 1 - PASSES_NOTHING <= peak.sigma <= 1 + PEAK_TOLERANCE:
        return True
    [of_P], [of_L] = frequency_response(P, [peak.omega]), L.frequency_response([peak.omega])
    return np.linalg.norm(of_P, -2) * np.linalg.norm(of_L, 2) > PASSES_NOTHING


def with_tops(function, omega, height=None) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies with those of the tops of crests, and the values of a function there.

    The tops are where the parabolas through three points have them; of crests of this height or
    more, which is `NEAR_LEVEL` times the largest value by default.
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
    """Some frequencies for each of a response, and those that resolve the poles of L and a model.

    Of samples up to the Nyquist frequency, see :mod:`.response.response`.
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
    """The highest of some peaks; of those that are tied, that of the first plant."""
    sigma = max(peak.sigma for peak in peaks)
    level = [peak for peak in peaks if peak.sigma >= sigma * (1 - TIED)]
    return replace(min(level, key=lambda peak: peak.plant), sigma=sigma)
