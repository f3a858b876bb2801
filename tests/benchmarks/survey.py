"""Does the synthesis end well for ordinary plants? A survey of many problems, drawn by seed.

`make survey` runs it and writes the counts to figures/performance.md; `survey.py 17 42` shows two
of the problems. Drawn are lags, integrators under feedback,
delays, resonances, non-minimum-phase plants, tanks and random plants of size 1 to 4, also badly
scaled, with orders from 1 to 40 and 100 to 2000 frequencies. The bounds of every other problem hold
for more plants than one: further ones, all within a radius, or both. Each must end with a certified
filter, or with an InfeasibleError whose smallest M_max CVXPY confirms on a sample.
"""

import os
import sys
import time
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import control
import numpy as np
from tqdm import tqdm

from rodlib import InfeasibleError, synthesise, zero_phase_butterworth
from rodlib.ilc.files import write_whole
from rodlib.ilc.filters import ZeroPhaseButterworth
from rodlib.ilc.models import frequency_response
from rodlib.ilc.problem.pose import pose
from rodlib.ilc.synthesis.design import certified
from rodlib.ilc.synthesis.result import SolverError
from rodlib.paper.ledger import splice
from rodlib.paper.repository import ROOT

PROBLEMS = 550
FAMILIES = (
    "lag", "two lags", "motion stage", "tanks", "slow integrator", "short delay", "long delay",
    "resonance", "non-minimum phase", "random", "badly scaled",
)  # fmt: skip


@dataclass(frozen=True)
class Problem:
    """One problem of the survey: the arguments of synthesise, and what it is."""

    number: int
    family: str
    P: list[np.ndarray]
    Q: np.ndarray
    omega: np.ndarray
    Ts: float
    options: dict
    model: control.StateSpace  # what P is the response of, without what is uncertain
    filter: ZeroPhaseButterworth


def lag(T, Ts):
    """1 / (T s + 1) behind a zero-order hold."""
    a = np.exp(-Ts / T)
    return control.ss(a, 1 - a, 1, 0, Ts)


def under_feedback(plant, crossover):
    """The unit feedback loop of a plant with a proportional gain for a given crossover."""
    gain = 1 / np.abs(plant(np.exp(1j * crossover * plant.dt)))
    loop = control.feedback(gain * plant, 1)
    for _ in range(40):
        if np.abs(loop.poles()).max() < 0.9999:
            return loop
        gain /= 1.5
        loop = control.feedback(gain * plant, 1)
    raise ValueError("no gain stabilises this plant")


def plant_of(family, rng, order):
    """A stable loop of the family, with unit gain at frequency zero unless it is random."""
    s = control.tf("s")
    Ts = float(rng.choice([0.001, 0.1, 1.0, 60.0]))
    if family == "lag":
        return lag(Ts * 10 ** rng.uniform(0, 2.5), Ts)
    if family == "two lags":
        return lag(Ts * 10 ** rng.uniform(0, 2), Ts) * lag(
            Ts * 10 ** rng.uniform(0, 2), Ts
        )
    if family == "motion stage":
        T = Ts * 10 ** rng.uniform(1, 2)
        stage = control.sample_system(control.ss(1 / (s * (T * s + 1))), Ts)
        return under_feedback(stage, 0.3 / T)
    if family == "slow integrator":
        integrator = control.ss(1, Ts, 1, 0, Ts)
        return under_feedback(integrator, 10 ** rng.uniform(-3, -0.5) / Ts)
    if family in ("short delay", "long delay"):
        short = family == "short delay"
        delay = (
            rng.integers(0, order + 1)
            if short
            else rng.integers(order + 1, 2 * order + 10)
        )
        chain = control.ss(np.eye(delay, k=-1), np.eye(delay, 1), np.eye(1, delay, k=delay - 1),
                           0, Ts) if delay else control.ss([], [], [], 1, Ts)  # fmt: skip
        return chain * lag(Ts * 10 ** rng.uniform(0, 2), Ts)
    if family == "resonance":
        w = 10 ** rng.uniform(-2, -0.3) / Ts
        return control.sample_system(
            control.ss(w**2 / (s**2 + 0.02 * w * s + w**2)), Ts
        )
    if family == "non-minimum phase":
        T, b = Ts * 10 ** rng.uniform(0.5, 2), rng.uniform(0.1, 2)
        return control.sample_system(control.ss((1 - b * T * s) / (T * s + 1) ** 2), Ts)
    if family == "tanks":
        m = int(rng.integers(2, 4))
        rates = 10 ** rng.uniform(-2.5, -1, m)
        A = -np.diag(rates) + np.diag(rates[:-1] * rng.uniform(0.1, 0.9, m - 1), -1)
        tanks = control.ss(A, np.diag(rates), np.eye(m), 0)
        return (
            control.sample_system(tanks, Ts)
            if Ts == 1
            else control.sample_system(tanks, 1.0)
        )
    m, states = int(rng.integers(1, 5)), int(rng.integers(1, 9))
    A = rng.standard_normal((states, states))
    A *= rng.uniform(0.5, 0.98) / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((states, m)), rng.standard_normal((m, states))
    D = rng.standard_normal((m, m)) * (
        states < m
    )  # or no output is independent of the others
    if family == "badly scaled":
        B = B * 10 ** rng.uniform(-4, 4, m)
        C = 10 ** rng.uniform(-4, 4) * C
        D = 0 * D if states >= m else D * np.abs(C).max() * np.abs(B).max(axis=0)
    return control.ss(A, B, C, D, Ts)


def problem(number):
    """Problem of that number, the same in every run."""
    rng = np.random.default_rng([0, number])
    family = FAMILIES[number % len(FAMILIES)]
    order = int(rng.choice([1, 2, 3, 5, 10, 15, 20, 30, 40]))
    plant = plant_of(family, rng, order)
    Ts = plant.dt
    n = int(rng.choice([100, 200, 400, 1000, 2000], p=[0.3, 0.3, 0.25, 0.1, 0.05]))
    low = 10 ** rng.uniform(-4, -2)
    omega = (
        np.geomspace(low, np.pi, n)
        if rng.random() < 0.7
        else np.linspace(low, np.pi, n)
    )
    cutoff = 10 ** rng.uniform(-1.5, -0.2)
    Q = zero_phase_butterworth(int(rng.integers(1, 4)), cutoff / Ts, Ts)
    P = frequency_response(plant, omega / Ts)
    band = (omega[0] / Ts, max(omega[3], cutoff * 10 ** rng.uniform(-1.5, 0)) / Ts)
    at_cutoff = np.abs(omega - cutoff).argmin()
    inverse = 1 / np.linalg.svd(P[at_cutoff], compute_uv=False)
    L_max = [None, 1e3 * inverse[-1], 10 * inverse[-1], 2.5 * inverse[-1], 2.5 * inverse[0],
             0.3 * inverse[0]][rng.integers(6)]  # fmt: skip
    options = {
        "order": min(order, n), "band": band, "L_max": None if L_max is None else float(L_max),
        "M_max": float(rng.choice([0.8, 0.9, 0.99])),
        "structure": str(rng.choice(["diagonal", "full"])),
        "objective": str(rng.choice(["sum", "peak"], p=[0.7, 0.3])),
    }  # fmt: skip
    plants, options["uncertainty"] = uncertain(
        P, np.random.default_rng([0, number, 1]), number
    )
    return Problem(
        number,
        family,
        plants,
        Q.frequency_response(omega / Ts),
        omega / Ts,
        Ts,
        options,
        plant,
        Q,
    )


def uncertain(P, rng, number):
    """Plants and radius: for every other number more than the nominal plant alone."""
    m = P.shape[1]
    kind = rng.choice(["plants", "norm", "plants and norm"]) if number % 2 else ""
    size, plants, radius = rng.choice([0.01, 0.05, 0.2]), [P], None
    if "plants" in kind:
        gains = 1 + size * rng.uniform(-1, 1, (rng.integers(1, 6), m, m))
        plants += [*(P * gain for gain in gains)]
    if "norm" in kind:
        radius = 0.5 * size * np.linalg.norm(P, 2, axis=(1, 2))
    return plants, radius


def outcome(number, confirm):
    """How the problem ends: a row of the survey."""
    p = problem(number)
    n, m, _ = p.P[0].shape
    row = {"number": number, "family": p.family, "m": m, "frequencies": n, **p.options}
    row |= {"plants": len(p.P), "uncertainty": np.ndim(p.options["uncertainty"])}
    start = time.perf_counter()
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always")
        try:
            design = synthesise(p.P, p.Q, p.omega, p.Ts, **p.options)
            row |= {
                "end": "certified",
                "value": design.value,
                "gap": design.certificate.gap,
            }
        except InfeasibleError as error:
            row |= {"end": "infeasible", "smallest": error.smallest_M_max}
        except Exception as error:
            row |= {"end": "failed", "message": f"{type(error).__name__}: {error}"}
    row["time"] = time.perf_counter() - start
    if row["end"] == "certified" and number % 2 == 0:
        row |= everywhere(p)
    row["warnings"] = sorted(
        {str(w.message) for w in raised if w.category is not UserWarning}
    )
    if confirm and row["end"] == "infeasible":
        row["confirmed"] = confirmed(p, row["smallest"])
    return row


def everywhere(p):
    """How the problem of one plant ends as that of a model, with bounds at every frequency."""
    times = []
    with warnings.catch_warnings(action="ignore"):
        for flag in (False, True):
            start = time.process_time()
            try:
                options = p.options | {"everywhere": flag}
                certified(pose(p.model, p.filter, p.omega, **options), check=flag)
                end = "certified"
            except InfeasibleError:
                end = "infeasible"
            except SolverError as error:
                end = str(error)
            times.append(time.process_time() - start)
    return {"everywhere": end, "ratio": times[1] / times[0]}


def confirmed(p, claimed):
    """Whether CVXPY finds the same smallest M_max, to 1e-4 of it."""
    options = p.options | {"objective": "peak", "M_max": 1 - 1e-9}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            problem = pose(p.P, p.Q, p.omega, p.Ts, **options)
            found = certified(problem, solver="cvxpy", check=False).value
        except InfeasibleError as error:
            found = error.smallest_M_max
        except SolverError as error:
            return f"CVXPY failed: {error}"
    return bool(abs(found - claimed) <= 1e-4 * claimed)


def surveyed(number):
    """The problem's outcome; every fifth goes to CVXPY, too, if it is infeasible."""
    return outcome(number, confirm=number % 5 == 0)


def main(chosen):
    """Print what goes wrong, and the counts; of all problems they go to figures/performance.md."""
    numbers, rows = chosen or range(PROBLEMS), []
    with ProcessPoolExecutor() as pool:
        for row in tqdm(pool.map(surveyed, numbers), total=len(numbers)):
            rows.append(row)
            if (
                chosen
                or row["end"] == "failed"
                or row.get("confirmed", True) is not True
            ):
                tqdm.write(str(row))
    ends = Counter(row["end"] for row in rows)
    given = [row["confirmed"] for row in rows if "confirmed" in row]
    seconds = np.array([row["time"] for row in rows])
    wide = Counter(row["everywhere"] for row in rows if "everywhere" in row)
    ratios = np.array([row["ratio"] for row in rows if "ratio" in row])
    text = (
        f"{len(rows)} problems: {ends['certified']} end with a certified filter, "
        f"{ends['infeasible']} are infeasible, {ends['failed']} fail. CVXPY confirms the smallest "
        f"M_max of {given.count(True)} of the {len(given)} infeasible ones that it was given. "
        f"Time on one core: median {np.median(seconds):.1f} s, longest {seconds.max():.0f} s.\n\n"
        f"With `everywhere=True`, of the {len(ratios)} that are certified and have one plant: "
        f"{wide['certified']} end with bounds at every frequency, {wide['infeasible']} are "
        f"infeasible then, {len(ratios) - wide['certified'] - wide['infeasible']} fail. It takes "
        f"{np.median(ratios):.1f} times as long (median), for {np.mean(ratios > 3):.0%} more than "
        f"three times, {ratios.max():.0f} times at most.\n"
    )
    print(text)
    if not chosen:
        page = ROOT / "figures" / "performance.md"
        write_whole(page, splice(page.read_text(encoding="utf-8"), "survey", text))
    return ends["failed"]


if __name__ == "__main__":
    sys.exit(1 if main([int(number) for number in sys.argv[1:]]) else 0)
