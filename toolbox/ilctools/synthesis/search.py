"""Search for the filter of least gain among all filters of least peak."""

import reprlib
from dataclasses import replace

import numpy as np

from ilctools.errors import SolverError
from ilctools.problem.pose import pose
from ilctools.response.door import response_of
from ilctools.synthesis.design import certified, warn_of_findings
from ilctools.synthesis.everywhere import solve_everywhere
from ilctools.synthesis.result import Synthesis
from ilctools.synthesis.solver.program import Infeasible
from ilctools.threads import on_one_thread

ENOUGH = 1.5  # factor on the gain of a filter with the least peak: a bound that it meets easily
SAME_PEAK = (1e-9, 1e-6, 1e-4)  # relative differences, tried in turn, up to which peaks are equal


@on_one_thread
def least_gain(P, Q, omega=None, Ts=None, **choices) -> Synthesis:
    """Design the filter of least gain among all filters of least peak.

    The peak is the largest sigma_max(M) over the frequencies, (45) of the paper. One trial leaves
    at most this fraction of the remaining error. Without the bound (46) on L, many filters may have
    the least peak, although their gains differ by orders of magnitude. A solver then returns an
    arbitrary filter among them. This function returns the filter whose largest sigma_max(L) over
    the frequencies is least. The peak of this filter exceeds the least peak by a relative 1e-9 at
    most. If the solver cannot distinguish filters with such peaks, 1e-6 or 1e-4 is allowed instead.
    These tolerances are relative to the least peak, or to 1/100 of the peak for L = 0 if that is
    larger.

    Parameters and errors are the same as for :func:`synthesise`, but `objective` and `L_max` cannot
    be passed. Q must be given, and `base` must be None. The result is a design by (45) with (46),
    whose `problem.L_max` is the least gain.

    See Also
    --------
    synthesise : designs filters by (39) and (45)

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
                f"{name} = {reprlib.repr(choices[name])} must be left out, because least_gain "
                "looks for the least gain of L at the least peak: for a bound on L, call "
                "synthesise with objective='peak'"
            )
    known = choices.pop("uncertainty", None), choices.pop("scale", None)
    problem = pose(response_of(P, omega, Ts, *known, Q), Q, objective="peak", L_max=None, **choices)
    if not problem.square:
        raise ValueError(
            "least_gain searches among filters without base, which need as many learned "
            f"inputs as outputs, but P has {problem.m} inputs and {problem.p} outputs: call "
            "synthesise"
        )
    free = certified(problem)
    unit = ENOUGH * free.sigma_L.max()
    question = replace(problem, objective=replace(problem.objective, kind="gain"))
    for same in SAME_PEAK:
        try:
            with np.errstate(all="ignore"):
                room = same * problem.gap_scale(free.value)
                bounds = replace(problem.bounds, M_max=free.value + room, L_max=unit)
                least = replace(question, bounds=bounds)
                _, found = solve_everywhere(least)
            L_max = unit * found.largest
            break
        except (Infeasible, RuntimeError):
            continue
    else:
        raise SolverError(
            "the least gain was not found, because the filters with the least peak differ too "
            "little from each other: take a shorter filter, or synthesise with an L_max"
        )
    return warn_of_findings(
        certified(replace(problem, bounds=replace(problem.bounds, L_max=L_max)))
    )
