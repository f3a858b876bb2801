"""How far may the plant be off before monotone convergence is lost? Margins that engineers know.

The plants P of a problem, in whose place stands, at each frequency omega, one of

    g P(omega),    exp(-j omega d Ts) P(omega),    P(a omega),    P(omega) + Delta, ||Delta|| <= r,

a gain g, a delay of d more samples, a plant slower by a in all, anything within a radius r: up to
which g, d, a, r is sigma_max(Q (I - P L)) below one at all frequencies, for all plants, and all
within the radius of the problem, which moves with them?
They are found on the design grid and where the modes of models are, on splines, by steps outwards
to the first that fails, and by Brent's method: two digits. Of samples, a mode that is narrower than
a step of omega is not seen. The search ends with ten times the gain, eight times the
time, a turn of the phase. In g and r sigma_max is convex, so that there is one limit; and one below
g = 1 only if Q is above one somewhere. Phase margins of ``control.stability_margins`` are those of
a feedback loop, which v = Q (v + L e) is from trial to trial only.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.optimize import brentq

from ilctools.evidence.robustness import within_radius
from ilctools.problem.problem import Problem
from ilctools.response.phase import phase_grid

GAINS = np.geomspace(1, 10, 13)  # steps outwards; the last is where the search ends
TIMES = np.geomspace(1, 8, 25)
RADII = np.append(0, np.geomspace(1e-3, 10, 13))  # of sigma_max(P) at the cut-off
TURN = np.linspace(0, 2 * np.pi, 33)  # of the phase at the cut-off, by a delay
STEP = np.pi / 20  # of the phase of a model, from one frequency to the next
ONE = 1 + 1e-9  # what rounding makes of one


@dataclass(frozen=True)
class Margins:
    """Up to where trials converge monotonically, one thing off at a time."""

    gain: tuple[float, float]  # of P, times that of the design: down, up
    delay: tuple[float, float]  # samples less, samples more
    time: tuple[float, float]  # how many times faster, how many times slower
    radius: float  # of any other Delta, in units of sigma_max(P) at the cut-off of Q

    def __repr__(self):
        low, high = self.gain
        (less, more), (faster, slower) = self.delay, self.time
        return (
            f"margins: gain {low:.3g} to {high:.3g} times, delay {less:.3g} samples less to "
            f"{more:.3g} more, {faster:.3g} times faster to {slower:.3g} times slower, any error "
            f"of {self.radius:.3g} sigma_max(P) at the cut-off"
        )


def margins(problem: Problem, L) -> Margins:
    """Those of a filter, in units of `scale`, for all plants of a problem at once."""
    response, cutoff, ends = problem.response, problem.lowpass.cutoff, problem.omega[[0, -1]]
    modes = [model.poles() for model in response.models if model is not None]
    grid = np.clip(phase_grid(modes, STEP) / problem.Ts, *ends) if modes else ends
    omega = np.union1d(problem.omega, grid)
    known = (response.anywhere(k, omega) for k in range(len(response.models)))
    plants, radii = zip(*known, strict=True)
    P_at, radii_at = CubicSpline(omega, plants, axis=1), make_interp_spline(omega, radii, 1, axis=1)
    Q_at, L_at = (CubicSpline(omega, X.frequency_response(omega)) for X in (problem.lowpass, L))
    unit = np.linalg.norm(P_at(np.clip(cutoff, *ends))[0], 2) or 1.0

    def sigma(gain=1.0, delay=0.0, slower=1.0, radius=0.0):
        at = np.union1d(omega, np.clip(omega / slower, *ends))
        at = at[(slower * at <= ends[1]) | (not response.sampled)]
        turned = gain * np.exp(-1j * at * delay * problem.Ts)[:, None, None]
        there = np.clip(slower * at, *ends)
        Q, L, radii = Q_at(at), L_at(at), gain * radii_at(there) + radius * unit
        regions = zip(turned * P_at(there), radii, strict=True)
        return max(within_radius(P, Q, L, r, 1.0).max() for P, r in regions)

    limit, samples = partial(_limit, sigma), TURN / (cutoff * problem.Ts)
    return Margins(
        (limit("gain", [1, 0]), limit("gain", GAINS)),
        (abs(limit("delay", -samples)), limit("delay", samples)),
        (1 / limit("slower", 1 / TIMES), limit("slower", TIMES)),
        limit("radius", RADII),
    )


def _limit(sigma, change, steps):
    """How far from the first of some steps sigma stays below one; the last if there, too."""

    def excess(step):
        return sigma(**{change: step}) - ONE

    inside = steps[0]
    for outside in steps:
        if excess(outside) >= 0:
            break
        inside = outside
    return float(inside if inside == outside else brentq(excess, inside, outside))
