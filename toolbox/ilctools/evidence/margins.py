"""By how much may the plant change before monotone convergence is lost? Four margins.

The plants P of a problem are replaced, at each frequency omega, by one of

    g P(omega),    exp(-j omega d Ts) P(omega),    P(a omega),    P(omega) + Delta, ||Delta|| <= r,

a gain g, a delay of d more samples, a plant whose time scale is a times as long, anything within a
radius r. The margins say up to which g, d, a, r the largest sigma_max(Q (I - P L)) stays below one
at all frequencies, for all plants, and everywhere within the radius of the problem, which moves
with them.

M can have a narrow crest wherever P or L changes within a narrow band: at a mode of P, which is a
pole of P, and at an antiresonance of P, where L = B K has poles. Q and L are therefore computed on
a grid that is dense in the phase of their poles, and each plant on a grid that is dense in the
phase of its own poles. Splines hold between. The height of a crest follows from the parabola
through its three highest points. The poles of a table are not known, and its samples decide: a mode
that is narrower than a step of omega is not seen. Above the last sample a table counts as it does
in the certificate. The margin of the time scale leaves out what would come from there.

The search goes outwards in steps to the first that fails, and then by Brent's method. It ends with
ten times the gain, eight times the time, a turn of the phase. In g and r sigma_max is convex, so
that there is one limit; a limit below g = 1 exists only if Q is above one somewhere. Phase margins
of ``control.stability_margins`` are those of a feedback loop, which v = Q (v + L e) is from trial
to trial only.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from ilctools.evidence.robustness import within_radius
from ilctools.filters import ZeroPhaseButterworth
from ilctools.problem.problem import Problem
from ilctools.response.phase import phase, phase_grid, subdivided
from ilctools.response.response import Response

GAINS = np.array([1.0, 10.0])  # the last is where the search ends, as of the following ones
# time scales: the first steps are as small as a lightly damped antiresonance asks for
TIMES = 1 + np.append(0, np.geomspace(1e-3, 7, 23))
RADII = np.array([0.0, 10.0])  # of sigma_max(P) at the cut-off
TURN = np.linspace(0, 2 * np.pi, 33)  # of the phase at the cut-off, by a delay
STEP = np.pi / 20  # of the phase of poles, from one frequency to the next
MOST = 8000  # frequencies for the poles of L: of a finite filter of thousands of samples fewer
PARTS = 4  # frequencies for each sample of a table, whose splines miss most halfway
LEVEL = 0.98  # from 0.99 of which on a worst case is exact, and crests have their parabolas
ONE = 1 + 1e-9  # what rounding makes of one
CLOSE = 1e-4  # relative, of a limit: it is printed with two digits


@dataclass(frozen=True)
class Margins:
    """Up to where trials converge monotonically if one thing changes at a time."""

    gain: tuple[float, float]  # of P, times that of the design: down, up
    delay: tuple[float, float]  # samples less, samples more
    time: tuple[float, float]  # how many times faster, how many times slower
    radius: float  # of any other Delta, in units of sigma_max(P) at the cut-off of Q

    def __repr__(self):
        low, high = self.gain
        (less, more), (faster, slower) = self.delay, self.time
        return (
            f"margins: gain {_percent(1 - low)} lower to {_percent(high - 1)} higher, delay "
            f"{inwards(less):g} samples less to {inwards(more):g} more, {_percent(faster - 1)} "
            f"faster to {_percent(slower - 1)} slower, any error of {_percent(self.radius)} of "
            "sigma_max(P) at the cut-off"
        )


def _percent(distance):
    """A distance as a share of one, with two digits."""
    return f"{inwards(100 * distance):g} %"


def inwards(distance: float) -> float:
    """A distance rounded towards zero, to two digits."""
    distance *= 1 + 1e-12  # 100 * 0.29 is less than 29 by rounding
    if distance <= 0:
        return 0.0
    digit = np.floor(np.log10(distance)) - 1
    return float(f"{np.floor(distance * 10.0**-digit):.0f}e{digit:.0f}")


def margins(problem: Problem, L) -> Margins:
    """The margins of a filter, in units of `scale`, for all plants of a problem at once."""
    response, cutoff = problem.response, problem.lowpass.cutoff
    filters = Filters.of(problem, L)
    plants = [Perturbed.of(response, number, filters) for number in range(len(response.models))]
    unit = np.linalg.norm(response.anywhere(0, np.clip([cutoff], *_ends(response)))[0][0], 2)
    samples = TURN / (cutoff * problem.Ts)
    gain, delay = [plant.gain for plant in plants], [plant.delay for plant in plants]
    slower, anything = [plant.slower for plant in plants], [plant.anything for plant in plants]
    return Margins(
        (limit(gain, np.array([1.0, 0.0])), limit(gain, GAINS)),
        (abs(limit(delay, -samples)), limit(delay, samples)),
        (1 / limit(slower, 1 / TIMES), limit(slower, TIMES)),
        limit(anything, RADII * (unit or 1.0)) / (unit or 1.0),
    )


def limit(peaks: list[Callable], steps) -> float:
    """How far from the first of some steps all peaks stay below one; the last if there, too."""
    start, last = steps[0], steps[-1]
    way = np.sign(last - start)
    for peak in peaks:

        def excess(distance, peak=peak):
            return peak(start + way * distance) - ONE

        # of a further plant only what is less than the limit of those before
        nearer = np.abs(steps - start)
        nearer = np.append(nearer[nearer < abs(last - start)], abs(last - start))
        distance = _first_root(excess, nearer)
        last = start + way * distance
    return float(last)


def _first_root(excess, distances):
    """Up to where an excess stays below zero, by steps outwards and Brent's method."""
    inside = 0.0
    for outside in distances:
        if excess(outside) >= 0:
            break
        inside = outside
    if inside == outside or outside == 0:
        return inside
    tiny = CLOSE * distances[1]
    root = brentq(excess, inside, outside, xtol=CLOSE * tiny, rtol=CLOSE / 2)
    return max(inside, root * (1 - CLOSE))


@dataclass(frozen=True)
class Filters:
    """Q and L at frequencies between which splines hold."""

    omega: np.ndarray
    Q: CubicSpline
    L: CubicSpline

    @staticmethod
    def of(problem: Problem, L) -> "Filters":
        """Those of a problem, from rest or the first sample up to Nyquist's frequency."""
        poles = [L.poles]
        if isinstance(problem.lowpass, ZeroPhaseButterworth):
            poles.append(problem.lowpass.poles)
        turn = float(phase(L.poles, np.array([np.pi]))[0])
        omega = phase_grid(poles, max(STEP, turn / MOST)) / problem.Ts
        first, last = _ends(problem.response)[0], np.pi / problem.Ts
        omega = np.union1d(problem.omega, omega[(omega > first) & (omega < last)])
        omega = np.union1d(omega, [first, last])
        Q, L = (CubicSpline(omega, f.frequency_response(omega)) for f in (problem.lowpass, L))
        return Filters(omega, Q, L)


@dataclass(frozen=True)
class Perturbed:
    """A plant with one thing changed; each method is the peak of sigma_max(M)."""

    filters: Filters
    Ts: float
    ends: tuple[float, float]  # between which the plant is known, rad/s
    jumps: np.ndarray  # frequencies at which its radius begins and ends
    omega: np.ndarray  # (n,)
    P: np.ndarray  # (n, m, m)
    radius: np.ndarray  # (n,)
    Q: np.ndarray  # (n,)
    L: np.ndarray  # (n, m, m)
    P_at: CubicSpline  # P between the ends

    @staticmethod
    def of(response: Response, number: int, filters: Filters) -> "Perturbed":
        """A plant of a response, by number."""
        model, ends = response.models[number], _ends(response)
        own = [filters.omega, np.nextafter(response.omega[[0, -1]], [0, np.inf])]
        if model is None:
            own.append(subdivided(response.omega, PARTS))
        else:
            own.append(phase_grid([model.poles()], STEP) / response.Ts)
        omega = np.unique(np.concatenate(own))
        omega = omega[(omega >= ends[0]) & (omega <= filters.omega[-1])]
        P, radius = response.anywhere(number, omega)
        known = omega <= ends[1]
        return Perturbed(
            filters, response.Ts, ends, response.omega[[0, -1]], omega, P, radius,
            filters.Q(omega), filters.L(omega), CubicSpline(omega[known], P[known]),
        )  # fmt: skip

    def gain(self, g: float) -> float:
        """With g P(omega)."""
        return self._peak(self.omega, g * self.P, g * self.radius)

    def delay(self, d: float) -> float:
        """With exp(-j omega d Ts) P(omega)."""
        turn = np.exp(-1j * self.omega * d * self.Ts)[:, None, None]
        return self._peak(self.omega, turn * self.P, self.radius)

    def anything(self, r: float) -> float:
        """With P(omega) + Delta, ||Delta|| <= r."""
        return self._peak(self.omega, self.P, self.radius + r)

    def slower(self, a: float) -> float:
        """With P(a omega), where that is known; up to Nyquist's frequency."""
        low, high = self.ends
        omega = np.union1d(self.filters.omega, self.omega / a)
        omega = omega[omega <= self.filters.omega[-1]]
        if high < self.filters.omega[-1]:  # samples end there
            omega = omega[a * omega <= high]
        there = np.clip(a * omega, low, high)
        radius = np.interp(there, self.omega, self.radius)
        Q, L = self.filters.Q(omega), self.filters.L(omega)
        sigma = within_radius(self.P_at(there), Q, L, radius, LEVEL)
        return highest(omega, sigma, self.jumps / a)

    def _peak(self, omega, P, radius):
        sigma = within_radius(P, self.Q, self.L, radius, LEVEL)
        return highest(omega, sigma, self.jumps)


def _ends(response):
    """Between which frequencies P is known: of models all, of a table its own, rad/s."""
    if response.sampled:
        return response.omega[[0, -1]]
    return np.array([0.0, np.pi / response.Ts])


def highest(omega, sigma, jumps) -> float:
    """The highest of some crests, by the parabolas through three points, (n,).

    Over jumps no parabola is laid.
    """
    before, here, after = sigma[:-2], sigma[1:-1], sigma[2:]
    steps = np.diff(omega)
    smooth = np.searchsorted(jumps, omega[:-2]) == np.searchsorted(jumps, omega[2:], "right")
    crest = np.flatnonzero(smooth & (here > LEVEL) & (here > before) & (here >= after))
    left, right = ((here - before) / steps[:-1])[crest], ((after - here) / steps[1:])[crest]
    wide = omega[2:][crest] - omega[:-2][crest]
    slope = (left * steps[1:][crest] + right * steps[:-1][crest]) / wide
    tops = here[crest] + slope**2 * wide / (4 * (left - right))
    return float(max(sigma.max(), tops.max(initial=0)))
