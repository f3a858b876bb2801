"""How far may the plant be off before monotone convergence is lost? Margins that engineers know.

The plants P of a problem, in whose place stands, at each frequency omega, one of

    g P(omega),    exp(-j omega d Ts) P(omega),    P(a omega),    P(omega) + Delta, ||Delta|| <= r,

a gain g, a delay of d more samples, a plant slower by a in all, anything within a radius r: up to
which g, d, a, r is sigma_max(Q (I - P L)) below one at all frequencies, for all plants?
They are read off a grid that resolves the poles of P and L, of tables ten times as dense as it, but
no denser than the curves of P and L ask for, by steps outwards to the first that fails, and by
Brent's method. In g and r sigma_max is convex, so that there is one limit; and one below g = 1 only
if Q is above one somewhere. Phase margins of ``control.stability_margins`` are those of a feedback
loop, which v = Q (v + L e) is from trial to trial only.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import brentq

from ilctools.evidence.peak import DENSER, dense_grid
from ilctools.evidence.robustness import within_radius
from ilctools.problem.problem import Problem

GAINS = np.geomspace(1, 10, 13)  # steps outwards; the last is where the search ends
TIMES = np.geomspace(1, 8, 25)
RADII = np.append(0, np.geomspace(1e-3, 10, 13))  # of sigma_max(P) at the cut-off
TURN = np.linspace(0, 2 * np.pi, 33)  # of the phase at the cut-off, by a delay
EVEN = 3e-3  # step along the curves, of P in units of sigma_max(P) at the cut-off
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
        end = "or more " if high >= GAINS[-1] else ""
        return (
            f"margins: gain {low:.2g} to {high:.3g} {end}times, delay {less:.3g} samples less to "
            f"{more:.3g} more, {_times(faster)} faster to {_times(slower)} slower, any error of "
            f"{self.radius:.2g} sigma_max(P) at the cut-off"
        )


def _times(factor):
    """A stretch of time in words."""
    return f"{factor:.3g} times" + (" or more" if factor >= TIMES[-1] else "")


def margins(problem: Problem, L) -> Margins:
    """Those of a filter, in units of `scale`, for all plants of a problem at once."""
    unit, omega, P, Q, L = _curves(problem, L)
    P_at, Q_at, L_at = (make_interp_spline(omega, X) for X in (P, Q, L))
    first, *_, last = omega

    def sigma(gain=1.0, delay=0.0, slower=1.0, radius=0.0):
        at = np.union1d(omega, np.clip(omega / slower, first, last))
        at = at[(slower * at <= last) | (not problem.response.sampled)]
        turned = gain * np.exp(-1j * at * delay * problem.Ts)[:, None, None]
        plants, Q, L = P_at(np.clip(slower * at, first, last)), Q_at(at), L_at(at)
        return max(
            within_radius(turned * P, Q, L, radius * unit, 1.0).max() for P in plants.swapaxes(0, 1)
        )

    limit, samples = partial(_limit, sigma), TURN / (problem.lowpass.cutoff * problem.Ts)
    return Margins(
        (limit("gain", [1, 0]), limit("gain", GAINS)),
        (abs(limit("delay", -samples)), limit("delay", samples)),
        (1 / limit("slower", 1 / TIMES), limit("slower", TIMES)),
        limit("radius", RADII),
    )


def _curves(problem, L):
    """The unit of P, and omega, P, Q, L even along P, Q L and Q exp(j omega d Ts)."""
    response, cutoff = problem.response, problem.lowpass.cutoff
    numbers, times = range(len(response.models)), DENSER if response.sampled else 1
    omega = np.unique(np.concatenate([dense_grid(response, k, L, times) for k in numbers]))
    omega = omega[omega <= response.omega[-1]]
    P = np.stack([response.anywhere(k, omega)[0] for k in numbers], axis=1)
    Q, L = problem.lowpass.frequency_response(omega), L.frequency_response(omega)
    [at_cutoff], _ = response.anywhere(0, [np.clip(cutoff, omega[0], omega[-1])])
    unit = np.linalg.norm(at_cutoff, 2) or 1.0
    turn = Q * np.exp(1j * omega * TURN[-1] / cutoff)
    curves = [X.reshape(len(omega), -1) for X in (P / unit, Q[:, None, None] * L * unit, turn)]
    steps = np.linalg.norm(np.diff(np.hstack(curves), axis=0), axis=1)
    _, even = np.unique(np.cumsum(steps) // EVEN, return_index=True)
    even = np.unique([0, *even, len(steps)])
    return unit, *(X[even] for X in (omega, P, Q, L))


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
