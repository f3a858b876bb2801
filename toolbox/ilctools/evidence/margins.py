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
phase of its own poles. Q and L are splined between. M is computed at the tops of its crests, too,
which are where the parabolas through their three highest points have them. The poles of a table are
not known, and its samples decide: a mode that is narrower than a step of omega is not seen. Above
the last sample a table counts as it does in the certificate. The margin of the time scale leaves
out what would come from there.

The search goes outwards in steps to the first that fails, and then by Brent's method. It ends with
ten times the gain, eight times the time, a turn of the phase. In g and r sigma_max is convex, so
that there is one limit; a limit below g = 1 exists only if Q is above one somewhere. Phase margins
of ``control.stability_margins`` are those of a feedback loop, which v = Q (v + L e) is from trial
to trial only.
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

GAINS = np.array([1.0, 10.0])  # the last is where the search ends, as of the following ones
# time scales: the first steps are as small as a lightly damped antiresonance asks for
TIMES = 1 + np.append(0, np.geomspace(1e-3, 7, 23))
RADII = np.array([0.0, 10.0])  # of sigma_max(P) at the cut-off
TURN = np.linspace(0, 2 * np.pi, 33)  # of the phase at the cut-off, by a delay
PHASE_STEP = np.pi / 20  # of the phase of poles, from one frequency to the next
MOST_FOR_L = 8000  # frequencies for the poles of L: fewer than a filter of thousands of samples has
PARTS = 4  # frequencies for each sample of a table, which splines miss most halfway
LEVEL = 0.98  # of crests whose tops are looked for; from 0.99 of it on a worst case is exact
ONE = 1 + 1e-9  # what rounding makes of one
TWO_DIGITS = Context(prec=2, rounding=ROUND_DOWN)
LIMIT_TOLERANCE = 1e-4  # relative, of a limit: it is printed with two digits


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
    # 100 * 0.29 is less than 29 by rounding
    return float(TWO_DIGITS.create_decimal_from_float(max(distance, 0.0) * (1 + 1e-12)))


def margins(problem: Problem, L) -> Margins:
    """The margins of a filter, in units of `scale`, for all plants of a problem at once."""
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
    """How far from the first of some steps all peaks stay below one; the last if there, too."""
    for plant in plants:  # of a further one only up to the limit of those before
        steps = _up_to_root(lambda value, plant=plant: plant.peak(**{what: value}) - ONE, steps)
    return float(steps[-1])


def _up_to_root(excess, steps):
    """The steps at which an excess is below zero, and its root between them and the next one."""
    outside = next((k for k, step in enumerate(steps) if excess(step) >= 0), None)
    if not outside:
        return steps if outside is None else steps[:1]
    inner, outer = steps[outside - 1], steps[outside]
    root = brentq(excess, inner, outer, xtol=LIMIT_TOLERANCE**2 * abs(steps[1] - steps[0]))
    return np.append(steps[:outside], root + LIMIT_TOLERANCE * (steps[0] - root))


class Filters(NamedTuple):
    """Q and L at frequencies between which splines hold."""

    omega: np.ndarray
    Q: CubicSpline
    L: CubicSpline


def _filters(problem, L) -> Filters:
    """Those of a problem, from rest or the first sample up to Nyquist's frequency."""
    lowpass, poles = problem.lowpass, [L.poles]
    if isinstance(lowpass, ZeroPhaseButterworth):
        poles.append(lowpass.poles)
    turn = float(phase(L.poles, np.array([np.pi]))[0])
    omega = phase_grid(poles, max(PHASE_STEP, turn / MOST_FOR_L)) / problem.Ts
    ends = _ends(problem.response)[0], np.pi / problem.Ts
    omega = np.unique([*problem.omega, *omega[(omega > ends[0]) & (omega < ends[1])], *ends])
    # of two that are nearly the same one: between them, a slope would be rounding
    omega = omega[np.append(True, np.diff(omega) > SAME_FREQUENCY * omega[1:])]
    return Filters(omega, *(CubicSpline(omega, f.frequency_response(omega)) for f in (lowpass, L)))


class Perturbed:
    """A plant with something changed, behind filters."""

    def __init__(self, response: Response, number: int, filters: Filters):
        self.response, self.number, self.filters = response, number, filters
        model, (first, last) = response.models[number], response.omega[[0, -1]]
        if model is None:
            own = subdivided(response.omega, PARTS)
        else:
            own = phase_grid([model.poles()], PHASE_STEP) / response.Ts
        # where a radius begins and ends, and where what is assumed above a table begins
        ends = first, last, np.nextafter(last, np.inf)
        self.omega = np.union1d(own, ends)

    def peak(self, gain=1.0, delay=0.0, slower=1.0, radius=0.0) -> float:
        """Of sigma_max(M) with g exp(-j omega d Ts) P(a omega) + Delta, ||Delta|| <= r."""
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
        """The grid of the plant at its own speed; most changes leave that as it is."""
        return self._slower(1.0)

    def _slower(self, slower):
        """Frequencies at which P(a omega) is looked at, and P and its radius there."""
        first, *_, nyquist = self.filters.omega
        omega = np.union1d(self.filters.omega, self.omega / slower)
        known = (slower * omega <= _ends(self.response)[1]) | (slower == 1)
        omega = omega[(omega >= first) & (omega <= nyquist) & known]
        return omega, self._at(slower * omega)

    def _at(self, omega):
        """P and its radius at any frequencies, at the ends of what is known beyond them."""
        there = np.clip(omega, _ends(self.response)[0], self.filters.omega[-1])
        return self.response.anywhere(self.number, there)


def _ends(response):
    """Between which frequencies P is known, rad/s; without end also where Nyquist's is the last."""
    first = response.omega[0] if response.sampled else 0.0
    return first, np.inf if response.beyond is None else response.omega[-1]
