"""Our default against what a user would design by hand, on plants that are not the design's.

`make measure WHAT=peers` runs it and writes its table to figures/performance.md. All know the same
P and the same Q, and are judged on two other plants, off to either side: the mean of sigma_max(M)
over the logarithm of frequency up to the cut-off, its maximum, the RMS of the error in trials 2 and
5 on the bench, with noise, and the largest gain of L.
"""

import warnings
from itertools import product

import control
import numpy as np
from kinds import KINDS, Kind, bump, driver, of_model
from runner import publish, run, table

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    NormOptimal,
    convergence,
    current_trial_loop,
    read_table,
    record,
    rms,
    synthesise,
    zero_phase_butterworth,
)
from rodlib import fit_heat_balance, heat_balance
from rodlib.paper.repository import ROOT

GAINS = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.4)  # of the PD law, in 1 / |P| at rest
SLOPES = (0.0, *np.geomspace(0.3, 60, 12))  # samples, relative to the gain
LEADS = np.unique([*range(1, 21), *np.geomspace(20, 80, 12).astype(int)])  # samples
RIDGE = 1e-3  # of the least-squares inverse, in |P|
RIDGES = np.geomspace(RIDGE, 100, 101)  # of which the first keeps the gain within L_max
WEIGHT = 1e-2  # of norm-optimal learning, in |P|^2
BOARDS = ("board-1s", "board-3s")
BEST = 1.2  # times the best of the others: no worse is the goal
OFF = (1.0, -1.0)  # of the rigs, in some ten percent
DESIGNS = {  # and what a user has to say for each
    "ours": "nothing",
    "PD": "gains, slopes, leads",
    "least squares": "order, ridge",
    "least squares within L_max": "order, ridge by the gain",
    "norm-optimal": "model, weight, samples",
}
REACH = ("PD", "least squares within L_max")  # those that can do no more than ours
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


def with_own_controller(kind, off):
    """A kind of a transfer function from w to y, which is known at rest."""
    (P, Ts, cutoff, samples), (rig, *_) = kind(0.0), kind(off)
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


def kind_of(name, off):
    """A kind whose bench is off by some ten percent."""
    if name in BOARDS:
        return board(name)
    if name in RESONANT:
        return with_own_controller(RESONANT[name], off)
    return KINDS[name](off)


def proportional_derivative(problem, cutoff):
    """The best of a grid for each channel, by the mean up to the cut-off, with sigma < 0.9."""
    P, omega, m = problem.P, problem.omega, problem.channels
    z = np.exp(1j * omega * problem.Ts)[:, None]
    share = np.gradient(np.log(omega)) * (omega <= cutoff)
    coefficients = np.zeros((m, m, LEADS[-1]))
    for i in range(m):
        candidates = []
        for lead, slope in product(LEADS, SLOPES):
            if lead == 1 and slope:  # it would need the present error
                continue
            gains = np.array(GAINS) / np.abs(P[0, i, i])
            L = gains * z**lead * (1 + slope * (1 - 1 / z))
            sigma = np.abs(problem.Q[:, None] * (1 - P[:, i, i, None] * L))
            means = np.where(sigma.max(axis=0) < 0.9, share @ sigma, np.inf)
            candidates.append((means.min(), gains[means.argmin()], lead, slope))
        mean, gain, lead, slope = min(candidates)
        if mean == np.inf:
            return None
        coefficients[i, i, lead - 1] = gain * (1 + slope)
        coefficients[i, i, lead - 2] -= gain * slope
    return LearningFilter(coefficients, problem.Ts)


def least_squares(problem, share=RIDGE):
    """The filter of the same order that minimises the sum of |Q (I - P L)|^2, with a ridge."""
    P, m, order = problem.P, problem.channels, problem.order
    z = np.exp(1j * np.outer(problem.omega * problem.Ts, np.arange(1, order + 1)))
    matrix = np.einsum("n,nij,nk->nijk", problem.Q, P, z).reshape(-1, m * order)
    ridge = share * np.linalg.norm(P[0], 2) * np.eye(m * order)
    matrix = np.vstack([matrix.real, matrix.imag, ridge])
    target = (problem.Q[:, None, None] * np.eye(m)).reshape(-1, m)
    target = np.vstack([target.real, target.imag, np.zeros((m * order, m))])
    x = np.linalg.lstsq(matrix, target)[0].reshape(m, order, m)
    return LearningFilter(x.transpose(0, 2, 1), problem.Ts)


def within(problem):
    """The same with the smallest ridge for which its gain is no larger than ours may be."""
    filters = (least_squares(problem, share) for share in RIDGES)
    return next(L for L in filters if gain(L, problem.Ts) <= problem.L_max)


def gain(L, Ts):
    """The largest singular value of a filter; none of norm-optimal learning, which is none."""
    if not isinstance(L, LearningFilter):
        return np.nan
    response = L.frequency_response(np.linspace(0, np.pi / Ts, 2000))
    return np.linalg.norm(response, 2, axis=(1, 2)).max()


def norm_optimal(problem, samples):
    """Norm-optimal learning, which needs a model."""
    if problem.model is None:
        return None
    weight = WEIGHT * np.linalg.norm(problem.P[0], 2) ** 2
    return NormOptimal(problem.models[0], weight, samples)


def judged(kind, Q, L, omega):
    """Mean and maximum of sigma_max(M) on the bench's own plant, RMS of trials 2 and 5."""
    loop, reached = kind.loop, convergence(kind.P, Q, L, omega)
    law = Law(Q, L, limits={})
    stop = dict.fromkeys([*loop.outputs, *loop.commands])
    log = record(driver(kind), loop, law, kind.reference, trials=5, stop=stop, pause=0)
    e = rms(log.e).values
    return reached.mean((omega[0], kind.cutoff)), e[1], e[4], reached.gamma


def row(name):
    """The designs of a kind, each with its five numbers; None where there is none."""
    kinds = [kind_of(name, off) for off in (OFF[:1] if name in BOARDS else OFF)]
    kind, results = kinds[0], []
    Ts = kind.loop.Ts
    Q = zero_phase_butterworth(2, kind.cutoff, Ts)
    omega = np.geomspace(kind.cutoff / 1000, np.pi / Ts, 1200)
    with warnings.catch_warnings(action="ignore"):
        design = synthesise(kind.loop if kind.known is None else kind.known, Q)
        problem = design.problem
        filters = (
            design.filter,
            proportional_derivative(problem, kind.cutoff),
            least_squares(problem),
            within(problem),
            norm_optimal(problem, len(kind.reference)),
        )
        for L in filters:
            if L is None:
                results.append(None)
                continue
            each = np.array([judged(off, Q, L, omega) for off in kinds])
            mean, second, fifth, _ = each.mean(axis=0)
            results.append((mean, each[:, 3].max(), second, fifth, gain(L, Ts)))
    return name, problem.order, problem.L_max, dict(zip(DESIGNS, results, strict=True))


def worse(rows, others):
    """Where ours is worse than the goal, of those for which all trials shrink the error."""
    found = []
    for name, *_, results in rows:
        means = [x[0] for key in others if (x := results[key]) and x[1] < 1]
        ratio = results["ours"][0] / min(means, default=np.inf)
        if ratio > BEST:
            found.append(f"{name} ({ratio:.2g})")
    return ", ".join(found) or "none"


def table_of(rows):
    """The rows as a table in Markdown, and where ours is worse than the goal."""
    lines = []
    for name, order, L_max, results in rows:
        cells = [
            ", ".join(f"{x:.2g}" for x in numbers if np.isfinite(x)) if numbers else "none"
            for numbers in results.values()
        ]
        lines.append([name, f"{order}", f"{L_max:g}", *cells])
    titles = [f"{name}; said: {said}" for name, said in DESIGNS.items()]
    _, *others = DESIGNS
    return f"""{table(["kind", "order", "L_max", *titles], lines)}

{len(rows)} kinds. Ours is more than {BEST} times the best mean of the PD law and of least squares
within L_max for: {worse(rows, REACH)}; of all that keep sigma_max(M) below one, for:
{worse(rows, others)}.
"""


if __name__ == "__main__":
    publish("peers", table_of(list(run(row, [*KINDS, *RESONANT, *BOARDS]))))
