"""Which solver for the quadratic program of a trial within limits? `make solvers` prints a table.

The program is that of `rodlib.ilc.law.limits`, as it hands it to PIQP; the same matrices go to
PIQP with its solver for stages, to Clarabel and to OSQP. Time is the least of three runs, setup
included; what is beyond a limit and the distance of v from PIQP's are in W and K for the rod.
"""

import time

import clarabel
import numpy as np
import osqp
import piqp
from scipy import sparse

from rodlib import Law, LearningFilter, paper_loop, run_trials, zero_phase_butterworth
from rodlib.case import assumed_reference
from rodlib.paper import published

given = []  # what was handed to PIQP


class Spy(piqp.SparseSolver):
    """PIQP, and what it is asked."""

    def setup(self, *arguments):
        given[:] = arguments
        super().setup(*arguments)


def trial(limits):
    """The second trial of the rod: the program between the first and it."""
    loop, Q = paper_loop(), zero_phase_butterworth()
    L = LearningFilter(published.matrix("L_diagonal"), 1.0)
    run = run_trials(loop, Law(Q, None, limits=limits), assumed_reference(), trials=1)
    original, piqp.SparseSolver = piqp.SparseSolver, Spy
    try:
        v, e, u = (run[name].values[0] for name in ("v", "e", "u"))
        Law(Q, L, limits=limits, loop=loop).next(v, e, u)
    finally:
        piqp.SparseSolver = original


def by_piqp(backend):
    """With a factorisation of the whole matrix, or of one stage after the other."""

    def solve(*program):
        solver = piqp.SparseSolver()
        solver.settings.kkt_solver = backend
        solver.setup(*program)
        return str(solver.solve()), solver.result.x

    return solve


def by_clarabel(H, c, F, b, G, low, high):
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    A = sparse.csc_matrix(sparse.vstack([F, G, -G]))
    cones = [clarabel.ZeroConeT(len(b)), clarabel.NonnegativeConeT(2 * len(low))]
    given = (
        sparse.csc_matrix(sparse.triu(H)),
        c,
        A,
        np.concatenate([b, high, -low]),
        cones,
    )
    solution = clarabel.DefaultSolver(*given, settings).solve()
    return str(solution.status), np.array(solution.x)


def by_osqp(H, c, F, b, G, low, high):
    solver = osqp.OSQP()
    A = sparse.csc_matrix(sparse.vstack([F, G]))
    bounds = np.concatenate([b, low]), np.concatenate([b, high])
    accuracy = {"eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 20000}
    H = sparse.csc_matrix(sparse.triu(H))
    solver.setup(H, c, A, *bounds, verbose=False, **accuracy)
    result = solver.solve()
    return result.info.status, result.x


SOLVERS = {
    "PIQP": by_piqp(piqp.KKTSolver.sparse_ldlt),
    "PIQP, by stages": by_piqp(piqp.KKTSolver.sparse_multistage),
    "Clarabel": by_clarabel,
    "OSQP, to 1e-6": by_osqp,
}


def main():
    """Print the table."""
    for case, more in (("limits of 20 W", ()), ("and 0.05 W/s", (0.05,))):
        trial(dict.fromkeys(["Q1", "Q3"], (-20.0, 20.0, *more)))
        program, reached = list(given), {}
        print(
            f"{case}: {program[0].shape[0]} unknowns, {len(program[5])} rows with two limits"
        )
        for name, solve in SOLVERS.items():
            times = []
            for _ in range(3):
                start = time.perf_counter()
                status, z = solve(*program)
                times.append(time.perf_counter() - start)
            reached[name] = z.reshape(2500, -1)[:, -2:]
            rows = program[4] @ z
            beyond = np.maximum(program[5] - rows, rows - program[6]).max()
            apart = np.abs(reached[name] - reached["PIQP"]).max()
            print(
                f"  {name:16}{min(times):7.2f} s  {beyond:9.1e}  {apart:9.1e}  {status}"
            )


if __name__ == "__main__":
    main()
