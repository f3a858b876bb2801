"""Excited rigs: P by its lines, by the regression, and by both, at the lines and between them."""

import sys
import warnings

import numpy as np
from scipy.signal import freqz, lfilter

from ilctools import ClosedLoop, measured_response, multisine
from ilctools.errors import LogError
from ilctools.measurement.estimation import estimated_response
from ilctools.measurement.excitation import with_excitation
from ilctools.signals import dataset

LOOP = ClosedLoop(Ts=1.0, outputs=["y"])
PLAN = {"lowest": 0.01, "highest": 2.5, "amplitude": 1.0, "hours": 1.2}
NOISE = 0.003
PHASES = 30  # realisations, over which the gain of the best linear approximation is a mean
POLE = np.exp(0.3 * (-0.005 + 1j * np.sqrt(1 - 0.005**2)))
RING = np.poly([POLE, POLE.conj()]).real
LAG, RESONANCE = ([0, 0.1], [1, -0.9]), ([0, RING.sum() / 2, RING.sum() / 2], RING)
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
    """A log, its plan, and the gain of what is before the plant."""
    (b, a), lines, bent = KINDS[kind]
    rng, plan = np.random.default_rng(seed), multisine(LOOP, **PLAN, lines=lines, seed=seed)
    w = plan.signals
    y = lfilter(b, a, bent(w), axis=1) + NOISE * rng.standard_normal(w.shape)
    if "outliers" in kind:
        y += (rng.random(w.shape) < 0.005) * rng.choice([-1.0, 1.0], w.shape)
    log = dataset(1.0, ["y"], [], [], {"y": ""}, y=y, reference=0 * w, v=w)
    return with_excitation(log, plan, LOOP, {}), plan


def gain(kind):
    """That of the best linear approximation of what is before the plant, over many phases."""
    _, lines, bent = KINDS[kind]
    plans = [multisine(LOOP, **PLAN, lines=lines, seed=1000 + k) for k in range(PHASES)]
    w = np.concatenate([plan.signals[:, : plan.period].ravel() for plan in plans])
    return np.sum(bent(w) * w) / np.sum(w * w)


def judged(kind, seed, factor):
    """Median radius, and whether the truth is outside at lines and between, by three methods."""
    (log, plan), (b, a) = record(kind, seed), KINDS[kind][0]
    both = measured_response(log)
    try:
        alone = estimated_response([log], "w")
    except LogError:
        alone = both
    lines, between = plan.omega, np.sqrt(plan.omega[1:] * plan.omega[:-1])
    row = []
    for P in (both.lines, alone, both):
        for omega in (lines, between):
            response, radius = P.on(omega, 0.99)
            truth = factor * freqz(b, a, omega)[1]
            off = np.abs(response[:, 0, 0] - truth)
            row += [np.median(radius / np.abs(truth)), np.any(off > radius)]
    return [row[k] for k in (0, 1, 3, 4, 5, 7, 8, 9, 11)]


def main(count: int = 20) -> None:
    """Print a row of the table for each kind."""
    for kind in KINDS:
        factor = gain(kind)
        rows = np.array([judged(kind, seed, factor) for seed in range(count)], float)
        cells = [
            f"{np.median(rows[:, k]):.4f}, {rows[:, k + 1].sum():.0f} / {rows[:, k + 2].sum():.0f}"
            for k in (0, 3, 6)
        ]
        print(f"| {kind} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main(*map(int, sys.argv[1:]))
