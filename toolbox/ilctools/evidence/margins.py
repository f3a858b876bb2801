"""How far may the plant be off before monotone convergence is lost? Margins that engineers know.

The plants P of a problem, in whose place stands, at each frequency omega, one of

    g P(omega),    exp(-j omega d Ts) P(omega),    P(a omega),    P(omega) + Delta, ||Delta|| <= r,

a gain g, a delay of d more samples, a plant slower by a in all, anything within a radius r: up to
which g, d, a, r is sigma_max(Q (I - P L)) below one at all frequencies, for all plants?
They are read off a grid that resolves the poles of P and L, of tables ten times as dense as it, by
steps outwards to the first that fails, and bisection. In g and r sigma_max is convex, so that there
is one limit; and one below g = 1 only if Q is above one somewhere. Phase margins of
``control.stability_margins`` are those of a feedback loop, which v = Q (v + L e) is from trial to
trial only.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from ilctools.evidence.peak import DENSER, dense_grid
from ilctools.evidence.robustness import within_radius
from ilctools.problem.problem import Problem, convergence_matrix

GAINS = np.geomspace(1, 10, 13)  # steps outwards; the last is where the search ends
TIMES = np.geomspace(1, 8, 25)
RADII = np.append(0, np.geomspace(1e-3, 10, 13))  # of sigma_max(P) at the cut-off
TURN = np.linspace(0, 2 * np.pi, 33)  # of the phase at the cut-off, by a delay
HALVINGS = 14  # of a step: to 1e-5 of what it is
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
    response = problem.design.response
    numbers, sampled = range(len(response.models)), response.sampled
    times = DENSER if sampled else 1
    omega = np.unique(np.concatenate([dense_grid(response, k, L, times) for k in numbers]))
    omega = omega[(omega <= response.omega[-1]) | (not sampled)]
    P = np.array([response.anywhere(k, omega)[0] for k in numbers])
    Q, L = problem.lowpass.frequency_response(omega), L.frequency_response(omega)
    P_at, Q_at, L_at = (
        make_interp_spline(omega, X, axis=axis) for X, axis in ((P, 1), (Q, 0), (L, 0))
    )
    ends = omega[0], omega[-1]
    size = np.linalg.norm(P_at(np.clip(problem.lowpass.cutoff, *ends))[0], 2)
    samples = TURN / (problem.lowpass.cutoff * problem.Ts)

    def sigma(P, Q=Q, L=L, radius=0.0):
        M = convergence_matrix(P, Q, L)
        rho_L = np.abs(Q)[:, None, None] * radius * L
        return max(within_radius(each, rho_L, 1.0).max() for each in M)

    def late(d):
        return sigma(np.exp(-1j * omega * d * problem.Ts)[:, None, None] * P)

    def slow(a):
        at = np.union1d(omega, np.clip(omega / a, *ends))
        at = at[(a * at <= ends[1]) | (not sampled)]
        return sigma(P_at(np.clip(a * at, *ends)), Q_at(at), L_at(at))

    return Margins(
        (_limit(lambda g: sigma(g * P), [1, 0]), _limit(lambda g: sigma(g * P), GAINS)),
        (_limit(lambda d: late(-d), samples), _limit(late, samples)),
        (_limit(lambda a: slow(1 / a), TIMES), _limit(slow, TIMES)),
        _limit(lambda r: sigma(P, radius=r * size), RADII),
    )


def _limit(sigma, steps):
    """How far from the first of some steps sigma stays below one; the last if there, too."""
    inside = outside = steps[0]
    for outside in steps:
        if sigma(outside) >= ONE:
            break
        inside = outside
    for _ in range(HALVINGS if outside != inside else 0):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if sigma(middle) < ONE else (inside, middle)
    return float(inside)
