"""A rod that drifts for 200 trials, and loses half of an element: which law is best left alone?

`make measure WHAT=ageing` runs laws that stay as they are against laws that are renewed, by an
estimate of P from the last five trials, when the watch over them speaks or after every twenty; with
three draws of the noise. The table goes to figures/performance.md.
"""

import warnings
from functools import cache

import numpy as np
from renewal import LOOP, OMEGA, PAPER, REST, SAMPLES, SEEN, SETTINGS, Q, R, behind_a_hold
from runner import publish, run, table

from ilctools import (
    InfeasibleError,
    Law,
    NormOptimal,
    convergence,
    measured_response,
    rms,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)
from rodlib import Rod, Specimen, responses

DRAWS, TRIALS, BLOCK, NOISE, DRIFT = 3, 200, 5, 0.02, 0.2
WIDE = zero_phase_butterworth(1, 3.14, 1.0)  # near one, for norm-optimal learning
STAY = {
    "the paper's filter": lambda: PAPER,
    "nominal, 25 samples": lambda: designed(LOOP),
    "robust for all of it": lambda: designed([response(*state) for state in BECOMES]),
    "norm-optimal, weight 0.003": lambda: Law(WIDE, NormOptimal(LOOP.P, 0.003, SAMPLES), REST),
    "norm-optimal, weight 0.03": lambda: Law(WIDE, NormOptimal(LOOP.P, 0.03, SAMPLES), REST),
    "norm-optimal, weight 0.003, same Q": lambda: Law(Q, NormOptimal(LOOP.P, 0.003, SAMPLES), REST),
}
RENEWED = {  # whether after this block, by what was said of it; with the radius or without
    "renewed when the watch speaks": (lambda block, said: bool(said), True),
    "the same without the radius": (lambda block, said: bool(said), False),
    "renewed after every 20 trials": (lambda block, said: block % 4 == 3, True),
}
BECOMES = [(share, half) for half in (False, True) for share in (0.0, 0.5, 1.0)]


@cache
def specimen(share, half):
    """The rod after this share of the drift, with the element Q1 whole or half."""
    rod = Rod()
    changed = {
        "heat_transfer": rod.heat_transfer * (1 + DRIFT * share),
        "conductivity": rod.conductivity * (1 - DRIFT * share),
    }
    return Specimen(Rod(**changed), (0.5 if half else 1.0, 1.0, 1.0, 1.0))


@cache
def response(share, half):
    """P of the loop around it."""
    return responses(LOOP, [specimen(share, half)], OMEGA)[0]


def designed(P):
    """The law of a design by the common settings."""
    Ts = None if hasattr(P, "Ts") else 1.0
    return Law(Q, synthesise(P, Q, OMEGA, Ts, **SETTINGS).filter, REST)


def left_alone(way, seed, trials=TRIALS):
    """Errors of all trials, promises with what is true of them then, and the last law."""
    renews, with_radius = RENEWED.get(way, (lambda block, said: False, True))
    law = STAY[way]() if way in STAY else STAY["nominal, 25 samples"]()
    random, v, errors, promises = np.random.default_rng([34, seed]), None, [], []
    for block in range(trials // BLOCK):
        share = block * BLOCK / trials
        state = share, share >= 0.5
        white = NOISE * random.standard_normal((BLOCK, SAMPLES, 2))
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            log = run_trials(
                LOOP, law, R, None, BLOCK, plant=behind_a_hold(specimen(*state)), noise=white, v=v
            )
        errors.extend(rms(log.e).values)
        v = law.next(log.v[-1].values, log.e[-1].values)
        if not renews(block, said):
            continue
        with warnings.catch_warnings(action="ignore"):
            P = measured_response(log.drop_vars("disturbance"))
            given = {} if with_radius else {"P": P.on(OMEGA, 0.99)[0], "Ts": 1.0}
            try:
                design = synthesise(**{"P": P} | given, Q=Q, omega=OMEGA, **SETTINGS)
            except InfeasibleError:
                promises.append(None)
                continue
        law = design.law(rest=REST) if with_radius else Law(Q, design.filter, REST)
        promises.append((design.certificate.grid_M, *rates(law, state)))
    return np.array(errors), promises, rates(law, (1.0, True))


def rates(law, state):
    """Largest sigma_max(M): of all frequencies, of those that a trial has; spectral radius."""
    found = convergence(response(*state), law.Q, law.L, OMEGA)
    return found.gamma, found.sigma[OMEGA >= SEEN].max(), found.spectral_radius


def row(way):
    """A row of the table, medians over the draws."""
    errors, made, ends = zip(*(left_alone(way, seed) for seed in range(DRAWS)), strict=True)
    last = np.array(errors)[:, -TRIALS // 4 :]
    size = np.sqrt(np.median(np.mean(last**2, axis=1)))
    promises = [promise for each in made for promise in each]
    kept = [promise for promise in promises if promise is not None]
    broken, seen = (sum(promise[k] > promise[0] for promise in kept) for k in (1, 2))
    counts = f"{len(promises)}, {len(promises) - len(kept)}, {broken}, {seen}" if promises else ""
    return [way, counts, f"{size:.3f}", *(f"{end:.4f}" for end in np.median(ends, axis=0))]


TITLES = ["law", "renewals, infeasible, broken, broken as seen", "RMS of the last quarter (K)"]
TITLES += ["rate at the end", "as seen", "spectral radius"]


if __name__ == "__main__":
    publish("ageing", table(TITLES, list(run(row, [*STAY, *RENEWED]))) + "\n")
