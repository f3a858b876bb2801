"""By how much may the plant change before monotone convergence is lost? Four margins.

At each frequency omega, every plant P of a problem is replaced by one of the following:

    g P(omega),    exp(-j omega d Ts) P(omega),    P(a omega),    P(omega) + Delta, ||Delta|| <= r,

The gain changes by the factor g, the delay grows by d samples, the time scale is a times as long,
or P has any error within a radius r. The margins are the limits on g, d, a and r up to which the
largest sigma_max(Q (I - P L)) stays below one, at all frequencies and for all plants. The limits
also hold everywhere within the radius of the problem, which changes together with the plants.

M can have a narrow crest wherever P or L changes within a narrow band. P does so at a mode, which
is a pole of P. L = B K does so at an antiresonance of P, where L has poles. Q and L are therefore
computed on a grid that is dense in the phase of their poles. Each plant is computed on a grid that
is dense in the phase of its own poles. Splines give Q and L between their frequencies. M is also
computed at the tops of its crests, where the parabola through the three highest points has its top.
The poles of a table are not known. A mode of a table that is narrower than a step of omega is
therefore not seen. Above its last sample, a table counts as in the certificate. The margin of the
time scale leaves out the frequencies that would use a table above its last sample.

The search goes outwards in steps to the first step that fails. Brent's method then finds the limit.
The search ends at ten times the gain, eight times the time scale, or a full turn of the phase. In g
and r, sigma_max is convex, so that there is one limit. A limit below g = 1 exists only if Q is
above one somewhere. Phase margins of ``control.stability_margins`` belong to a feedback loop. The
law v = Q (v + L e) is a feedback loop only from trial to trial.
"""

from dataclasses import dataclass
from decimal import ROUND_DOWN, Context
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from ilctools.evidence.peak import with_tops
from ilctools.evidence.robustness import within_radius
from ilctools.filters import ZeroPhaseButterworth
from ilctools.problem.problem import Problem
from ilctools.response.phase import phase, phase_grid, subdivided
from ilctools.response.response import Response
from ilctools.response.samples import SAME_FREQUENCY

GAINS = np.array([1.0, 10.0])  # the search ends at the last value, here and in the following arrays
# time scales: the first steps are as small as a lightly damped antiresonance asks for
TIMES = 1 + np.append(0, np.geomspace(1e-3, 7, 23))
RADII = np.array([0.0, 10.0])  # of sigma_max(P) at the cut-off
TURN = np.linspace(0, 2 * np.pi, 33)  # rad, phase at the cut-off that a delay adds
PHASE_STEP = np.pi / 20  # of phi, rad, from one frequency to the next
MOST_FOR_L = 8000  # frequencies for the poles of L; thousands of samples in L would need more
PARTS = 4  # frequencies for each sample of a table, which splines miss most halfway
LEVEL = 0.98  # of crests whose tops are computed; a worst case above 0.99 of it is exact
ONE = 1 + 1e-9  # one, with room for rounding
TWO_DIGITS = Context(prec=2, rounding=ROUND_DOWN)
LIMIT_TOLERANCE = 1e-4  # relative, of a limit, which is printed with two digits


@dataclass(frozen=True)
class Margins:
    """The limits of monotone convergence if one property of the plant changes at a time."""

    gain: tuple[float, float]  # factor on the gain of P: lowest, highest
    delay: tuple[float, float]  # samples less, samples more
    time: tuple[float, float]  # how many times faster, how many times slower
    radius: float  # of any other Delta, in units of sigma_max(P) at the cut-off of Q

    def __repr__(self):
        low, high = self.gain
        (less, more), (faster, slower) = self.delay, self.time
        return (
            f"margins (one change at a time): gain {_percent(1 - low)} lower to "
            f"{_percent(high - 1)} higher, delay {inwards(less):g} samples shorter to "
            f"{inwards(more):g} longer, time scale {_percent(faster - 1)} faster to "
            f"{_percent(slower - 1)} slower, any error up to {_percent(self.radius)} of "
            "sigma_max(P) at the cut-off"
        )


def _percent(distance):
    """A distance as a share of one, with two digits."""
    return f"{inwards(100 * distance):g} %"


def inwards(distance: float) -> float:
    """Round a distance towards zero, to two digits."""
    # by rounding, 100 * 0.29 is less than 29
    return float(TWO_DIGITS.create_decimal_from_float(max(distance, 0.0) * (1 + 1e-12)))


def margins(problem: Problem, L) -> Margins:
    """Compute the margins of a filter, in units of `scale`, for all plants of a problem at once."""
    response, cutoff = problem.response, problem.lowpass.cutoff
    filters = _filters(problem, L)
    plants = [Perturbed(response, number, filters) for number in range(len(response.models))]
    at_cutoff, _ = response.anywhere(0, np.clip([cutoff], *_ends(response)))
    unit = np.linalg.norm(at_cutoff[0], 2) or 1.0
    samples = TURN / (cutoff * problem.Ts)
    return Margins(
        (limit(plants, "gain", np.array([1.0, 0.0])), limit(plants, "gain", GAINS)),
        (abs(limit(plants, "delay", -samples)), limit(plants, "delay", samples)),
        (1 / limit(plants, "slower", 1 / TIMES), limit(plants, "slower", TIMES)),
        limit(plants, "radius", RADII * unit) / unit,
    )


def limit(plants, what: str, steps) -> float:
    """Return the value up to which all peaks stay below one, from the first step outwards.

    If the peaks also stay below one at the last step, the last step is returned.
    """
    for plant in plants:  # each further plant is searched up to the limit so far
        steps = _up_to_root(lambda value, plant=plant: plant.peak(**{what: value}) - ONE, steps)
    return float(steps[-1])


def _up_to_root(excess, steps):
    """The first steps with an excess below zero, then its root before the step that fails."""
    outside = next((k for k, step in enumerate(steps) if excess(step) >= 0), None)
    if not outside:
        return steps if outside is None else steps[:1]
    inner, outer = steps[outside - 1], steps[outside]
    root = brentq(excess, inner, outer, xtol=LIMIT_TOLERANCE**2 * abs(steps[1] - steps[0]))
    return np.append(steps[:outside], root + LIMIT_TOLERANCE * (steps[0] - root))


class Filters(NamedTuple):
    """Q and L as splines through their values at frequencies."""

    omega: np.ndarray
    Q: CubicSpline
    L: CubicSpline


def _filters(problem, L) -> Filters:
    """Q and L of a problem, from rest or the first sample up to the Nyquist frequency."""
    lowpass, poles = problem.lowpass, [L.poles]
    if isinstance(lowpass, ZeroPhaseButterworth):
        poles.append(lowpass.poles)
    turn = float(phase(L.poles, np.array([np.pi]))[0])
    omega = phase_grid(poles, max(PHASE_STEP, turn / MOST_FOR_L)) / problem.Ts
    ends = _ends(problem.response)[0], np.pi / problem.Ts
    omega = np.unique([*problem.omega, *omega[(omega > ends[0]) & (omega < ends[1])], *ends])
    # keep one of two frequencies that are nearly the same, as a slope between would be rounding
    omega = omega[np.append(True, np.diff(omega) > SAME_FREQUENCY * omega[1:])]
    return Filters(omega, *(CubicSpline(omega, f.frequency_response(omega)) for f in (lowpass, L)))


class Perturbed:
    """A plant whose gain, delay, time scale or radius changes, with its filters Q and L."""

    def __init__(self, response: Response, number: int, filters: Filters):
        self.response, self.number, self.filters = response, number, filters
        model, (first, last) = response.models[number], response.omega[[0, -1]]
        if model is None:
            own = subdivided(response.omega, PARTS)
        else:
            own = phase_grid([model.poles()], PHASE_STEP) / response.Ts
        # the ends of a radius, and the frequency above which P of a table is assumed
        ends = first, last, np.nextafter(last, np.inf)
        self.omega = np.union1d(own, ends)

    def peak(self, gain=1.0, delay=0.0, slower=1.0, radius=0.0) -> float:
        """Return max sigma_max(M) with g exp(-j omega d Ts) P(a omega) + Delta, ||Delta|| <= r."""
        grid, known = self._as_it_is if slower == 1 else self._slower(slower)

        def sigma_M(omega):
            P, of_P = known if omega is grid else self._at(slower * omega)
            P = gain * np.exp(-1j * omega * delay * self.response.Ts)[:, None, None] * P
            Q, L = self.filters.Q(omega), self.filters.L(omega)
            return within_radius(P, Q, L, gain * of_P + radius, LEVEL)

        _, sigma = with_tops(sigma_M, grid, LEVEL)
        return float(sigma.max())

    @cached_property
    def _as_it_is(self):
        """The grid for the plant's own time scale, which most changes leave as it is."""
        return self._slower(1.0)

    def _slower(self, slower):
        """The frequencies at which P(a omega) is evaluated, and P and its radius there."""
        first, *_, nyquist = self.filters.omega
        omega = np.union1d(self.filters.omega, self.omega / slower)
        known = (slower * omega <= _ends(self.response)[1]) | (slower == 1)
        omega = omega[(omega >= first) & (omega <= nyquist) & known]
        return omega, self._at(slower * omega)

    def _at(self, omega):
        """P and its radius at any frequencies; beyond the known range, as at its ends."""
        there = np.clip(omega, _ends(self.response)[0], self.filters.omega[-1])
        return self.response.anywhere(self.number, there)


def _ends(response):
    """The range in which P is known, rad/s; no upper end for a table up to Nyquist's frequency."""
    first = response.omega[0] if response.sampled else 0.0
    return first, np.inf if response.beyond is None else response.omega[-1]
