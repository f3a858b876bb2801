"""For how many rods does learning converge? 1000 rods, ten draws, laws of notebook 9 and one more.

`make measure WHAT=study` judges them on rods whose parameters are off by up to 20 %, with their
sensors in place, or off as well by up to 2 or 8 mm. The table, shares from the least to the most of
the draws, goes to figures/performance.md.
"""

from dataclasses import replace
from functools import cache

import numpy as np
from runner import publish, run, table

from ilctools import NormOptimal, convergence, synthesise
from ilctools.filters import LearningFilter, zero_phase_butterworth
from rodlib import Spread, assumed_reference, draw, paper_choices, paper_loop, responses
from rodlib.paper import published

RODS, DRAWS, SAMPLED = 1000, 10, 200  # the last: others, for which the robust filter is designed
PLACES = {"in place": 0.0, "2 mm": 0.25, "8 mm": 1.0}  # as a share of what all else is off by
LOOP = paper_loop()
Q, LOWER = zero_phase_butterworth(2, 0.1, 1.0), zero_phase_butterworth(2, 0.025, 1.0)
OMEGA = np.union1d(np.geomspace(1e-4, 0.3, 100), np.linspace(0.3, np.pi, 100))
CRITICAL = np.geomspace(5e-3, 0.5, 50)  # where rods are judged: below, and above, M is small


def rods(place, root, number):
    """So many rods of a draw."""
    spread = Spread.of_all(0.2)
    spread = replace(spread, sensors=PLACES[place] * spread.sensors)
    return [draw(spread, k, root=root) for k in range(number)]


@cache
def laws():
    """Q and L of each law."""
    bounds = paper_choices(L_max=50.0, band=(1e-4, 0.02))
    P = LOOP.frequency_response(OMEGA)
    drawn = responses(LOOP, rods("8 mm", 1, SAMPLED), OMEGA)
    printed = {
        f"printed, {name}": (Q, LearningFilter(published.matrix(f"L_{kind}"), 1.0))
        for name, kind in {"diagonal": "diagonal", "non-diagonal": "full"}.items()
    }
    peak = synthesise(P, Q, OMEGA, 1.0, **paper_choices(objective="peak"))
    lower = synthesise(P, LOWER, OMEGA, 1.0, **bounds)
    far = synthesise(P, Q, OMEGA, 1.0, **bounds | {"order": 60, "L_max": 5.0})
    robust = synthesise([P, *drawn], LOWER, OMEGA, 1.0, **bounds | {"M_max": 0.95})
    return printed | {
        "(45) with (46)": (Q, peak.filter),
        "(39), lower cut-off": (LOWER, lower.filter),
        "for the drawn rods": (LOWER, robust.filter),
        "norm-optimal": (Q, NormOptimal(LOOP.P, 0.1, len(assumed_reference()))),
        "(39), 60 ahead, L_max = 5": (Q, far.filter),
    }


def shares(place, root):
    """Of a draw, by law: how many rods converge, and how many monotonically."""
    P = responses(LOOP, rods(place, root, RODS), CRITICAL)
    results = [convergence(P, *law, CRITICAL) for law in laws().values()]
    return [[np.mean(r.spectral_radius < 1), np.mean(r.gamma < 1)] for r in results]


def main():
    """The table goes to figures/performance.md."""
    cases = [(place, 2 + root) for place in PLACES for root in range(DRAWS)]
    found = np.reshape([*run(shares, cases)], (len(PLACES), DRAWS, len(laws()), 2))
    ends = np.stack([found.min(axis=1), found.max(axis=1)], axis=-1)  # by place, law, kind
    rows = [
        [law, *(f"{low:.1%} to {high:.1%}" for low, high in ends[:, i].reshape(-1, 2))]
        for i, law in enumerate(laws())
    ]
    titles = [f"{kind}, {place}" for place in PLACES for kind in ("converge", "monotonically")]
    publish("study", table(["law", *titles], rows))


if __name__ == "__main__":
    main()
