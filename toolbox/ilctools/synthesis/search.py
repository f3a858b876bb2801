"""Designs that search for more than a filter: the least gain, the largest cut-off of Q."""

import reprlib
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq
from tqdm import tqdm

from ilctools import arguments
from ilctools.filters import ZeroPhaseButterworth
from ilctools.problem.grid import refined, without_gaps
from ilctools.problem.pose import pose
from ilctools.synthesis.design import certified, insist, warned
from ilctools.synthesis.everywhere import solve_everywhere
from ilctools.synthesis.result import SolverError, Synthesis
from ilctools.synthesis.solver.program import Infeasible
from ilctools.synthesis.solver.threads import on_one_thread

SAME = (1e-9, 1e-6, 1e-4)  # relative distance up to which two peaks are the same
CLOSE = 1e-3  # relative distance from the largest cut-off
ROUNDS = 20  # in each of which a frequency is added, where M passed one between those of omega


@on_one_thread
def least_gain(P, Q, omega=None, Ts=None, **choices) -> Synthesis:
    """Design the one filter of (45) that has a rule: of least gain among those of least peak.

    Without (46) the least peak of sigma_max(M) may be reached by many filters, whose gains differ
    by orders of magnitude; which of them a solver returns is its own affair. This is the one with
    the least max sigma_max(L) that keeps the least peak to a relative 1e-9; where filters that do
    are too much alike for the solver to tell, to 1e-6 or 1e-4.

    Parameters and errors as for :func:`synthesise`, apart from `objective` and `L_max`.
    The result is that of (45) with (46), where `problem.L_max` is that gain.

    See Also
    --------
    synthesise : (39) and (45)

    Examples
    --------
    >>> import control
    >>> P = control.sample_system(control.tf([400], [1, 20, 400]), 0.01)
    >>> import numpy as np
    >>> from ilctools import least_gain, zero_phase_butterworth
    >>> omega = np.geomspace(0.1, 100 * np.pi, 60)
    >>> design = least_gain(P, zero_phase_butterworth(2, 40.0, 0.01), omega, order=8)
    >>> bool(design.sigma_M.max() < 0.5)
    True
    """
    for name in ("objective", "L_max", "base"):
        if name in choices and (name, choices[name]) != ("base", None):
            raise ValueError(
                f"{name} = {reprlib.repr(choices[name])} must be left out: asked is the least "
                'gain of the least peak; with a bound on L, synthesise(objective="peak")'
            )
    problem = pose(P, Q, omega, Ts, objective="peak", L_max=None, **choices)
    free = certified(problem)
    unit = free.sigma_L.max()  # a gain that is enough
    question = without_gaps(replace(problem, objective="gain", L_max=unit))
    for same in SAME:
        try:
            with np.errstate(all="ignore"):
                room = same * problem.unit(free.value)
                _, found = solve_everywhere(replace(question, M_max=free.value + room))
            L_max = unit * found.largest
            break
        except (Infeasible, RuntimeError):
            continue
    else:
        raise SolverError(
            "the least gain was not found: filters that keep the least peak are too much alike; "
            "take a shorter filter, or synthesise with an L_max"
        )
    return warned(certified(replace(problem, L_max=L_max)))


@on_one_thread
def largest_cutoff(
    P, Q: ZeroPhaseButterworth, omega=None, Ts=None, **choices
) -> tuple[ZeroPhaseButterworth, Synthesis]:
    """Find the largest cut-off of Q for which a filter meets the bounds, and design that.

    A lower cut-off makes |Q| smaller at each frequency, and with it M: the smallest M_max that can
    be met increases with the cut-off, and its root is found. Nothing is left for the objective
    there: a little below the largest cut-off, learning is faster. Where M of a plant that is a
    model would pass one between the frequencies of `omega`, it is bounded there, too.

    Parameters
    ----------
    P, omega, Ts, **choices
        As for :func:`synthesise`.
    Q : ZeroPhaseButterworth
        Its order is kept; the search starts at its cut-off, which says what is chosen by default.

    Returns
    -------
    Q : ZeroPhaseButterworth
        With the largest cut-off, to a relative 1e-3; at most 0.999 of the Nyquist frequency.
    design : Synthesis
        For it. Raises as :func:`synthesise`, if even a cut-off at the lowest design frequency is
        too high.
    """
    arguments.instance("Q", Q, ZeroPhaseButterworth)
    stated = pose(P, Q, omega, Ts, **choices)
    for name in ("order", "band", "L_max"):  # whatever Q will be
        choices[name] = getattr(stated, name)
    further = np.empty(0)

    def posed(Q, **changes):
        problem = pose(P, Q, stated.omega, Ts, **choices | changes)
        return refined(problem, further)

    with tqdm(desc="largest cut-off", unit=" solved", leave=False, disable=None) as bar:
        for _ in range(ROUNDS):
            Q = _widest(Q, posed, stated, bar, step=0.1 if len(further) else 1.0)
            design = certified(posed(Q), check=False)
            if design.certificate.unseen is None:
                break
            # M passed one where omega is coarse
            further = np.append(further, design.certificate.unseen.omega)
    insist(design.certificate)
    return Q, warned(design)


def _widest(Q, posed, stated, bar, step):
    """Q with the largest cut-off for which the bounds can be met; `step`: of its logarithm."""

    def with_cutoff(logarithm):
        return replace(Q, cutoff=float(np.exp(logarithm)))

    def excess(logarithm):
        """The smallest possible M_max with this cut-off, relative to the one that is asked for."""
        problem = without_gaps(posed(with_cutoff(logarithm), objective="peak", reference=None))
        _, solution = solve_everywhere(replace(problem, M_max=np.inf))
        bar.update()
        largest = solution.largest
        if problem.beyond is not None:  # where P is not known, M may be |Q| at least
            largest = max(largest, *problem.Q_beyond(stated.omega[-1:]))
        return largest / stated.M_max - 1

    lowest = np.log(stated.omega[stated.omega > 0][0])
    highest = np.log(0.999 * np.pi / Q.Ts)
    low = high = np.log(Q.cutoff)
    while excess(high) <= 0:
        if high >= highest:
            return with_cutoff(highest)
        low, high = high, min(high + step, highest)
    while excess(low) > 0:
        if low <= lowest:  # the design says what is too tight
            return with_cutoff(lowest)
        low, step = max(low - step, lowest), 2 * step
    return with_cutoff(brentq(excess, low, high, xtol=CLOSE / 2) - CLOSE / 2)
