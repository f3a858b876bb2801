"""Learning within limits, as in notebook 14, for longer and with more draws.

The rod at three limits, 20 trials each, against the best that CVXPY finds; and boards of cold
heaters whose noise is drawn ten times. Both tables go to figures/performance.md.
"""

import warnings
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO

import cvxpy as cp
import numpy as np
from runner import publish, run, table

from ilctools import (
    Law,
    LearningFilter,
    NormOptimal,
    current_trial_loop,
    record,
    rms,
    run_trials,
    synthesise,
    trial_operators,
    zero_phase_butterworth,
)
from rodlib import TemperatureControlLab, assumed_reference, heat_balance, paper_loop
from rodlib.paper import published

DRAWS, TRIALS, REST, LIMITS = 10, 20, 50, (24.0, 20.0, 16.0)  # W
PHASE = np.clip((2 * np.arange(300.0)[:, None] - [20, 70]) / 500, 0, 1)
WARM = [10.0, 8.0] * np.sin(np.pi * PHASE) ** 2  # K above rest
COLD_TRIALS, COLD_REST = 10, 15
TITLES = ["law, within (K)", "norm-optimal, within", "best", "law to best", "bound"]
WAYS = ["law (23)", "observer informed", "law informed, too", "within", "norm-optimal"]


def best_within(limit, plant, reference):
    """The outputs nearest to the reference that inputs of at most `limit` can have."""
    A, B, C = plant.A, plant.B[:, :2], plant.C
    x, u = cp.Variable((len(reference), len(A))), cp.Variable(reference.shape)
    kept = [x[0] == 0, x[1:] == x[:-1] @ A.T + u[:-1] @ B.T, cp.abs(u) <= limit]
    cost = cp.sum_squares(reference - x @ C.T)
    cp.Problem(cp.Minimize(cost), kept).solve(cp.CLARABEL)
    return x.value @ C.T


def of_rod(limit):
    """A row of the first table."""
    loop, Q, reference = paper_loop(), zero_phase_butterworth(2, 0.1, 1.0), assumed_reference()
    L = LearningFilter(published.matrix("L_diagonal"), 1.0)
    optimal = NormOptimal(loop.P, 0.1, len(reference))
    law = Law(Q, L, REST, limits=dict.fromkeys(loop.controls, (-limit, limit)))
    wide = zero_phase_butterworth(1, 3.14, 1.0)  # near one
    with warnings.catch_warnings(action="ignore"):  # that commands are cut off
        learned, other = (
            run_trials(loop, each, reference, trials=TRIALS)
            for each in (law, replace(law, Q=wide, L=optimal))
        )
    v, e, y = (learned[name][-1].values for name in "vey")
    P = trial_operators(loop.P, Q, L, len(reference))[0]
    change = v - replace(law, limits=None).next(v, e)
    bound = (P @ change.ravel()).reshape(e.shape) + e
    best = best_within(limit, loop.plant, reference)
    sizes = [e, other.e[-1].values, reference - best, y - best, bound]
    return [f"{np.linalg.norm(x) / np.sqrt(len(x)):.4f}" for x in sizes]


def of_board(seed):
    """RMS of the last trial from cold heaters by each way, of a row of the second table."""
    balance = heat_balance(0.035, 0.0175, 0.05, 0.01, 140.0, 2.0)
    sizes = {"T1": 10.0, "T2": 8.0, "Q1": 30.0, "Q2": 40.0}
    loop = current_trial_loop(balance, ["Q1", "Q2"], sizes=sizes)
    Q = zero_phase_butterworth(2, 0.1, loop.Ts)
    omega = np.geomspace(1e-3, 1, 300) * np.pi / loop.Ts
    bounds = {"M_max": 0.9, "L_max": 50.0, "band": (omega[0], 0.1 / 3), "order": 10}
    bounds["structure"] = "diagonal"
    law = Law(Q, synthesise(loop, Q, omega, loop.Ts, **bounds).filter, COLD_REST)
    wide = zero_phase_butterworth(1, 3.14 / loop.Ts, loop.Ts)
    optimal = replace(law, Q=wide, L=NormOptimal(loop.P, 0.1, len(WARM)))

    def recorded(law, board=None, trials=COLD_TRIALS, v=None):
        board = board or TemperatureControlLab(rest=(0.0, 0.0), seed=seed)
        return record(board, loop, law, WARM, trials=trials, v=v, pause=0)

    def by_hand(informed):
        board, v = TemperatureControlLab(rest=(0.0, 0.0), seed=seed), 0 * WARM
        for _ in range(COLD_TRIALS):
            run = recorded(Law(Q, None), board, 1, v)
            u, applied, e = (run[name][0].values for name in ("u", "applied", "e"))
            v = law.next(loop.realised(v, u, applied) if informed else v, e)
        return run

    with warnings.catch_warnings(action="ignore"), redirect_stdout(StringIO()):
        runs = [recorded(replace(law, limits={})), by_hand(False), by_hand(True)]
        runs += [recorded(law), recorded(optimal)]
    return [rms(run.e).values[-1] for run in runs]


def main():
    """Both tables go to figures/performance.md."""
    rows = [
        [f"{limit:g}", *cells] for limit, cells in zip(LIMITS, run(of_rod, LIMITS), strict=True)
    ]
    drawn = [*run(of_board, range(1, DRAWS + 1))]
    ends = zip(np.min(drawn, axis=0), np.max(drawn, axis=0), strict=True)
    others = [["heaters from cold", *(f"{a:.3f} to {b:.3f}" for a, b in ends)]]
    tables = table(["limit (W)", *TITLES], rows), table(["RMS (K)", *WAYS], others)
    publish("saturation", "\n\n".join(tables) + "\n")


if __name__ == "__main__":
    main()
