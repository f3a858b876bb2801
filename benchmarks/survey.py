"""Does the synthesis end well for ordinary plants? A survey of many problems, drawn by seed.

`make measure WHAT=survey` runs it and writes the counts to figures/performance.md. Drawn are lags,
integrators under feedback, delays, resonances, non-minimum-phase plants, tanks and random plants of
size 1 to 4, also badly scaled, with orders from 1 to 40 and 100 to 2000 frequencies. The bounds of
every other problem hold for more plants than one: further ones, all within a radius, or both. Each
must end with a certified filter, or with an InfeasibleError whose smallest M_max CVXPY confirms on
a sample.
"""

import time
import warnings

import control
import numpy as np
import pandas as pd
from kinds import S, delay, resonance, sampled
from problems import statement
from runner import publish, run

from ilctools import InfeasibleError, synthesise, zero_phase_butterworth
from ilctools.models import frequency_response

PROBLEMS = 550
FAMILIES = (
    "lag", "two lags", "motion stage", "tanks", "slow integrator", "short delay", "long delay",
    "resonance", "non-minimum phase", "random", "badly scaled",
)  # fmt: skip


def lag(T, Ts):
    """1 / (T s + 1) behind a zero-order hold."""
    a = np.exp(-Ts / T)
    return control.ss(a, 1 - a, 1, 0, Ts)


def under_feedback(plant, crossover):
    """The unit feedback loop of a plant with a proportional gain for a given crossover."""
    gain = 1 / np.abs(plant(np.exp(1j * crossover * plant.dt)))
    while np.abs((loop := control.feedback(gain * plant, 1)).poles()).max() >= 0.9999:
        gain /= 1.5
    return loop


def plant_of(family, rng, order):
    """A stable loop of the family, with unit gain at frequency zero unless it is random."""
    Ts = rng.choice([0.001, 0.1, 1.0, 60.0])

    def power(low, high, size=None):
        return 10 ** rng.uniform(low, high, size)

    match family:
        case "lag":
            return lag(Ts * power(0, 2.5), Ts)
        case "two lags":
            return lag(Ts * power(0, 2), Ts) * lag(Ts * power(0, 2), Ts)
        case "motion stage":
            T = Ts * power(1, 2)
            return under_feedback(sampled(1 / (S * (T * S + 1)), Ts), 0.3 / T)
        case "slow integrator":
            return under_feedback(control.ss(1, Ts, 1, 0, Ts), power(-3, -0.5) / Ts)
        case "short delay" | "long delay":
            ends = [0, order + 1] if family == "short delay" else [order + 1, 2 * order + 10]
            return delay(rng.integers(*ends), Ts) * lag(Ts * power(0, 2), Ts)
        case "resonance":
            return sampled(resonance(power(-2, -0.3) / Ts, 0.01), Ts)
        case "non-minimum phase":
            T, b = Ts * power(0.5, 2), rng.uniform(0.1, 2)
            return sampled((1 - b * T * S) / (T * S + 1) ** 2, Ts)
        case "tanks":
            m = rng.integers(2, 4)
            rates = power(-2.5, -1, m)
            A = np.diag(rates[:-1] * rng.uniform(0.1, 0.9, m - 1), -1) - np.diag(rates)
            return sampled(control.ss(A, np.diag(rates), np.eye(m), 0), 1.0)
    m, states = rng.integers(1, 5), rng.integers(1, 9)
    A = rng.standard_normal((states, states))
    A *= rng.uniform(0.5, 0.98) / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((states, m)), rng.standard_normal((m, states))
    # or no output is independent of the others
    D = rng.standard_normal((m, m)) * (states < m)
    if family == "badly scaled":
        B = B * power(-4, 4, m)
        C = power(-4, 4) * C
        D = D * np.abs(C).max() * np.abs(B).max(axis=0)
    return control.ss(A, B, C, D, Ts)


def problem(number):
    """Problem of that number, the same in every run: its model, and the arguments of synthesise."""
    rng = np.random.default_rng([0, number])
    order = rng.choice([1, 2, 3, 5, 10, 15, 20, 30, 40])
    model = plant_of(FAMILIES[number % len(FAMILIES)], rng, order)
    Ts = model.dt
    n = rng.choice([100, 200, 400, 1000, 2000], p=[0.3, 0.3, 0.25, 0.1, 0.05])
    low = 10 ** rng.uniform(-4, -2)
    spacing = np.geomspace if rng.random() < 0.7 else np.linspace
    omega = spacing(low, np.pi, n) / Ts
    cutoff = 10 ** rng.uniform(-1.5, -0.2) / Ts
    Q = zero_phase_butterworth(rng.integers(1, 4), cutoff, Ts)
    P = frequency_response(model, omega)
    band = (omega[0], max(omega[3], cutoff * 10 ** rng.uniform(-1.5, 0)))
    at_cutoff = np.abs(omega - cutoff).argmin()
    inverse = 1 / np.linalg.svd(P[at_cutoff], compute_uv=False)[[-1, -1, -1, 0, 0]]
    bounds = [None, *(np.array([1e3, 10, 2.5, 2.5, 0.3]) * inverse)]
    options = {
        "order": min(order, n),
        "band": band,
        "L_max": bounds[rng.integers(6)],
        "M_max": rng.choice([0.8, 0.9, 0.99]),
        "structure": rng.choice(["diagonal", "full"]),
        "objective": rng.choice(["sum", "peak"], p=[0.7, 0.3]),
    }
    plants = [P]
    if number % 2:  # more than the nominal plant
        rng = np.random.default_rng([0, number, 1])
        kind = rng.choice(["plants", "norm", "plants and norm"])
        size = rng.choice([0.01, 0.05, 0.2])
        if "plants" in kind:
            gains = rng.uniform(-1, 1, (rng.integers(1, 6), *P.shape[1:]))
            plants += [P * (1 + size * gain) for gain in gains]
        if "norm" in kind:
            options["uncertainty"] = 0.5 * size * np.linalg.norm(P, 2, axis=(1, 2))
    return model, (plants, Q, omega, Ts), options


def ending(solve, *arguments, **options):
    """How a synthesis ends, its value or smallest M_max, and the seconds of the processor."""
    start, value = time.process_time(), np.nan
    try:
        end, value = "certified", solve(*arguments, **options).value
    except InfeasibleError as error:
        end, value = "infeasible", error.smallest_M_max
    except Exception as error:
        end = f"{type(error).__name__}: {error}"
    return end, value, time.process_time() - start


def peak(plants, Q, omega, Ts, order, structure, **_):
    """The least possible peak of sigma_max(M) without a bound on L, by CVXPY."""
    kind = {"order": order, "structure": structure, "objective": "peak"}
    return statement(plants[0], Q.frequency_response(omega), omega, Ts, M_max=1 - 1e-9, **kind)[1]


def outcome(number):
    """How the problem ends; of one plant without a bound on L it goes to CVXPY if infeasible."""
    model, arguments, options = problem(number)
    with warnings.catch_warnings(action="ignore"):
        end, value, seconds = ending(synthesise, *arguments, **options)
        row = {"number": number, "end": end, "seconds": seconds}
        if end == "certified" and number % 2 == 0:
            _, Q, omega, _ = arguments
            nominal, wide = (
                ending(synthesise, model, Q, omega, **options, everywhere=flag)
                for flag in (False, True)
            )
            row |= {"everywhere": wide[0], "ratio": wide[2] / nominal[2]}
        if end == "infeasible" and number % 2 == 0 and options["L_max"] is None:
            row["confirmed"] = abs(peak(*arguments, **options) / value - 1) <= 1e-4
    return row


def counted(ends):
    """How many end well, are infeasible, and fail."""
    known = ["certified", "infeasible"]
    counts = ends.dropna().where(ends.isin(known), "failed").value_counts()
    return counts.reindex([*known, "failed"], fill_value=0)


def main(numbers=range(PROBLEMS)):
    """Print one problem of each end; the counts go to figures/performance.md."""
    rows = pd.DataFrame(run(outcome, numbers))
    print(rows.drop_duplicates(["end", "everywhere", "confirmed"]).to_string())
    confirmed, ratio = rows.confirmed.dropna().astype(bool), rows.ratio.dropna()
    ends, wide = counted(rows.end), counted(rows.everywhere)
    text = f"""{len(rows)} problems: {ends.certified} end with a certified filter, \
{ends.infeasible} are infeasible, {ends.failed} fail. CVXPY confirms the smallest \
M_max of {confirmed.sum()} of the {len(confirmed)} infeasible ones that it was given. Time on one \
core: median {rows.seconds.median():.1f} s, longest {rows.seconds.max():.0f} s.

With `everywhere=True`, of the {wide.sum()} that are certified and have one plant: \
{wide.certified} end with bounds at every frequency, {wide.infeasible} are infeasible then, \
{wide.failed} fail. It takes {ratio.median():.1f} times as long (median), for \
{(ratio > 3).mean():.0%} more than three times, {ratio.max():.0f} times at most.
"""
    publish("survey", text)


if __name__ == "__main__":
    main()
