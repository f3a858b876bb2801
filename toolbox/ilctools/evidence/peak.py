"""Are the bounds met between the samples? The peak over all frequencies.

If P is known by samples, or within a radius, the peak is the largest value on a dense grid and at
the tops of the crests on the grid. A parabola through three points gives the top of a crest.

For a model the peak has a proof, because the poles bound what can happen between two frequencies.
Let a_1 ... a_n be the eigenvalues of A. If there is a real Q = |H|^2 with a Butterworth filter H,
the poles of H are included. Let

    phi(theta) = sum_j integral from 0 to theta of (1 - |a_j|^2) / |exp(j t) - a_j|^2 dt,

the phase of the all-pass B(z) = prod_j (z - a_j) / (1 - conj(a_j) z). This phase increases. Let g
be the peak of Q sigma_max, with Q = 1 if there is no Q. Let theta* = omega* Ts be the angle at
which the peak is attained. Then

    Q sigma_max(theta) >= g cos(phi(theta) - phi(theta*))  if  |phi(theta) - phi(theta*)| <= pi.

*Proof.* Take the unit vectors u, v with Q u* G(theta*) v = g and let T(theta) = Q Re u* G v / g.
Then |T| <= Q sigma_max / g <= 1 everywhere, and T(theta*) = 1. Let
W(theta) = prod_j |exp(j theta) - a_j|^2. Q and Re u* G v are trigonometric polynomials over the
factors |exp(j theta) - a_j|^2 of their poles. T is therefore a trigonometric polynomial of degree n
or less over W. S(theta) = cos(phi(theta) - phi(theta*)) = Re(B(exp(j theta)) / B(exp(j theta*)))
has the same form, and so has D = S - T. D has no more than 2n zeros in a period, unless D is zero
throughout. S takes the values +1 and -1 in turn at theta* = t_0 < t_1 < ... < t_2n = t_0 + 2 pi.
Because |T| <= 1, D is >= 0 at t_0, t_2, ... and <= 0 at t_1, t_3, .... Each of the 2n - 2 intervals
[t_1, t_2] ... [t_2n-2, t_2n-1] therefore contains a zero of D. If the zero is at an end of an
interval, T = +1 or -1 is stationary there, as S is. The zero is then double, and counts once for
each of its two intervals. The zero at t_0 is double, too. Together these are 2n zeros. Now suppose
that T < S at some place in (t_0, t_1). Then D > 0 there and D(t_1) <= 0, which makes one more zero
in (t_0, t_1]: a contradiction. The other side is the mirror image. (The theorem is the inequality
of Bernstein and Szego for rational functions; see Borwein and Erdelyi, Mathematika 43 (1996)
413-423. For a finite impulse response of length n + 1, phi = n theta, and the theorem is Riesz's
lemma of 1914.)

Let a and b be two neighbouring frequencies with phi(b) - phi(a) = h < pi. If theta* lies between
them, a or b is no farther than h / 2 from theta*. The peak is then at most
max(sigma(a), sigma(b)) / cos(h / 2), so that a grid proves a bound. Real systems have the same
singular values at negative frequencies, so that [0, pi / Ts] is enough.

With L = B K of :mod:`ilctools.base` there is no model, as B also has poles mirrored at the circle.
On the circle, each factor of B is a trigonometric polynomial over |exp(j theta) - a|^2, with a pole
a inside the circle. K looks at most k samples ahead or back. K is therefore a trigonometric
polynomial of degree k, and counts as k poles at zero. In a product the degrees add, and so do the
phases.

The values are computed from a Schur form of A, whose diagonal holds the poles that the bound uses.
The proof is exact for a system whose matrices differ from the given ones by rounding. The proof
does not include what rounding may add to a peak. This is some 1e-16 over the distance of a pole to
the circle, or 1e-9 for the paper's M.
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
# where the peak may be higher than all values so far, each step is divided, and then once more. h
# is then 0.002, and the bound is 5e-7 above the peak
PARTS, PASSES_OF_A_PROOF = 16, 3
MOST_IN_A_PASS = 300_000  # frequencies: a flat base of thousands of samples has fewer passes
PEAK_TOLERANCE = 1e-6  # relative, by how much a proven bound may exceed the peak
CHUNK = 2**21  # numbers held at a time while frequency responses are computed
DEAF, PASSES_NOTHING = "where P passes nothing", 1e-3  # of P L
BELOW = "assumed below the first sample"


def peak_of_L(L: LearningFilter, lowest=0.0) -> tuple[float, float]:
    """Find the peak of sigma_max(L) over all frequencies from `lowest` on, and its frequency.

    If `lowest` is zero, the peak is proven. Otherwise the peak is the largest value on a grid with
    steps of `FINE_PHASE_STEP` in the phase of L, and at the tops of the crests.
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
    """Find the peak of sigma_max(M) over all frequencies, and its frequency."""

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
    """Find the peak of a sigma with these poles, as an upper bound, and its frequency, rad/s."""
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
    """Evaluate a function in parts that fit into memory, if a point takes `size` numbers."""
    parts = np.array_split(points, 1 + len(points) * size // CHUNK)
    return np.concatenate([function(part) for part in parts])


@dataclass(frozen=True)
class Peak:
    """The highest peak of sigma_max(M) over all frequencies among some plants of a problem."""

    sigma: float  # if proven, an upper bound to PEAK_TOLERANCE
    omega: float  # where it is, rad/s
    plant: int  # the number of its plant; the first if several are tied


def peaks_of_M(problem: Problem, L, level) -> dict[str, Peak]:
    """Find the highest peaks of sigma_max(M), by the way in which they are known.

    The keys are "proven", `DEAF`, "estimated", `BELOW` and "assumed"; a key without peaks is left
    out. A peak is "proven" for plants that are models, without the radius, if Q is a filter. Where
    P passes nothing, M is |Q| for any L. The key of a proven peak at such a frequency is `DEAF`.

    If P or Q are samples, or with a radius, a peak is "estimated" between the frequencies of P. A
    peak is "assumed" above the last frequency of P. Below the first one, its key is `BELOW`. These
    peaks come from a dense grid. Crests near `level` or above are also evaluated at their tops.
    Lower peaks are only bounded.
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
    """Yield the peaks of plant k between, below and above P's frequencies, each with its key."""
    response = problem.response
    sigma_M = partial(_sigma_M, problem, L, level, k)
    omega, sigma = with_tops(sigma_M, dense_grid(response, k, L), NEAR_LEVEL * level)
    below, above = response.unsampled(k, omega), omega > response.omega[-1]
    for how, there in (("estimated", ~below & ~above), (BELOW, below), ("assumed", above)):
        if there.any():
            at = np.where(there, sigma, -1).argmax()
            yield how, Peak(float(sigma[at]), float(omega[at]), k)


def _sigma_M(problem, L, level, k, omega):
    """sigma_max(M) of plant k within its radius, and within its region below the samples."""
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
    """Return whether P L passes something at a peak; else M is |Q| there for any L."""
    if not 1 - PASSES_NOTHING <= peak.sigma <= 1 + PEAK_TOLERANCE:
        return True
    [of_P], [of_L] = frequency_response(P, [peak.omega]), L.frequency_response([peak.omega])
    return np.linalg.norm(of_P, -2) * np.linalg.norm(of_L, 2) > PASSES_NOTHING


def with_tops(function, omega, height=None) -> tuple[np.ndarray, np.ndarray]:
    """Add the tops of crests to frequencies, and evaluate a function at all frequencies.

    A parabola through three points gives the top of a crest. Only crests of at least `height` get a
    top. The default height is `NEAR_LEVEL` times the largest value.
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

    For samples, the grid runs from zero to the Nyquist frequency, as P has a radius above its last
    sample, see :mod:`.response.response`.
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
    """Return the highest of some peaks; if several are tied, the peak of the first plant."""
    sigma = max(peak.sigma for peak in peaks)
    level = [peak for peak in peaks if peak.sigma >= sigma * (1 - TIED)]
    return replace(min(level, key=lambda peak: peak.plant), sigma=sigma)
