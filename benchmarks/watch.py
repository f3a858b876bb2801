"""Does the watch over trials keep quiet, and does it speak? False alarms and detections, counted.

`make measure WHAT=watch` runs 1,000 experiments that converge as promised, on three plants, and the
kinds that do not, and writes both tables to figures/performance.md. Seeds are fixed.
"""

import warnings
from collections import Counter
from functools import cache, partial

import numpy as np
import plants
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
SHORT = {"growth": "it grows", "dead": "it does not move", "model": "not the model"}
LOOPS = {  # a loop, the outputs' amplitudes, the cut-off of Q, and the order of L
    "stage": (plants.LOOPS["stage"](), [10.0], 60.0, 20),
    "tanks": (plants.LOOPS["tanks"](), [10.0, 5.0, 8.0], 0.05, 20),
    "furnace": (current_trial_loop(plants.furnace(30), sizes={"valve": 0.1}), [10.0], 0.05, 40),
}


@cache
def case(name):
    """Law and reference of one of the three plants."""
    loop, amplitudes, cutoff, order = LOOPS[name]
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    design = synthesise(loop, Q, order=order, band=(cutoff / 1e3, cutoff / 3))
    return Law(Q, design.filter, loop=loop), plants.bump(SAMPLES, amplitudes)


def noise_of(rng, shape, size):
    """Independent from trial to trial; white or coloured in time."""
    pole = rng.choice([0.0, 0.5, 0.9, 0.98])
    noise = rng.standard_normal((shape[0], shape[1] + 200, shape[2]))
    return size * lfilter([np.sqrt(1 - pole**2)], [1, -pole], noise, axis=1)[:, 200:]


def converging(seed):
    """Trials, and those of which something is said, of an experiment that converges as promised."""
    rng = np.random.default_rng(seed)
    law, reference = case([*LOOPS][seed % len(LOOPS)])
    loop, trials, largest = law.loop, int(rng.integers(4, 16)), np.abs(reference).max()
    law = Law(law.Q, law.L, gain=rng.choice([1.0, 0.5, 0.2]), loop=loop)
    noise = noise_of(rng, (trials, *reference.shape), 10 ** rng.uniform(-4, -0.5) * largest)
    repeating = plants.bump(SAMPLES, rng.normal(0, largest / 10, len(loop.disturbances)))
    return trials, alarms(law, reference, repeating, trials, plant=loop.plant, noise=noise)


def alarms(law, *experiment, **rig):
    """The trial after which each kind of warning comes first."""
    first = {}
    with warnings.catch_warnings(action="ignore"):
        log = run_trials(law.loop, law, *experiment, **rig)
    for k in range(2, log.sizes["trial"] + 1):
        for kind in diagnose(log.isel(trial=slice(k)), law, first=k):
            first.setdefault(kind, k)
    return first


def of_another_controller(seed):
    """A law for a loop whose controller is not ours, its reference, and random numbers."""
    law, reference = case([*LOOPS][seed % len(LOOPS)])
    law = Law(law.Q, law.L, loop=ClosedLoop(law.loop.P))
    return law, reference, np.random.default_rng(seed)


def another_gain(gain, seed):
    """P of a ClosedLoop has another gain."""
    law, reference, rng = of_another_controller(seed)
    noise = noise_of(rng, (20, *reference.shape), 1e-3 * np.abs(reference).max())
    return alarms(law, reference, None, 20, plant=plants.altered(law.loop.P, B=gain), noise=noise)


def another_phase(seed):
    """A disturbance of the outputs comes in another phase in each trial."""
    law, reference, rng = of_another_controller(seed)
    omega, time = law.Q.cutoff / 3, law.Ts * np.arange(SAMPLES)[:, None]
    waves = np.sin(omega * time + rng.uniform(0, 2 * np.pi, (30, 1, reference.shape[1])))
    white = 0.01 * rng.standard_normal(waves.shape)
    return alarms(law, 0 * reference, None, 30, noise=waves + white)


WRONG = {
    f"P has {gain:g} times the gain": partial(another_gain, gain)
    for gain in (0.3, 0.5, 1.3, 2.0, 2.2)
} | {"a disturbance in another phase each time": another_phase}


def quiet_row(name, results):
    """A row of the table of false alarms."""
    counts, found = zip(*results, strict=True)
    trials, false = sum(counts), sum(map(bool, found))
    kinds = Counter(SHORT[kind] for alarm in found for kind in alarm)
    words = ", ".join(f"{word} {count}" for word, count in kinds.items()) or "none"
    return [name, words, f"{len(found)}", f"{trials}", f"{false}", f"{1000 * false / trials:.2f}"]


def loud_row(kind, repeats):
    """A row of the table of detections."""
    found = [alarm for seed in range(repeats) if (alarm := WRONG[kind](seed))]
    first = [min(alarm.values()) for alarm in found]
    said = ", ".join(dict.fromkeys(SHORT[min(alarm, key=alarm.get)] for alarm in found))
    when = [f"{np.median(first):.0f}", f"{max(first)}"] if found else ["none", "none"]
    return [kind, said or "nothing", f"{repeats}", f"{len(found)}", *when]


QUIET = ["plant", "said", "experiments", "trials", "false alarms", "in 1,000 trials"]
LOUD = ["what is wrong", "said", "experiments", "noticed", "in trial, median", "at the latest"]


def main(count=COUNT, repeats=REPEATS, kinds=tuple(WRONG)):
    """Count both; the tables go to figures/performance.md."""
    results = list(run(converging, range(count)))
    quiet = [quiet_row(name, results[i :: len(LOOPS)]) for i, name in enumerate(LOOPS)]
    loud = list(run(loud_row, [(kind, repeats) for kind in kinds]))
    publish("watch", f"{table(QUIET, quiet)}\n\n{table(LOUD, loud)}\n")


if __name__ == "__main__":
    main()
