"""By how much may the plant change before monotone convergence is lost? Four margins.

At each frequency omega, every plant P of a problem is replaced by one of the following:

    g P(omega),    exp(-j omega d Ts) P(omega),    P(a omega),    P(omega) + Delta, ||Delta|| <= r,

The gain changes by the factor g, the delay grows by d samples, the time scale is a times as long,
or P has any error Delta up to a radius r. The margins are the limits on g, d, a and r. Within each
limit, the largest sigma_max(Q (I - P L)) stays below one, at all frequencies and for all plants. If
the problem has a radius around each plant, the limits hold for all plants within this radius. This
radius changes with the gain and the time scale of its plant.

M = Q (I - P L) can have a narrow peak wherever P or L changes within a narrow band. P changes
quickly near a pole with little damping. If L = B K with the regularised inverse B of P, L changes
quickly at an antiresonance of P, where L has poles. Q and L are therefore computed on a grid of
frequencies between which the phase of the all-pass with their poles changes in small steps, see
:mod:`.response.phase`. For each plant that is a model, such a grid is made from the poles of the
plant. Cubic splines interpolate Q and L between the frequencies of their grid. M is also computed
at the tops of its peaks. The top of a peak is estimated by the parabola through three neighbouring
points. The poles of a plant that is known as a table are not known. A mode of a table that is
narrower than a step of omega is therefore not seen. Above the last sample of a table, P has the
same size as in the certificate, with any phase. The margin of the time scale leaves out the
frequencies that would use a table above its last sample.

For each margin, the search starts at no change and goes outwards in steps, until sigma_max is at
least one. Brent's method then finds the limit within the last step. The search ends at ten times
the gain, at eight times the time scale, or at the delay that turns the phase at the cut-off by a
full turn. sigma_max(M) is a convex function of g and of r, so that each of these two searches has a
single limit. A limit on g between 0 and 1 exists only if |Q| is above one at some frequency. These
margins differ from the phase margins of ``control.stability_margins``, which belong to a feedback
loop in time. The law v = Q (v + L e) feeds back only from trial to trial.
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
from ilctools.response.phase import phase_grid, subdivided
from ilctools.response.response import Response
from ilctools.response.samples import SAME_FREQUENCY

GAINS = np.array([1.0, 10.0])  # the search ends at the last value, here and in the following arrays
# time scales: the first steps are small, because a lightly damped antiresonance has small margins
TIMES = 1 + np.append(0, np.geomspace(1e-3, 7, 23))
RADII = np.array([0.0, 10.0])  # in units of sigma_max(P) at the cut-off
TURN = np.linspace(0, 2 * np.pi, 33)  # rad, phase at the cut-off that a delay adds
PHASE_STEP = np.pi / 20  # of phi in `response.phase`, rad, from one frequency to the next
MOST_FOR_L = 8000  # frequencies for the poles of L; thousands of samples in L would need more
PARTS = 4  # steps between two samples of a table, as the error of splines is largest halfway
LEVEL = 0.98  # peaks above it get a top; worst cases above 0.99 of it are exact
ONE = 1 + 1e-9  # one, with room for rounding
TWO_DIGITS = Context(prec=2, rounding=ROUND_DOWN)
LIMIT_TOLERANCE = 1e-4  # relative tolerance of a limit, which is printed with two digits


@dataclass(frozen=True)
class Margins:
    """How much one property of the plant may change before monotone convergence is lost."""

    gain: tuple[float, float]  # factor on the gain of P: lowest, highest
    delay: tuple[float, float]  # samples less, samples more
    time: tuple[float, float]  # how many times faster, how many times slower
    radius: float  # of an arbitrary error Delta, in units of sigma_max(P) at the cut-off of Q

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
    """Return a relative distance as text in percent, rounded towards zero to two digits."""
    return f"{inwards(100 * distance):g} %"


def inwards(distance: float) -> float:
    """Round a distance towards zero, to two digits."""
    # because of rounding in doubles, 100 * 0.29 is less than 29
    return float(TWO_DIGITS.create_decimal_from_float(max(distance, 0.0) * (1 + 1e-12)))


def margins(problem: Problem, L) -> Margins:
    """Compute the margins of a filter L, given in units of `scale`, for all plants of a problem."""
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
    """Return the value up to which the largest sigma_max(M) of each plant stays below one.

    `what` names the argument of :meth:`Perturbed.peak` that changes along `steps`. If sigma_max(M)
    also stays below one at the last step, the last step is returned.
    """
    for plant in plants:  # each further plant is searched up to the limit so far
        steps = _up_to_root(lambda value, plant=plant: plant.peak(**{what: value}) - ONE, steps)
    return float(steps[-1])


def _up_to_root(excess, steps):
    """Return the steps up to the first root of `excess`, and the root as the last step."""
    outside = next((k for k, step in enumerate(steps) if excess(step) >= 0), None)
    if not outside:
        return steps if outside is None else steps[:1]
    inner, outer = steps[outside - 1], steps[outside]
    root = brentq(excess, inner, outer, xtol=LIMIT_TOLERANCE**2 * abs(steps[1] - steps[0]))
    return np.append(steps[:outside], root + LIMIT_TOLERANCE * (steps[0] - root))


class Filters(NamedTuple):
    """Q and L as cubic splines through their values at the frequencies `omega`."""

    omega: np.ndarray
    Q: CubicSpline
    L: CubicSpline


def _filters(problem, L) -> Filters:
    """Make splines of Q and L up to the Nyquist frequency.

    If all plants are models, the splines begin at zero frequency. Otherwise they begin at the first
    sample of P.
    """
    lowpass, poles = problem.lowpass, [L.poles]
    if isinstance(lowpass, ZeroPhaseButterworth):
        poles.append(lowpass.poles)
    omega = phase_grid(poles, PHASE_STEP, MOST_FOR_L) / problem.Ts
    ends = _ends(problem.response)[0], np.pi / problem.Ts
    omega = np.unique([*problem.omega, *omega[(omega > ends[0]) & (omega < ends[1])], *ends])
    # Of two frequencies that are nearly the same, one is kept: the slope between the two values
    # would be rounding.
    omega = omega[np.append(True, np.diff(omega) > SAME_FREQUENCY * omega[1:])]
    return Filters(omega, *(CubicSpline(omega, f.frequency_response(omega)) for f in (lowpass, L)))


class Perturbed:
    """A plant whose gain, delay, time scale or radius changes, with the filters Q and L."""

    def __init__(self, response: Response, number: int, filters: Filters):
        self.response, self.number, self.filters = response, number, filters
        model, (first, last) = response.models[number], response.omega[[0, -1]]
        if model is None:
            own = subdivided(response.omega, PARTS)
        else:
            own = phase_grid([model.poles()], PHASE_STEP) / response.Ts
        # the radius begins and ends at omega[0] and omega[-1]; above, P of a table is only assumed
        ends = first, last, np.nextafter(last, np.inf)
        self.omega = np.union1d(own, ends)

    def peak(self, gain=1.0, delay=0.0, slower=1.0, radius=0.0) -> float:
        """Return the largest sigma_max(M) of the changed plant, over all frequencies.

        The plant is g exp(-j omega d Ts) P(a omega) + Delta with ||Delta|| <= r. Here g is `gain`,
        d is `delay` in samples, a is `slower` and r is `radius`.
        """
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
        """The grid, P and its radius for the unchanged time scale, computed once."""
        return self._slower(1.0)

    def _slower(self, slower):
        """Return the frequencies omega, and P(a omega) and its radius, for a = `slower`."""
        first, *_, nyquist = self.filters.omega
        omega = np.union1d(self.filters.omega, self.omega / slower)
        known = (slower * omega <= _ends(self.response)[1]) | (slower == 1)
        omega = omega[(omega >= first) & (omega <= nyquist) & known]
        return omega, self._at(slower * omega)

    def _at(self, omega):
        """Return P and its radius at any frequencies.

        Outside the range in which P is known, P and the radius are constant.
        """
        there = np.clip(omega, _ends(self.response)[0], self.filters.omega[-1])
        return self.response.anywhere(self.number, there)


def _ends(response):
    """Return the range of frequencies in which P is known, rad/s.

    The upper end is infinite for models, and for tables that end at the Nyquist frequency.
    """
    first = response.omega[0] if response.sampled else 0.0
    return first, np.inf if response.beyond is None else response.omega[-1]
