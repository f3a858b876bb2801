"""Our default against what a user would design by hand, on plants that are not the design's.

`make peers` runs it and writes its table to figures/performance.md. All know the same P and the
same Q, and are judged on another plant: the mean of sigma_max(M) over the logarithm of frequency up
to the cut-off, its maximum, and the RMS of the error in trials 2 and 5 on the bench, with noise.
"""

import sys
import warnings

import control
import numpy as np
from kinds import KINDS, Kind, bump, driver, of_model
from runner import publish, run, table

from rodlib import (
    ClosedLoop,
    Law,
    LearningFilter,
    NormOptimal,
    convergence,
    current_trial_loop,
    fit_heat_balance,
    heat_balance,
    read_table,
    record,
    rms,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.paper.repository import ROOT

GAINS = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.4)  # of the PD law, in 1 / |P| at rest
SLOPES = (0.0, *np.geomspace(0.3, 60, 12))  # samples, relative to the gain
LEADS = np.unique([*range(1, 21), *np.geomspace(20, 80, 12).astype(int)])  # samples
RIDGE = 1e-3  # of the least-squares inverse, in |P|
WEIGHT = 1e-2  # of norm-optimal learning, in |P|^2
BOARDS = ("board-1s", "board-3s")
BEST = 1.2  # times the best of the others: no worse is the goal
S = control.tf("s")


def resonance(w, damping):
    """A system of second order with a gain of one."""
    return w**2 / (S**2 + 2 * damping * w * S + w**2)


def stage(off):
    """A controller that leaves a resonance within the cut-off; off by 3 % in its frequency."""
    return resonance(62.8 * (1 - 0.03 * off), 0.05), 1e-3, 100.0, 1000


def arm(off):
    """A well damped loop with a sharp resonance beyond the cut-off."""
    share = 1 - 0.03 * off
    P = 0.95 * resonance(50 * share, 0.7) + 0.05 * resonance(151 * share, 0.01)
    return P, 1e-3, 60.0, 800


def belt(off):
    """A load behind a belt, with an antiresonance below its resonance."""
    share = 1 - 0.03 * off
    P = resonance(40 * share, 0.05) / resonance(30 * share, 0.05) * 60 / (S + 60)
    return P, 5e-3, 60.0, 600


def converter(off):
    """The filter of a power converter, by its circuit; off in both of its parts."""
    L, C = 1e-3 * (1 + 0.1 * off), 1e-3 * (1 - 0.1 * off)
    P = 1 / (L * C * S**2 + (0.2 * C + L / 5) * S + 1.04)
    return P, 2e-4, 1500.0, 400


RESONANT = {kind.__name__: kind for kind in (stage, arm, belt, converter)}


def with_own_controller(kind):
    """A kind of a transfer function from w to y, which is known at rest."""
    (P, Ts, cutoff, samples), (rig, *_) = kind(0.0), kind(1.0)
    loop = ClosedLoop(control.sample_system(control.ss(P), Ts))
    return Kind(loop, of_model(rig, Ts, 1e-3), bump(samples, [1.0]), cutoff)


def board(name):
    """A real heater board, by its log; the bench is the other one."""
    values = {}
    for key in BOARDS:
        inputs = {"Q1": "Heater 1", "Q2": "Heater 2"}
        outputs = {"T1": "Temperature 1", "T2": "Temperature 2"}
        path = ROOT / "data" / "tclab" / f"{key}.csv"
        log = read_table(path, time=0, inputs=inputs, outputs=outputs)
        values[key] = fit_heat_balance(log.u[0], log.y[0], log.Ts).values
    [other] = values.keys() - {name}
    model, rig = (heat_balance(*values[key], 3.0) for key in (name, other))
    sizes = {"T1": 10.0, "T2": 8.0, "Q1": 30.0, "Q2": 40.0}
    loop = current_trial_loop(model, ["Q1", "Q2"], sizes=sizes)
    bench = of_model(rig[:, :2], 3.0, 0.05)
    return Kind(loop, bench, bump(300, [12.0, 6.0]), 0.05)


def kind_of(name):
    """A kind whose bench is off by some ten percent."""
    if name in BOARDS:
        return board(name)
    return with_own_controller(RESONANT[name]) if name in RESONANT else KINDS[name](1.0)


def proportional_derivative(problem, cutoff):
    """The best of a grid for each channel, by the mean up to the cut-off, with sigma < 0.9."""
    P, omega, m = problem.P, problem.omega, problem.channels
    z = np.exp(1j * omega * problem.Ts)
    share = np.gradient(np.log(omega)) * (omega <= cutoff)
    coefficients = np.zeros((m, m, LEADS[-1]))
    for i in range(m):
        best = np.inf
        gains = np.array(GAINS) / np.abs(P[0, i, i])
        for lead in LEADS:
            for slope in SLOPES[: None if lead > 1 else 1]:
                shape = z**lead * (1 + slope * (1 - 1 / z))
                sigma = np.abs(problem.Q * (1 - np.outer(gains, P[:, i, i] * shape)))
                means = np.where(sigma.max(axis=1) < 0.9, sigma @ share, np.inf)
                k = means.argmin()
                if means[k] < best:
                    best, c = means[k], np.zeros(LEADS[-1])
                    c[lead - 1] += gains[k] * (1 + slope)
                    c[lead - 2] -= gains[k] * slope
        if best == np.inf:
            return None
        coefficients[i, i] = c
    return LearningFilter(coefficients, problem.Ts)


def least_squares(problem):
    """The filter of the same order that minimises the sum of |Q (I - P L)|^2, with a ridge."""
    P, m, order = problem.P, problem.channels, problem.order
    z = np.exp(1j * np.outer(problem.omega * problem.Ts, np.arange(1, order + 1)))
    matrix = np.einsum("n,nij,nk->nijk", problem.Q, P, z).reshape(-1, m * order)
    ridge = RIDGE * np.linalg.norm(P[0], 2) * np.eye(m * order)
    matrix = np.vstack([matrix.real, matrix.imag, ridge])
    target = (problem.Q[:, None, None] * np.eye(m)).reshape(-1, m)
    target = np.vstack([target.real, target.imag, np.zeros((m * order, m))])
    x = np.linalg.lstsq(matrix, target)[0].reshape(m, order, m)
    return LearningFilter(x.transpose(0, 2, 1), problem.Ts)


def norm_optimal(problem, samples):
    """Norm-optimal learning, which needs a model."""
    if problem.model is None:
        return None
    weight = WEIGHT * np.linalg.norm(problem.P[0], 2) ** 2
    return NormOptimal(problem.models[0], weight, samples)


def judged(kind, Q, L, omega):
    """Mean and maximum of sigma_max(M) on the bench's own plant, RMS of trials 2 and 5."""
    loop, plant = kind.loop, kind.linear or kind.bench
    if isinstance(loop, ClosedLoop):
        P = plant.linear(loop.Ts, loop.references, loop.outputs)
    else:
        linear = plant.linear(loop.Ts, loop.controls, loop.outputs)
        P = loop.around(linear)[:, : len(loop.outputs)]
    reached = convergence(P, Q, L, omega)
    law = Law(Q, L, limits={})
    stop = dict.fromkeys([*loop.outputs, *loop.commands])
    log = record(driver(kind), loop, law, kind.reference, trials=5, stop=stop, pause=0)
    e = rms(log.e).values
    return reached.mean((omega[0], kind.cutoff)), reached.gamma, e[1], e[4]


def row(name):
    """The four designs of a kind, each with its four numbers; None where there is none."""
    kind = kind_of(name)
    Q = zero_phase_butterworth(2, kind.cutoff, kind.loop.Ts)
    omega = np.geomspace(kind.cutoff / 1000, np.pi / kind.loop.Ts, 1200)
    with warnings.catch_warnings(action="ignore"):
        design = synthesise(kind.loop if kind.P is None else kind.P, Q)
        problem = design.problem
        filters = {
            "ours": design.filter,
            "PD": proportional_derivative(problem, kind.cutoff),
            "least squares": least_squares(problem),
            "norm-optimal": norm_optimal(problem, len(kind.reference)),
        }
        results = {key: L and judged(kind, Q, L, omega) for key, L in filters.items()}
    return name, problem.order, problem.L_max, results


def table_of(rows):
    """The rows as a table in Markdown, and where ours is worse than the goal."""
    lines, worse = [], []
    for name, order, L_max, results in rows:
        ours, *others = results.values()
        best = min(other[0] for other in others if other)
        if ours[0] > BEST * best:
            worse.append(f"{name} ({ours[0] / best:.2g})")
        cells = [
            ", ".join(f"{value:.2g}" for value in numbers) if numbers else "none"
            for numbers in results.values()
        ]
        lines.append([name, f"{order}", f"{L_max:g}", *cells])
    titles = ["kind", "order", "L_max", "ours", "PD", "least squares", "norm-optimal"]
    misses = ", ".join(worse) or "none"
    return (
        f"{table(titles, lines)}\n\n{len(rows)} kinds; ours is more than {BEST} times the best "
        f"mean of the others for: {misses}.\n"
    )


def main(chosen):
    """Print the table; without names it goes to figures/performance.md."""
    names = chosen or [*KINDS, *RESONANT, *BOARDS]
    text = table_of(list(run(row, names)))
    print(text)
    if not chosen:
        publish("peers", text)


if __name__ == "__main__":
    main(sys.argv[1:])
