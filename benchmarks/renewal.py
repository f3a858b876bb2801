"""Is a filter from a plant's own trials worth it? 20 rods that are off, ten draws of noise each.

`make measure WHAT=renewal` runs four trials with the paper's printed filter on each rod, estimates
P from them, designs a filter and goes on from v for four trials; likewise with filters of the same
order, cut-off and bounds from the nominal model, from the estimate without its radius, and from the
rod itself. It then varies how much there is to learn from. Both tables go to
figures/performance.md.
"""

import warnings
from functools import cache

import control
import numpy as np
from runner import publish, run, table

from ilctools import (
    InfeasibleError,
    Law,
    LearningFilter,
    measured_response,
    rate,
    rms,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.measurement.measurement import LogError
from rodlib import Spread, assumed_reference, draw, midr, paper_loop, responses
from rodlib.paper import published

DRAWS, RODS = 10, 5  # of the noise, for each rod; for each spread
SPREADS = (0.05, 0.1, 0.2, 0.3)
SAMPLES, LEARNED, GOES_ON, REST = 800, 4, 4, 50
OMEGA = np.geomspace(1e-4, np.pi, 150)
SEEN = 2 * np.pi / SAMPLES  # rad/s, the lowest frequency of a trial
SETTINGS = {"order": 25, "M_max": 0.9, "L_max": 50.0, "band": (1e-4, 0.1)}
WAYS = ("paper's filter", "nominal model", "estimate", "without radius", "rod itself")
LOOP, Q, R = paper_loop(), zero_phase_butterworth(2, 0.1, 1.0), assumed_reference(SAMPLES)
PAPER = Law(Q, LearningFilter(published.matrix("L_diagonal"), 1.0), REST)
AMOUNTS = {  # noise (K), trials before, trials that are learned from
    "four first trials": (0.02, 0, 4),
    "two first trials": (0.02, 0, 2),
    "the first trial": (0.02, 0, 1),
    "four first trials, noise 0.1 K": (0.1, 0, 4),
    "four first trials, noise 0.5 K": (0.5, 0, 4),
    "trials 21 to 24": (0.02, 20, 4),
    "trial 24": (0.02, 23, 1),
}


@cache
def rod(spread, number):
    """A rod as drawn, its plant behind a hold, and the loop's response around it."""
    specimen = draw(Spread.of_all(spread), number, root=34)
    return behind_a_hold(specimen), responses(LOOP, [specimen], OMEGA)[0]


@cache
def behind_a_hold(specimen):
    """A model of a rod behind a hold."""
    model = midr(specimen.rod, 5)
    gains = np.append(specimen.gains, 1.0)  # and of the ambient temperature
    names = {"inputs": model.input_labels, "outputs": model.output_labels}
    model = control.ss(model.A, model.B * gains, model.C, model.D, **names)
    return control.sample_system(model, 1.0, "zoh")


@cache
def design_of(spread, number):
    """The design for the rod itself; for the nominal model where number is None."""
    P = LOOP if number is None else rod(spread, number)[1]
    return designed(P)


def designed(P):
    """A design by the common settings, or in words why there is none."""
    try:
        Ts = 1.0 if isinstance(P, np.ndarray) else None
        return synthesise(P, Q, OMEGA, Ts, **SETTINGS)
    except InfeasibleError:
        return "infeasible"


def case(spread, number, seed, noise=0.02, before=0, learned=LEARNED):
    """RMS of the last trial by each way; what is promised, true and true of what a trial sees."""
    plant, P_true = rod(spread, number)
    rng = np.random.default_rng([34, number, seed])
    white = noise * rng.standard_normal((before + learned + GOES_ON, SAMPLES, 2))
    with warnings.catch_warnings(action="ignore"):
        begun = before + learned
        log = run_trials(LOOP, PAPER, R, None, begun, plant=plant, noise=white[:begun])
        try:
            P = measured_response(log.isel(trial=slice(before, None)).drop_vars("disturbance"))
            ways = {"estimate": designed(P), "without radius": designed(P.on(OMEGA, 0.99)[0])}
        except LogError:
            ways = dict.fromkeys(("estimate", "without radius"), "refused")
        ways["nominal model"] = design_of(spread, None)
        ways["rod itself"] = design_of(spread, number)
        v = PAPER.next(log.v[-1].values, log.e[-1].values)
        errors, promises = {}, {}
        for way in WAYS:
            design = ways.get(way)
            law = PAPER  # which goes on where there is no design
            if hasattr(design, "filter"):
                law = Law(Q, design.filter, REST)
                sigma = rate(P_true, Q, design.filter, OMEGA).gamma
                seen = rate(P_true[OMEGA >= SEEN], Q, design.filter, OMEGA[OMEGA >= SEEN]).gamma
                promises[way] = design.certificate.grid_M, sigma, seen
            elif design is not None:
                promises[way] = design
            given = {"plant": plant, "noise": white[begun:], "v": v}
            errors[way] = rms(run_trials(LOOP, law, R, None, GOES_ON, **given).e).values[[1, -1]]
    return errors, promises


def broken(promises, way, column):
    """How many designs do not keep what they promise, of how many."""
    made = [p[way] for p in promises if not isinstance(p[way], str)]
    return f"{sum(p[column] > p[0] for p in made)} of {len(made)}"


def row(name, results):
    """A row of either table: medians of the RMS in the second and the last trial that goes on."""
    errors, promises = zip(*results, strict=True)
    cells = ["{:.3f}, {:.3f}".format(*np.median([e[way] for e in errors], axis=0)) for way in WAYS]
    without = sum(isinstance(p["estimate"], str) for p in promises)
    better = sum(e["estimate"][1] < e["nominal model"][1] for e in errors)
    counts = [f"{better} of {len(errors)}", str(without)]
    counts += [broken(promises, "estimate", column) for column in (1, 2)]
    counts += [broken(promises, "without radius", 2), broken(promises, "nominal model", 2)]
    return [name, *cells, *counts]


TITLES = [
    *WAYS,
    "estimate better than nominal",
    "no filter",
    "broken at any frequency",
    "broken as seen",
    "without radius, as seen",
    "nominal, as seen",
]


def main():
    """Both tables go to figures/performance.md."""
    cases = [(s, n, seed) for s in SPREADS for n in range(RODS) for seed in range(DRAWS)]
    results = list(run(case, cases))
    size = RODS * DRAWS
    rows = [row(f"{s:.0%}", results[i * size : (i + 1) * size]) for i, s in enumerate(SPREADS)]
    amounts = [(0.1, n, 100 + n, *settings) for settings in AMOUNTS.values() for n in range(DRAWS)]
    more = list(run(case, amounts))
    others = [row(name, more[i * DRAWS : (i + 1) * DRAWS]) for i, name in enumerate(AMOUNTS)]
    tables = table(["off by up to", *TITLES], rows), table(["from", *TITLES], others)
    promises = [p for _, p in results]
    without = sum(isinstance(p["estimate"], str) for p in promises)
    said = (
        f"Of {len(results)} estimates {without} have no filter; of the others "
        f"{broken(promises, 'estimate', 2)} break their promise as seen, without the radius "
        f"{broken(promises, 'without radius', 2)}."
    )
    publish("renewal", "\n\n".join([tables[0], said, tables[1]]) + "\n")


if __name__ == "__main__":
    main()
