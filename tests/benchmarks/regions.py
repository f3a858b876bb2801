"""How often the truth lies within the region of an estimate, for records of many kinds.

Plants and records are drawn by seed: `python tests/benchmarks/regions.py [RECORDS] [KIND ...]`.
Some two minutes a kind for 500 records on one core, five of two channels.
"""

import sys
import warnings

import numpy as np
from scipy.signal import lfilter

from rodlib import Law, LearningFilter, zero_phase_butterworth
from rodlib.ilc.files import write_whole
from rodlib.ilc.loop.notes import LogError
from rodlib.ilc.measurement.estimation import estimated_response
from rodlib.ilc.trials.run import dataset
from rodlib.paper.ledger import splice
from rodlib.paper.repository import ROOT

NOISE = 0.03  # relative to the gain of a plant, where a kind does not say otherwise


def lag(rng):
    """Two lags, sometimes with a zero or a delay, and gain one: numerator and denominator."""
    poles = np.sort(np.exp(-1 / rng.uniform([1, 3], [3, 10])))
    zero = rng.choice([0.0, rng.uniform(-0.9, 0.9), 1.3], p=[0.5, 0.3, 0.2])
    a, b = (
        np.poly(poles),
        np.append(np.zeros(1 + rng.choice([0, 5], p=[0.7, 0.3])), [1, -zero]),
    )
    return b * a.sum() / b.sum(), a


def resonance(rng):
    """A resonance with a damping of 0.05 to 0.3 behind a delay of a sample."""
    natural, damping = rng.uniform(0.15, 0.8), rng.uniform(0.05, 0.3)
    pole = np.exp(natural * (-damping + 1j * np.sqrt(1 - damping**2)))
    a = np.poly([pole, pole.conj()]).real
    return np.array([0, a.sum() / 2, a.sum() / 2]), a


def steps(rng, N):
    """A step test: a rest, one up, one down, one back, none of them of the same length."""
    ends = np.cumsum(rng.uniform([0.03, 0.3, 0.25], [0.1, 0.4, 0.35]))
    return np.select([np.arange(N) < end * N for end in ends], [0, 1, -0.5], 0.4)


def held_noise(rng, N):
    """Noise that is held for three samples."""
    return np.repeat(rng.standard_normal(N // 3 + 1), 3)[:N]


def answer(plant, u, rng, start=0.0):
    """Of one plant to one input, from rest or not."""
    b, a = plant
    state = np.zeros(max(len(a), len(b)) - 1)
    if start:  # what other inputs have left that ended just now
        state = lfilter(b, a, start * rng.standard_normal(200), zi=state)[1]
    return lfilter(b, a, u, zi=state)[0]


def walk(rng, N):
    """A drift that nobody knows: a line and a random walk."""
    return rng.normal(0, 0.3) * np.linspace(0, 1, N) + 0.01 * np.cumsum(
        rng.standard_normal(N)
    )


def single(u, y, of="u"):
    """A log of one trial."""
    return several(
        np.atleast_2d(u)[None].swapaxes(1, 2), np.atleast_2d(y)[None].swapaxes(1, 2), of
    )


def several(u, y, of="w"):
    """A log of trials (trial, time, channel)."""
    names = [f"y{i}" for i in range(y.shape[2])], [f"u{i}" for i in range(y.shape[2])]
    signals = {"reference": u, "v": 0 * u} | ({"u": u} if of == "u" else {})
    log = dataset(1.0, names[0], names[1] if of == "u" else [], [], {}, y=y, **signals)
    return log.drop_vars(["reference", "v", "e"]) if of == "u" else log


def learned(rng, trials=8, N=100, start=0.0):
    """Trials under learning, with a disturbance that repeats."""
    plant = lag(rng)
    impulse = answer(plant, np.eye(1, N)[0], rng)
    c = np.zeros((1, 1, 12))
    c[0, 0] = 0.5 * impulse[:12] / np.sum(np.abs(impulse)) / np.abs(impulse).max()
    L, Q = LearningFilter(c, 1.0), zero_phase_butterworth(2, 1.0, 1.0)
    r = 3 * np.sin(np.pi * np.minimum(np.arange(N) / (0.8 * N), 1)) ** 2
    disturbance = 0.3 * lfilter([1], [1, -0.9], rng.standard_normal(N))
    v, w, y = np.zeros((N, 1)), [], []
    for _ in range(trials):
        w.append(r[:, None] + v)
        y.append((answer(plant, w[-1][:, 0], rng, start) + disturbance)[:, None])
        y[-1] = y[-1] + NOISE * rng.standard_normal((N, 1))
        v = Law(Q, L).next(v, r[:, None] - y[-1])
    return several(np.array(w), np.array(y)), [[plant]]


def open_loop(rng, make=lag, excite=steps, N=100, noise=None, start=0.0, quantum=0.0):
    """A test of the plant by itself."""
    plant, u = make(rng), excite(rng, N)
    y = answer(plant, u, rng, start)
    y = y + (NOISE * rng.standard_normal(N) if noise is None else noise(rng, N))
    return single(u, np.rint(y / quantum) * quantum if quantum else y), [[plant]]


def reference(rng, N=100):
    """One trial of a closed loop, whose reference moves, with a disturbance."""
    plant, w = lag(rng), np.cumsum(steps(rng, N) - 0.2) / 20
    disturbance = 0.05 * lfilter([1], [1, -0.9], rng.standard_normal(N))
    y = answer(plant, w, rng) + disturbance + NOISE * rng.standard_normal(N)
    return several(w[None, :, None], y[None, :, None]), [[plant]]


def two(rng, N=100):
    """Two channels that are coupled, both moved in steps at different times."""
    plants = [[lag(rng), lag(rng)], [lag(rng), lag(rng)]]
    plants[0][1], plants[1][0] = ((0.3 * b, a) for b, a in (plants[0][1], plants[1][0]))
    u = np.array([steps(rng, N), np.roll(steps(rng, N)[::-1], N // 6)])
    u[1] -= u[1, 0]
    y = [sum(answer(p, x, rng) for p, x in zip(row, u, strict=True)) for row in plants]
    return single(u, np.array(y) + NOISE * rng.standard_normal((2, N))), plants


def coloured(rng, N):
    return 0.02 * lfilter([1], [1, -0.9], rng.standard_normal(N))


def drifting(rng, N):
    return NOISE / 2 * rng.standard_normal(N) + walk(rng, N)


def faint(rng, N):
    return 0.01 * rng.standard_normal(N)


KINDS = {
    "steps": open_loop,
    "noise, coloured noise": lambda rng: open_loop(
        rng, excite=held_noise, noise=coloured
    ),
    "steps, drift": lambda rng: open_loop(rng, noise=drifting),
    "noise, drift": lambda rng: open_loop(rng, excite=held_noise, noise=drifting),
    "steps, quantised": lambda rng: open_loop(rng, noise=faint, quantum=0.1),
    "steps, wrong start": lambda rng: open_loop(rng, start=1.0),
    "steps, short": lambda rng: open_loop(rng, N=40),
    "resonance, noise": lambda rng: open_loop(rng, make=resonance, excite=held_noise),
    "a reference moves": reference,
    "two channels": two,
    "learning": learned,
    "learning, 2 trials": lambda rng: learned(rng, trials=2),
    "learning, starts differ": lambda rng: learned(rng, start=0.3),
}


def response(plants, omega):
    """Of plants as numerators and denominators of 1/z, (n, m, m)."""
    z = np.exp(-1j * omega)
    each = [
        [np.polyval(b[::-1], z) / np.polyval(a[::-1], z) for b, a in row]
        for row in plants
    ]
    return np.moveaxis(np.array(each), 2, 0)


def main(records, kinds):
    """Count, a row for each kind; of all kinds the table goes to figures/performance.md."""
    table = [
        "| record | records | each, 95 % | all, 90 % | all, 99 % | known | radius | refused |"
    ]
    table += ["|---|---:|---:|---:|---:|---:|---:|---:|"]
    print(*table, sep="\n")
    for kind in kinds:
        each, every, known, size, refused = [], {0.9: [], 0.99: []}, [], [], 0
        for seed in range(records):
            log, plants = KINDS[kind](np.random.default_rng([seed, len(kind)]))
            try:
                with warnings.catch_warnings(action="ignore"):
                    found = estimated_response(log)
            except LogError:
                refused += 1
                continue
            truth = response(plants, found.omega)
            off = np.linalg.norm(found.response - truth, 2, axis=(1, 2))
            each.append(np.mean((off <= found.radius(0.95))[found.known]))
            for confidence, held in every.items():
                held.append(np.all(off <= found.radius(confidence, jointly=True)))
            known.append(found.known.mean())
            largest = np.linalg.norm(truth, 2, axis=(1, 2)).max()
            size.append(np.median(found.radius(0.95)[found.known]) / largest)
        table.append(
            f"| {kind} | {records} | {np.mean(each):.1%} | {np.mean(every[0.9]):.1%} | "
            f"{np.mean(every[0.99]):.1%} | {np.mean(known):.0%} | {np.median(size):.2g} | "
            f"{refused} |"
        )
        print(table[-1], flush=True)
    page = ROOT / "figures" / "performance.md"
    if kinds == [*KINDS]:
        write_whole(
            page, splice(page.read_text(encoding="utf-8"), "regions", "\n".join(table))
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500, sys.argv[2:] or [*KINDS])
