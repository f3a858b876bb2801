"""The cut-off of a Q that is left out: it follows from what is not known of P.

A lower cut-off makes |Q| smaller at each frequency, and with it M = Q (I - P L): up to the largest
cut-off, some filter keeps M_max for all plants. There nothing is left for the objective, whose mean
a cut-off a tenth lower takes from 0.77 to 0.09 in a motion stage of three gains, and from 0.74 to
0.33 in a resonance of three frequencies. So that is chosen.
"""

from collections.abc import Callable, Sequence

import numpy as np
from tqdm import tqdm

from ilctools.filters import ZeroPhaseButterworth
from ilctools.problem.grid import without_gaps
from ilctools.problem.problem import Problem
from ilctools.synthesis.everywhere import solve_everywhere
from ilctools.synthesis.solver.program import Infeasible

ORDER = 2  # of the Butterworth filter, as in the paper
SHARE = 0.9  # of the largest cut-off
HIGHEST = 0.999 * np.pi  # times 1 / Ts


def cutoff_that_holds(
    posed: Callable[..., Problem], bases: Sequence, lowest: float, Ts: float
) -> tuple[ZeroPhaseButterworth, str]:
    """Q with a share of the largest cut-off of two digits that keeps M_max, and that in words.

    `posed`: the problem, from b and Q. If even the lowest is too large, that is returned, and its
    design says what is too tight.
    """

    def with_cutoff(cutoff):
        return ZeroPhaseButterworth(ORDER, float(cutoff), Ts)

    problem = posed(bases[0], with_cutoff(lowest))
    if not problem.robust and problem.beyond is None:
        raise ValueError(
            "Q = None must be given: from one exact P no cut-off follows. Give "
            "zero_phase_butterworth(2, cutoff, Ts), or what else the plant may be: a list P, its "
            "uncertainty, or a measured_response"
        )
    candidates = _two_digits(lowest, HIGHEST / Ts)
    low, high = 0, len(candidates)
    with tqdm(desc="largest cut-off", unit=" solved", leave=False, delay=3, disable=None) as bar:
        while high - low > 1:
            middle = (low + high) // 2
            Q = with_cutoff(candidates[middle])
            holds = any(_feasible(lambda b=b, Q=Q: posed(b, Q)) for b in bases)
            low, high = (middle, high) if holds else (low, middle)
            bar.update()
    largest = candidates[low]
    Q = with_cutoff(max(SHARE * largest, lowest))
    return Q, (
        f"chosen: Q with cut-off {Q.cutoff:.4g} rad/s, {SHARE:g} of {largest:.4g}, the largest for "
        f"which M_max = {problem.M_max:g} can be met"
    )


def _two_digits(lowest, highest):
    """The numbers of two digits within a range, and its lowest."""
    decades = 10.0 ** np.arange(np.floor(np.log10(lowest)), np.log10(highest) + 1)
    numbers = np.round(np.outer(decades, np.arange(1, 10, 0.1)).ravel(), 12)
    return [lowest, *numbers[(numbers > lowest) & (numbers <= highest)]]


def _feasible(posed):
    """Whether a filter meets the bounds of a problem."""
    try:
        problem = without_gaps(posed())
        with np.errstate(all="ignore"):
            solve_everywhere(problem)
    except (Infeasible, RuntimeError, ValueError):
        return False
    return not problem.findings  # where P is not known, M may be |Q| at least
