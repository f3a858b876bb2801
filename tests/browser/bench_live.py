"""How long it takes from letting go of a slider to the new picture, in 50 settings.

``pytest -s tests/browser/bench_live.py``. Each setting moves one slider to a random place. Beside
the time that a reader waits, which other work on the machine makes longer, the processor time that
the kernel spends is given.
"""

import numpy as np
import psutil

SETTINGS, SEED = 50, 0
SLIDERS = [
    "M_max",
    "L_max",
    "cut-off (rad/s)",
    "order of Q",
    "order of L",
    "uncertainty (%)",
    "noise (K)",
]


def kernel():
    """The process that computes."""
    below = psutil.Process().children(recursive=True)
    return next(p for p in below if "ipykernel_launcher" in " ".join(p.cmdline()))


def spent(process):
    times = process.cpu_times()
    return times.user + times.system


def test_latency(reader):
    rng, process = np.random.default_rng(SEED), kernel()
    waited, computed, infeasible, structures = [], [], 0, ["diagonal", "full"]
    reader.drag("M_max", 0.97)  # a warm start
    reader.page.wait_for_timeout(3000)
    while len(waited) < SETTINGS:
        if rng.random() < 0.15:  # the structure is a list, and not timed
            structures.reverse()
            reader.choose("structure", structures[0])
        name, before = rng.choice(SLIDERS), len(reader.times)
        share = rng.uniform(0.75, 1) if name == "M_max" else rng.uniform(0.02, 0.98)
        start, said = spent(process), reader.read(name)
        reader.drag(name, share)
        if reader.read(name) == said:  # of few places, it was the same
            continue
        reader.page.wait_for_function(
            "before => window.times.length > before", arg=before
        )
        reader.page.wait_for_timeout(100)
        waited += reader.times[before:]
        computed.append(spent(process) - start)
        if (
            not reader.python.strip()
        ):  # from one reason to the same there is no new picture
            infeasible += 1
            reader.choose("plant", "a log")
            reader.choose("plant", "the rod")
            structures = ["diagonal", "full"]
    for name, values in (
        ("wait", np.array(waited) / 1000),
        ("processor", np.array(computed)),
    ):
        print(
            f"\n{name}: median {np.median(values):.2f} s, longest {values.max():.2f} s",
            end="",
        )
    print(f"\n{len(waited)} settings, {infeasible} infeasible")
