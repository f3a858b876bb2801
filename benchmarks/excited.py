"""Excited rigs: P by its lines, by the regression, and by both, at the lines and between them."""

import sys
import warnings

import numpy as np
from records import SHAKEN, gain_of, resonant, shaken
from scipy.signal import freqz

from ilctools import measured_response, multisine
from ilctools.errors import LogError
from ilctools.measurement.estimation import estimated_response

PLAN = {"lowest": 0.01, "highest": 2.5, "amplitude": 1.0, "hours": 1.2}
PHASES = 30  # realisations, over which the gain of the best linear approximation is a mean
LAG, RESONANCE = ([0, 0.1], [1, -0.9]), resonant(0.3, 0.005)
DELAY = [0] * 60 + [0, 0.1], [1, -0.9]


def cubic(share):
    return lambda w: w + share * w**3


KINDS = {  # plant, lines, what is before it
    "lag": (LAG, 80, np.array),
    "delay of 60 samples": (DELAY, 80, np.array),
    "resonance 0.005, 300 lines": (RESONANCE, 300, np.array),
    "resonance 0.005, 40 lines": (RESONANCE, 40, np.array),
    "lag, outliers": (LAG, 80, np.array),
    "cubic 1 %": (LAG, 80, cubic(0.01)),
    "cubic 5 %": (LAG, 80, cubic(0.05)),
    "cubic 20 %": (LAG, 80, cubic(0.2)),
    "saturation at half the amplitude": (LAG, 80, lambda w: np.clip(w, -0.5, 0.5)),
}


def record(kind, seed):
    """A log of an excited rig."""
    plant, lines, bent = KINDS[kind]
    rng, plan = np.random.default_rng(seed), multisine(SHAKEN, **PLAN, lines=lines, seed=seed)
    log = shaken(plant, plan, rng, bent)
    if "outliers" in kind:
        log.y.values += (rng.random(log.y.shape) < 0.005) * rng.choice([-1.0, 1.0], log.y.shape)
    return log


def gain(kind):
    """That of the best linear approximation of what is before the plant, over many phases."""
    _, lines, bent = KINDS[kind]
    plans = [multisine(SHAKEN, **PLAN, lines=lines, seed=1000 + k) for k in range(PHASES)]
    return gain_of(bent, plans)


def compared(P, omega, truth):
    """The median radius, relative to the truth, and whether the truth is outside."""
    response, radius = P.on(omega, 0.99)
    outside = np.any(np.abs(response[:, 0, 0] - truth) > radius)
    return np.median(radius / np.abs(truth)), outside


def judged(kind, seed, factor):
    """What `compared` finds at lines and between them, by three methods, (method, grid, 2)."""
    log, plant = record(kind, seed), KINDS[kind][0]
    both = measured_response(log)
    try:
        alone = estimated_response([log], "w")
    except LogError:
        alone = both
    lines = both.lines.omega
    grids = lines, np.sqrt(lines[1:] * lines[:-1])
    truths = [factor * freqz(*plant, omega)[1] for omega in grids]
    methods = both.lines, alone, both
    return [[compared(P, *each) for each in zip(grids, truths, strict=True)] for P in methods]


def main(count: int = 20) -> None:
    """Print a row of the table for each kind."""
    for kind in KINDS:
        factor = gain(kind)
        rows = np.array([judged(kind, seed, factor) for seed in range(count)], float)
        radii = np.median(rows[:, :, 0, 0], axis=0)  # at the lines
        outside = rows[..., 1].sum(axis=0)
        cells = [
            f"{radius:.4f}, {at_lines:.0f} / {between:.0f}"
            for radius, (at_lines, between) in zip(radii, outside, strict=True)
        ]
        print(f"| {kind} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main(*map(int, sys.argv[1:]))
