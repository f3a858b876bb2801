"""Does the watch over trials keep quiet, and does it speak? False alarms and detections, counted.

`make measure WHAT=watch` runs 1,000 experiments that converge as promised, on three plants, and the
kinds that do not, and writes both tables to figures/performance.md. Seeds are fixed.
"""

import sys
import warnings
from collections import Counter
from functools import cache, partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "toolbox" / "tests"))

import numpy as np
from plants import PUMPS, altered, bump, furnace, stage, tanks
from runner import publish, run, table
from scipy.signal import lfilter

from ilctools import (
    ClosedLoop,
    Law,
    current_trial_loop,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.trials.diagnosis import diagnose

COUNT, REPEATS = 1000, 20  # experiments that converge, and of each kind that does not
SAMPLES = 400  # of a trial
SHORT = {"growth": "it grows", "model": "not the model"}
LOOPS = {  # a plant, the outputs' amplitudes, the cut-off of Q, and the order of L
    "stage": (lambda: stage(), ["F"], {"x": 1.0, "F": 3.0}, [10.0], 60.0, 20),
    "tanks": (lambda: tanks(), PUMPS, None, [10.0, 5.0, 8.0], 0.05, 20),
    "furnace": (lambda: furnace(30), None, {"valve": 0.1}, [10.0], 0.05, 40),
}


@cache
def case(name):
    """Law and reference of one of the three plants."""
    plant, controls, sizes, amplitudes, cutoff, order = LOOPS[name]
    loop = current_trial_loop(plant(), controls, sizes=sizes)
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    design = synthesise(loop, Q, order=order, band=(cutoff / 1e3, cutoff / 3))
    return Law(Q, design.filter, loop=loop), bump(SAMPLES, amplitudes)


def noise_of(rng, shape, size):
    """Independent from trial to trial; white or coloured in time."""
    pole = rng.choice([0.0, 0.5, 0.9, 0.98])
    noise = rng.standard_normal((shape[0], shape[1] + 200, shape[2]))
    noise = lfilter([np.sqrt(1 - pole**2)], [1, -pole], noise, axis=1)[:, 200:]
    return size * noise


def converging(seed):
    """Trials, and those of which something is said, of an experiment that converges as promised."""
    rng = np.random.default_rng(seed)
    law, reference = case([*LOOPS][seed % len(LOOPS)])
    loop, trials = law.loop, int(rng.integers(4, 16))
    law = Law(law.Q, law.L, gain=rng.choice([1.0, 0.5, 0.2]), loop=loop)
    size = 10 ** rng.uniform(-4, -0.5) * np.abs(reference).max()
    noise = noise_of(rng, (trials, *reference.shape), size)
    d = rng.normal(0, 1, len(loop.disturbances))
    repeating = bump(SAMPLES, d * np.abs(reference).max() / 10)
    with warnings.catch_warnings(action="ignore"):
        log = run_trials(loop, law, reference, repeating, trials, plant=loop.plant, noise=noise)
    return trials, alarms(log, law)


def alarms(log, law):
    """The trial after which each kind of warning comes first."""
    first = {}
    for k in range(2, log.sizes["trial"] + 1):
        for kind in diagnose(log.isel(trial=slice(k)), law, first=k):
            first.setdefault(kind, k)
    return first


def of_another_controller(seed):
    """A law for a loop whose controller is not ours, its reference, and random numbers."""
    law, reference = case([*LOOPS][seed % len(LOOPS)])
    law = Law(law.Q, law.L, loop=ClosedLoop(law.loop.P))
    return law, reference, np.random.default_rng(seed)


def another_gain(gain, seed, trials=20):
    """P of a ClosedLoop has another gain."""
    law, reference, rng = of_another_controller(seed)
    noise = noise_of(rng, (trials, *reference.shape), 1e-3 * np.abs(reference).max())
    plant = altered(law.loop.P, B=gain)
    return run_trials(law.loop, law, reference, None, trials, plant=plant, noise=noise), law


def another_phase(seed, trials=30):
    """A disturbance of the outputs comes in another phase in each trial."""
    law, reference, rng = of_another_controller(seed)
    omega, time = law.Q.cutoff / 3, law.Ts * np.arange(SAMPLES)[:, None]
    shape = trials, 1, reference.shape[1]
    waves = np.sin(omega * time + rng.uniform(0, 2 * np.pi, shape))
    white = 0.01 * rng.standard_normal(waves.shape)
    return run_trials(law.loop, law, 0 * reference, None, trials, noise=waves + white), law


WRONG = {
    f"P has {gain:g} times the gain": partial(another_gain, gain)
    for gain in (0.3, 0.5, 1.3, 2.0, 2.2)
} | {"a disturbance in another phase each time": another_phase}


def wrong(kind, seed):
    """After which trial something is said of an experiment of this kind, and its errors."""
    with warnings.catch_warnings(action="ignore"):
        log, law = WRONG[kind](seed)
    return alarms(log, law)


def quiet_row(name, results):
    """A row of the table of false alarms."""
    trials, false = sum(count for count, _ in results), sum(bool(a) for _, a in results)
    kinds = Counter(SHORT[kind] for _, alarm in results for kind in alarm)
    words = ", ".join(f"{word} {count}" for word, count in kinds.items()) or "none"
    rate = f"{1000 * false / trials:.2f}"
    return [name, words, f"{len(results)}", f"{trials}", f"{false}", rate]


def loud_row(kind, seeds):
    """A row of the table of detections."""
    found = [wrong(kind, seed) for seed in seeds]
    first = [min(alarm.values()) for alarm in found if alarm]
    words = Counter(SHORT[min(alarm, key=alarm.get)] for alarm in found if alarm)
    said = ", ".join(words) or "nothing"
    when = [f"{np.median(first):.0f}", f"{max(first)}"] if first else ["none", "none"]
    return [kind, said, f"{len(seeds)}", f"{len(first)}", *when]


QUIET = ["plant", "said", "experiments", "trials", "false alarms", "in 1,000 trials"]
LOUD = ["what is wrong", "said", "experiments", "noticed", "in trial, median", "at the latest"]


def main(count=COUNT, repeats=REPEATS, kinds=tuple(WRONG)):
    """Count both; the tables go to figures/performance.md."""
    results = list(run(converging, range(count)))
    names = [*LOOPS]
    quiet = [quiet_row(name, results[i :: len(names)]) for i, name in enumerate(names)]
    loud = list(run(loud_row, [(kind, range(repeats)) for kind in kinds]))
    publish("watch", f"{table(QUIET, quiet)}\n\n{table(LOUD, loud)}\n")


if __name__ == "__main__":
    main()
