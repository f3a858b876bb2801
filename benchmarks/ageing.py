"""A rod that drifts for 200 trials, and loses half of an element: which law is best left alone?

`make measure WHAT=ageing` runs laws that stay as they are against laws that are renewed, by an
estimate of P from the last five trials, when the watch over them speaks or after every twenty; with
three draws of the noise. In the first, laws that stay go on for 1,300 trials on the rod as it is
then. Trials, rates and spectral radii are of one plant. The table goes to figures/performance.md.
"""

import warnings
from functools import cache

import numpy as np
from renewal import LOOP, OMEGA, OPTIMAL, REST, SAMPLES, Q, R, around, designed, nominal
from runner import publish, run, table

from ilctools import (
    InfeasibleError,
    Law,
    LearningFilter,
    NormOptimal,
    convergence,
    measured_response,
    rms,
    run_trials,
    zero_phase_butterworth,
)
from rodlib import Rod, Specimen
from rodlib.paper import published

DRAWS, TRIALS, FURTHER, BLOCK, NOISE, DRIFT = 3, 200, 1300, 5, 0.02, 0.2
WIDE = zero_phase_butterworth(1, 3.14, 1.0)  # near one, for norm-optimal learning
BECOMES = [(share, half) for half in (False, True) for share in (0.0, 0.5, 1.0)]
STAY = {
    "the paper's filter": lambda: Law(Q, LearningFilter(published.matrix("L_diagonal"), 1.0), REST),
    "nominal, 25 samples": lambda: nominal("25 samples").law(rest=REST),
    "nominal, L = B K": lambda: nominal("L = B K").law(rest=REST),
    "robust for all of it": lambda: law_of(designed([response(*state) for state in BECOMES])),
    "norm-optimal, same Q and b": lambda: OPTIMAL,
    "norm-optimal, Q near one": lambda: Law(WIDE, NormOptimal(LOOP.P, 0.003, SAMPLES), REST),
}
RENEWED = {  # whether after this block, by what was said of it; with the radius or without
    "renewed when the watch speaks": (lambda block, said: bool(said), True),
    "the same without the radius": (lambda block, said: bool(said), False),
    "renewed after every 20 trials": (lambda block, said: block % 4 == 3, True),
}


@cache
def plant(share, half):
    """The rod after this share of the drift, with the element Q1 whole or half."""
    rod = Rod()
    changed = {
        "heat_transfer": rod.heat_transfer * (1 + DRIFT * share),
        "conductivity": rod.conductivity * (1 - DRIFT * share),
    }
    return Specimen(Rod(**changed), (0.5 if half else 1.0, 1.0, 1.0, 1.0)).model(1.0)


@cache
def response(share, half):
    """P of the loop around it."""
    return around(plant(share, half))


def law_of(design):
    """The law of a design; Q stays what it is."""
    return Law(Q, design.filter, REST)


def left_alone(way, seed, trials=TRIALS, further=FURTHER):
    """Errors of all trials, promises with what is true of them then, and the last law."""
    renews, with_radius = RENEWED.get(way, (None, True))
    law = STAY[way]() if way in STAY else nominal("L = B K").law(rest=REST)
    random, v, errors, promises = np.random.default_rng([34, seed]), None, [], []
    for block in range((trials + (0 if renews else further)) // BLOCK):
        share = min(1.0, block * BLOCK / trials)
        state = share, share >= 0.5
        white = NOISE * random.standard_normal((BLOCK, SAMPLES, 2))
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            log = run_trials(LOOP, law, R, None, BLOCK, plant=plant(*state), noise=white, v=v)
        errors.extend(rms(log.e).values)
        v = law.next(log.v[-1].values, log.e[-1].values)
        if renews is None or not renews(block, said):
            continue
        with warnings.catch_warnings(action="ignore"):
            P = measured_response(log.drop_vars("disturbance"))
            try:
                design = designed(P if with_radius else P.on(OMEGA, 0.99)[0])
            except InfeasibleError:
                promises.append(None)
                continue
        law = design.law(rest=REST) if with_radius else law_of(design)
        promises.append((design.certificate.grid_M, rates(law, state)[0]))
    return np.array(errors), promises, rates(law, (1.0, True))


def rates(law, state):
    """Largest sigma_max(M) and spectral radius around the rod in this state."""
    result = convergence(response(*state), law.Q, law.L, OMEGA)
    return result.gamma, result.spectral_radius


def row(way):
    """A row of the table, medians over the draws."""
    draws = (left_alone(way, seed, further=0 if seed else FURTHER) for seed in range(DRAWS))
    errors, made, ends = zip(*draws, strict=True)
    powers = [np.mean(e[TRIALS - 50 : TRIALS] ** 2) for e in errors]
    late = f"{np.sqrt(np.mean(errors[0][-50:] ** 2)):.3f}" if way in STAY else ""
    promises = [promise for each in made for promise in each]
    kept = np.array([promise for promise in promises if promise is not None])
    counts = ""
    if len(kept):
        promised, true = kept.T
        counts = f"{len(promises)}, {len(promises) - len(kept)}, {np.sum(true > 0.9)}, "
        counts += f"{np.sum(true > promised)}; {max(0, np.max(true - promised)):.2f}"
    size = f"{np.sqrt(np.median(powers)):.3f}"
    return [way, counts, size, late, *(f"{end:.4f}" for end in np.median(ends, axis=0))]


TITLES = [
    "law",
    "renewals, infeasible, rate above 0.90, above its own promise; by at most",
    "RMS of trials 151 to 200 (K)",
    "of trials 1451 to 1500",
    "rate at the end",
    "spectral radius",
]


if __name__ == "__main__":
    publish("ageing", table(TITLES, list(run(row, [*STAY, *RENEWED]))) + "\n")
