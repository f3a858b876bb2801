"""Is a filter from a plant's own trials worth it? 15 fresh rods a row, a draw of noise each.

`make measure WHAT=renewal` runs four trials with the filter of the nominal model on rods that are
off, estimates P from them, designs a filter of the same kind, with the same bounds, and goes on
from v for four trials; likewise with the nominal filter, with that of the estimate without its
radius, with that of the rod itself, and with norm-optimal learning on the nominal model. Where
there is no filter, the nominal one goes on. Trials and rates are of one plant. Both tables go to
figures/performance.md.
"""

import warnings
from functools import cache

import numpy as np
from runner import publish, run, table

from ilctools import (
    InfeasibleError,
    Law,
    NormOptimal,
    convergence,
    frequency_response,
    measured_response,
    rms,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.loop.notes import LogError
from rodlib import Spread, assumed_reference, draw, paper_loop

RODS, FEWER = 15, 6  # of each row, of either table
SAMPLES, LEARNED, GOES_ON, REST = 800, 4, 4, 50
OMEGA = np.geomspace(1e-4, np.pi, 150)
BOUNDS = {"M_max": 0.9, "L_max": 50.0, "band": (1e-4, 0.1)}
# what `synthesise(LOOP, Q)` chooses, cut off at so many samples for all; and the paper's kind
KINDS = {"L = B K": {"base": 0.03, "reach": 250}, "25 samples": {"order": 25}}
LOOP, Q, R = paper_loop(), zero_phase_butterworth(2, 0.1, 1.0), assumed_reference(SAMPLES)
OPTIMAL = Law(Q, NormOptimal(LOOP.P, KINDS["L = B K"]["base"] ** 2, SAMPLES), REST)
DESIGNS = ("nominal", "estimate", "without radius", "rod itself")
SPREADS = {
    "5 %": {"spread": 0.05},
    "10 %": {"spread": 0.1},
    "20 %": {"spread": 0.2},
    "30 %": {"spread": 0.3},
    "20 %, 25 samples": {"spread": 0.2, "kind": "25 samples"},
}
AMOUNTS = {
    "two first trials": {"learned": 2},
    "the first trial": {"learned": 1},
    "four first trials, noise 0.1 K": {"noise": 0.1},
    "trials 21 to 24": {"before": 20},
    "trial 24": {"before": 23, "learned": 1},
}


def around(plant):
    """P of the loop around the plant whose trials run."""
    return frequency_response(LOOP.around(plant)[:, : len(LOOP.outputs)], OMEGA)


def designed(P, kind="L = B K"):
    """A design of a kind, by the common bounds."""
    Ts = 1.0 if isinstance(P, np.ndarray) else None
    return synthesise(P, Q, OMEGA, Ts, **KINDS[kind], **BOUNDS)


@cache
def nominal(kind):
    """The design that knows no rod but the nominal one."""
    return designed(LOOP, kind)


def designs_of(log, P_true, kind):
    """Designs by what they know of P; in words why there is none."""
    designs = {"nominal": nominal(kind), "rod itself": designed(P_true, kind)}
    try:
        P = measured_response(log)
    except LogError:
        return designs | dict.fromkeys(("estimate", "without radius"), "refused")
    for name, known in {"estimate": P, "without radius": P.on(OMEGA, 0.99)[0]}.items():
        try:
            designs[name] = designed(known, kind)
        except InfeasibleError:
            designs[name] = "infeasible"
    return designs


def case(number, options):
    """The outcome for a rod of the table's rows."""
    return outcome(number, **options)


def outcome(number, spread=0.2, noise=0.02, before=0, learned=LEARNED, kind="L = B K"):
    """RMS of the second and the last further trial by each design; its promise and true rate."""
    plant, begun = draw(Spread.of_all(spread), number, root=34).model(1.0), before + learned
    P_true = around(plant)
    rng = np.random.default_rng([34, number])
    white = noise * rng.standard_normal((begun + GOES_ON, SAMPLES, 2))
    with warnings.catch_warnings(action="ignore"):
        law = nominal(kind).law(rest=REST)
        log = run_trials(LOOP, law, R, None, begun, plant=plant, noise=white[:begun])
        v = law.next(log.v[-1].values, log.e[-1].values)
        log = log.isel(trial=slice(before, None)).drop_vars("disturbance")
        designs, errors, rates = designs_of(log, P_true, kind), {}, {}
        for name in (*DESIGNS, "norm-optimal"):
            design = designs.get(name)
            if name == "norm-optimal":
                law = OPTIMAL
            elif isinstance(design, str):
                law, rates[name] = nominal(kind).law(rest=REST), design
            else:
                law = Law(Q, design.filter, REST)
                true = convergence(P_true, Q, design.filter, OMEGA).gamma
                rates[name] = design.certificate.grid_M, true
            setting = {"plant": plant, "noise": white[begun:], "v": v}
            errors[name] = rms(run_trials(LOOP, law, R, None, GOES_ON, **setting).e).values[[1, -1]]
    return errors, rates


def row(name, results):
    """A row of either table: medians of the RMS, and counts of rods."""
    errors, rates = zip(*results, strict=True)
    cells = [
        "{:.3f}, {:.3f}".format(*np.median([e[way] for e in errors], axis=0))
        for way in (*DESIGNS, "norm-optimal")
    ]
    renewed = [i for i, r in enumerate(rates) if not isinstance(r["estimate"], str)]
    better = sum(errors[i]["estimate"][0] < errors[i]["nominal"][0] for i in renewed)
    cells += [f"{better} of {len(renewed)}", str(len(rates) - len(renewed))]
    for way in DESIGNS[:3]:
        pairs = np.array([r[way] for r in rates if not isinstance(r[way], str)])
        if not len(pairs):
            cells.append("")
            continue
        promised, true = pairs.T
        counts = f"{np.sum(true > BOUNDS['M_max'])}, {np.sum(true > 1)} of {len(true)}"
        cells.append(f"{counts}; {max(0, np.max(true - promised)):.2f}")
    return [name, *cells]


TITLES = [
    *DESIGNS,
    "norm-optimal",
    "estimate better in trial 6",
    "no filter",
    *(f"above 0.90, above 1; excess: {way}" for way in DESIGNS[:3]),
]


def rows(settings, size, first=0):
    """Rows of a table; each has rods of its own, from number `first` on."""
    cases = [
        (first + size * i + number, options)
        for i, options in enumerate(settings.values())
        for number in range(size)
    ]
    results = list(run(case, cases))
    return [row(name, results[size * i : size * (i + 1)]) for i, name in enumerate(settings)]


def main():
    """Both tables go to figures/performance.md."""
    tables = [
        table(["off by up to", *TITLES], rows(SPREADS, RODS)),
        table(["20 %, from", *TITLES], rows(AMOUNTS, FEWER, first=1000)),
    ]
    publish("renewal", "\n\n".join(tables) + "\n")


if __name__ == "__main__":
    main()
