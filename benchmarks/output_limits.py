"""Limits of outputs on random plants that are wrong within the radius: kept, and what they cost."""

import sys
import warnings

import numpy as np
from limited import task

from ilctools import rms, run_trials

SHAPES = {"one": (1, 1), "two": (2, 2), "three": (3, 3), "3 x 2": (3, 2), "1 x 2": (1, 2)}
TRIALS = 10
SLACK = 1e-9  # of a limit: rounding


def tried(seed, p, m):
    """Excess over limits, whether the plain law breaks them, and ratios of errors, by truth."""
    one = task(seed, p, m)
    if one is None:
        return
    rng = np.random.default_rng(seed)
    low, high = one.law.output_limits.ends(len(one.reference))
    size = np.abs(one.reference).max(axis=0)
    for truth in one.truths:
        noise = one.noise * rng.uniform(-1, 1, (TRIALS, *one.reference.shape))
        kept, plain = (
            run_trials(one.loop, law, one.reference, trials=TRIALS, plant=truth, noise=noise)
            for law in (one.law, one.plain)
        )
        excess = [
            float(np.max(np.maximum(run.y - high, low - run.y) / size)) for run in (kept, plain)
        ]
        errors = [rms(run.e / size).values for run in (kept, plain)]
        yield *excess, errors[0], errors[1]


def main(count: int = 40) -> None:
    """Print a line for each shape."""
    for name, (p, m) in SHAPES.items():
        rows = [row for seed in range(count) for row in tried(seed, p, m)]
        broken = sum(kept > SLACK for kept, *_ in rows)
        plain = sum(excess > SLACK for _, excess, *_ in rows)
        learned = [kept / law for _, _, kept, law in rows if law[-1] < 0.9 * law[0]]
        ratios = np.median(learned, axis=0)
        near = np.mean([ratio[-1] < 1.2 for ratio in learned])
        print(
            f"{name}: {len(rows)} plants, beyond a limit {broken}, by the plain law {plain}; RMS "
            f"relative to the plain law in trials 2, 5, 10: {ratios[[1, 4, 9]].round(2)}; within "
            f"1.2 in trial 10: {near:.0%} of {len(learned)}",
            flush=True,
        )


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main(*map(int, sys.argv[1:]))
