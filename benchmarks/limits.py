"""Which solver for the quadratic program of a trial within limits?

The program is that of `ilctools.law.limits`, as it hands it to PIQP; CVXPY hands the same
matrices to PIQP with either of its factorisations, to Clarabel and, if it is installed, to OSQP.
Time is the solver's own; what is beyond a limit and the distance from the first solver's commands
are in W.
"""

from types import SimpleNamespace
from unittest.mock import patch

import cvxpy as cp
import numpy as np
import piqp
from runner import table

from ilctools import Law, LearningFilter, run_trials, zero_phase_butterworth
from rodlib import paper_loop
from rodlib.case import assumed_reference
from rodlib.paper import published

PIQP = {"solver": "PIQP", "compute_timings": True}
SOLVERS = {
    "PIQP": PIQP,
    "PIQP, by stages": PIQP | {"kkt_solver": piqp.KKTSolver.sparse_multistage},
    "Clarabel": {"solver": "CLARABEL"},
}
if "OSQP" in cp.installed_solvers():
    SOLVERS["OSQP, to 1e-6"] = {"solver": "OSQP", "eps_abs": 1e-6, "eps_rel": 1e-6}
TITLES = ["solver", "time (s)", "beyond (W)", "distance (W)"]


class Setup(Exception):
    """What PIQP is asked to set up."""


def program(limits):
    """The program between the first and the second trial of the rod, as PIQP gets it."""

    class Solver:
        settings = SimpleNamespace()

        def setup(self, *matrices):
            raise Setup(*matrices)

    loop, Q = paper_loop(), zero_phase_butterworth(2, 0.1, 1.0)
    L = LearningFilter(published.matrix("L_diagonal"), 1.0)
    run = run_trials(loop, Law(Q, None, limits=limits), assumed_reference(), trials=1)
    v, e, u = (run[name].values[0] for name in ("v", "e", "u"))
    with patch.object(piqp, "SparseSolver", Solver):
        try:
            Law(Q, L, limits=limits, loop=loop).next(v, e, u)
        except Setup as setup:
            return setup.args


def rows(limits):
    """A row of the table for each solver."""
    H, c, F, b, G, G_low, G_high, low, high = program(limits)
    z = cp.Variable(len(c), bounds=[low, high])
    cost = cp.quad_form(z, H, assume_PSD=True) / 2 + c @ z
    rules = [F @ z == b, *([G @ z >= G_low, G @ z <= G_high] if len(G_low) else [])]
    problem, commands = cp.Problem(cp.Minimize(cost), rules), {}
    for name, options in SOLVERS.items():
        problem.solve(**options)
        seconds = problem.solver_stats.solve_time
        commands[name] = z.value.reshape(2500, -1)[:, -2:]
        beyond = np.maximum(low - z.value, z.value - high).max()
        beyond = max(beyond, *(np.max(rule.violation()) for rule in rules))
        distance = np.abs(commands[name] - commands["PIQP"]).max()
        yield [name, f"{seconds:.2f}", f"{beyond:.1e}", f"{distance:.1e}"]


def main():
    """Print the tables."""
    for title, slew in (("limits of 20 W", ()), ("and of 0.05 W/s", (0.05,))):
        limits = dict.fromkeys(["Q1", "Q3"], (-20.0, 20.0, *slew))
        print(title, table(TITLES, [*rows(limits)]), sep="\n", end="\n\n")


if __name__ == "__main__":
    main()
