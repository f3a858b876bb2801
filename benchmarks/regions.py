"""How often the truth lies within the region of an estimate, for records of many kinds.

Plants and records are drawn by seed: `python benchmarks/regions.py [RECORDS] [KIND ...]`.
A kind has a log or several, the plants behind them, and further arguments of the estimate. Under a
minute a kind for 200 records on one core, some minutes where records are long.
"""

import sys
import time
import warnings
from functools import partial

import numpy as np
from runner import publish, run, table
from scipy.signal import freqz, lfilter

from ilctools import InfeasibleError, measured_response, rate, synthesise, zero_phase_butterworth
from ilctools.loop.notes import LogError
from ilctools.trials.run import dataset

NOISE = 0.03  # relative to the gain of a plant, where a kind does not say otherwise


def lag(rng):
    """Two lags, sometimes with a zero or a delay, and gain one: numerator and denominator."""
    poles = np.sort(np.exp(-1 / rng.uniform([1, 3], [3, 10])))
    zero = rng.choice([0.0, rng.uniform(-0.9, 0.9), 1.3], p=[0.5, 0.3, 0.2])
    delay = 1 + rng.choice([0, 5], p=[0.7, 0.3])
    a, b = np.poly(poles), np.append(np.zeros(delay), [1, -zero])
    return b * a.sum() / b.sum(), a


def resonance(rng):
    """A resonance with a damping of 0.05 to 0.3 behind a delay of a sample."""
    natural, damping = rng.uniform(0.15, 0.8), rng.uniform(0.05, 0.3)
    pole = np.exp(natural * (-damping + 1j * np.sqrt(1 - damping**2)))
    a = np.poly([pole, pole.conj()]).real
    return np.array([0, a.sum() / 2, a.sum() / 2]), a


def late(rng):
    """A lag behind a delay of 100 to 250 samples."""
    pole = np.exp(-1 / rng.uniform(10, 60))
    return np.append(np.zeros(rng.integers(101, 252)), 1 - pole), np.array([1, -pole])


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


def white(rng, N, size=NOISE):
    return size * rng.standard_normal(N)


def coloured(rng, N, size=0.02):
    return lfilter([1], [1, -0.9], white(rng, N, size))


def drifting(rng, N):
    """Noise, and a drift that nobody knows: a line and a random walk."""
    noise, slope = white(rng, N, NOISE / 2), rng.normal(0, 0.3)
    return noise + slope * np.linspace(0, 1, N) + np.cumsum(white(rng, N, 0.01))


def several(u, y, of="w"):
    """A log of trials (trial, time, channel), of a loop or of a plant by itself (of="u")."""
    outputs, inputs = ([f"{name}{i}" for i in range(y.shape[2])] for name in "yu")
    if of == "w":
        return dataset(1.0, outputs, [], [], {}, y=y, reference=u, v=0 * u)
    log = dataset(1.0, outputs, inputs, [], {}, y=y, reference=u, v=0 * u, u=u)
    return log.drop_vars(["reference", "v", "e"])


def single(u, y, of="u"):
    """A log of one trial, signals (time,) or (channel, time)."""
    return several(*(np.atleast_2d(signal).T[None] for signal in (u, y)), of)


def learned(rng, trials=8, N=100, start=0.0, delay=0):
    """Trials under learning, with a disturbance that repeats."""
    b, a = lag(rng)
    plant = np.append(np.zeros(delay), b), a
    Q, omega = zero_phase_butterworth(2, 0.3, 1.0), np.geomspace(0.01, np.pi, 100)
    with warnings.catch_warnings(action="ignore"):
        law = synthesise(1.2 * response([[plant]], omega), Q, omega, Ts=1.0, M_max=0.95).law()
    r = 3 * np.sin(np.pi * np.minimum(np.arange(N) / (0.8 * N), 1)) ** 2
    disturbance, v = coloured(rng, N, 0.3), np.zeros((N, 1))
    w, y = np.zeros((2, trials, N))
    for k in range(trials):
        w[k] = r + v[:, 0]
        y[k] = answer(plant, w[k], rng, start) + disturbance + white(rng, N)
        v = law.next(v, (r - y[k])[:, None])
    return several(w[..., None], y[..., None]), [[plant]]


def open_loop(rng, make=lag, excite=steps, N=100, noise=white, start=0.0, quantum=0):
    """A test of the plant by itself."""
    plant, u = make(rng), excite(rng, N)
    y = answer(plant, u, rng, start) + noise(rng, N)
    return single(u, np.rint(y / quantum) * quantum if quantum else y), [[plant]]


def reference(rng, N=100):
    """One trial of a closed loop, whose reference moves, with a disturbance."""
    plant, w = lag(rng), np.cumsum(steps(rng, N) - 0.2) / 20
    disturbance = coloured(rng, N, 0.05)
    y = answer(plant, w, rng) + disturbance + white(rng, N)
    return single(w, y, "w"), [[plant]]


def two(rng, N=100):
    """Two channels that are coupled, both moved in steps at different times."""
    plants = [[lag(rng), lag(rng)], [lag(rng), lag(rng)]]
    plants[0][1], plants[1][0] = ((0.3 * b, a) for b, a in (plants[0][1], plants[1][0]))
    u = np.array([steps(rng, N), np.roll(steps(rng, N)[::-1], N // 6)])
    u[1] -= u[1, 0]
    y = [sum(answer(p, x, rng) for p, x in zip(row, u, strict=True)) for row in plants]
    return single(u, np.array(y) + white(rng, (2, N))), plants


def modes(rng):
    """Four modes, damped by 0.005 to 0.03, the last near the Nyquist frequency; gain one."""
    natural = np.append(rng.uniform(0.15, 2.2, 3), rng.uniform(2.6, 3.0))
    damping, gains = rng.uniform(0.005, 0.03, 4), rng.uniform(0.3, 1, 4)
    gains *= rng.choice([-1, 1], 4) * np.where(natural > 1, 0.3, 1)
    poles = np.exp(natural * (-damping + 1j * np.sqrt(1 - damping**2)))
    pairs = [np.poly([pole, pole.conj()]).real for pole in poles]
    a, b = np.ones(1), np.zeros(9)
    for k, pair in enumerate(pairs):
        a, others = np.convolve(a, pair), np.ones(1)
        for other in pairs[:k] + pairs[k + 1 :]:
            others = np.convolve(others, other)
        b[1:8] += gains[k] * pair.sum() * others
    return b * a.sum() / np.abs(b.sum()), a


def flexible(rng, N=1500):
    """A structure with lightly damped modes, moved by white noise."""
    plant, u = modes(rng), white(rng, N, 1.0)
    y = answer(plant, u, rng)
    return single(u, y + white(rng, N, NOISE * y.std())), [[plant]]


def two_resonances(rng, N=1024):
    """Two channels that share two resonances."""
    a = np.convolve(resonance(rng)[1], resonance(rng)[1])
    plants = [[None, None], [None, None]]
    for i, j in np.ndindex(2, 2):
        b = np.append(0, rng.uniform(-1, 1, 3))
        plants[i][j] = b * (1 if i == j else 0.3) * a.sum() / b.sum(), a
    u = np.array([held_noise(rng, N) for _ in range(2)])
    y = [sum(answer(p, x, rng) for p, x in zip(row, u, strict=True)) for row in plants]
    return single(u, np.array(y) + white(rng, (2, N))), plants


def feedback(rng, N=600):
    """The plant in a loop of a PI controller, with coloured noise; of the commands."""
    (b, a), r, noise = lag(rng), held_noise(rng, N), coloured(rng, N, 0.05)
    x, y, u, integral = np.zeros(N), np.zeros(N), np.zeros(N), 0.0
    for t in range(N):
        x[t] = sum(b[i] * u[t - i] for i in range(1, min(len(b), t + 1)))
        x[t] -= sum(a[i] * x[t - i] for i in range(1, min(len(a), t + 1)))
        y[t] = x[t] + noise[t]
        integral += 0.02 * (r[t] - y[t])
        u[t] = 0.3 * (r[t] - y[t]) + integral
    log = single(u, y).assign(reference=(("trial", "time", "channel"), r[None, :, None]))
    return log, [[(b, a)]], "u"


def oversampled(rng, N=10_000):
    """A slow plant, sampled a hundred times too fast."""
    a = np.poly(np.exp(-1 / rng.uniform([150, 10], [400, 50])))
    u = np.repeat(rng.standard_normal(N // 300 + 1), 300)[:N]
    plant = np.array([0, a.sum()]), a
    return single(u, answer(plant, u, rng) + white(rng, N)), [[plant]]


def of_three_lengths(rng):
    plant, logs = resonance(rng), []
    for N in (200, 500, 3000):
        u = held_noise(rng, N)
        logs.append(single(u, answer(plant, u, rng, 0.3) + white(rng, N)))
    return logs, [[plant]]


def saturating(rng, trials=20, N=150):
    """The first three trials are driven three times as hard as the others, and are cut off."""
    plant, u = lag(rng), np.cumsum(white(rng, (trials, N), 0.1), axis=1)
    u += 3 * np.sin(np.pi * np.minimum(np.arange(N) / (0.8 * N), 1)) ** 2
    u[:3] *= 3
    y = np.array([answer(plant, np.clip(x, -4, 4), rng) for x in u])
    y += coloured(rng, N, 0.1) + white(rng, (trials, N))
    return several(u[..., None], y[..., None], "u"), [[plant]]


def quadratic(rng, N=400):
    plant, u = lag(rng), held_noise(rng, N)
    return single(u, answer(plant, u + 0.2 * u**2, rng) + white(rng, N)), [[plant]]


def drifts(rng, N=400):
    """The gain of the plant rises by a fifth."""
    plant, u = lag(rng), held_noise(rng, N)
    y = np.linspace(0.9, 1.1, N) * answer(plant, u, rng) + white(rng, N)
    return single(u, y), [[plant]]


def two_logs(rng, N=100):
    """The same step test twice, by inputs that hardly differ."""
    plant, u = lag(rng), np.outer([1, 1.01], steps(rng, N))
    y = np.array([answer(plant, x, rng) for x in u]) + white(rng, (2, N))
    return several(u[..., None], y[..., None], "u"), [[plant]]


noisy = partial(open_loop, excite=held_noise)
KINDS = {
    "steps": open_loop,
    "noise, coloured noise": partial(noisy, noise=coloured),
    "steps, drift": partial(open_loop, noise=drifting),
    "noise, drift": partial(noisy, noise=drifting),
    "steps, quantised": partial(open_loop, noise=partial(white, size=0.01), quantum=0.1),
    "steps, wrong start": partial(open_loop, start=1.0),
    "steps, short": partial(open_loop, N=40),
    "resonance, noise": partial(noisy, make=resonance),
    "a reference moves": reference,
    "two channels": two,
    "learning": learned,
    "learning, 2 trials": partial(learned, trials=2),
    "learning, starts differ": partial(learned, start=0.3),
    "learning, delay of 30": partial(learned, delay=30, N=200),
    "the same step twice": two_logs,
    "four modes": flexible,
    "two channels, resonance": two_resonances,
    "feedback, coloured noise": feedback,
    "slow, 10,000 samples": oversampled,
    "a long delay, noise": partial(noisy, make=late, N=2000),
    "a long delay, steps": partial(open_loop, make=late, N=2000),
    "three lengths": of_three_lengths,
    "three trials saturate": saturating,
    "quadratic": quadratic,
    "gain drifts by 20 %": drifts,
}


def response(plants, omega):
    """Of plants as numerators and denominators of 1/z, (n, m, m)."""
    rows = [[freqz(b, a, omega)[1] for b, a in row] for row in plants]
    return np.moveaxis(np.array(rows), 2, 0)


ORDERS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 40])  # of an ARX by least squares


def signals_of(logs, of=None):
    """Of each trial the input and the output, (time, channel), less their first samples."""
    for log in logs if isinstance(logs, list) else [logs]:
        commands = of == "u" or "reference" not in log
        u = log.u if commands else log.reference + log.v
        for x, y in zip(u.values, log.y.values, strict=True):
            yield x - x[0], y - y[0]


def lagged(signal, order, first):
    """Columns of a signal (time,) delayed by `first` to `order` samples, (time, delay)."""
    N = len(signal)
    return np.array([signal[order - k : N - k] for k in range(first, order + 1)]).T


def least_squares(logs, of=None, draws=200):
    """ARX of each output by least squares, the order by AIC; draws of its coefficients."""
    trials = list(signals_of(logs, of))
    m, rng, rows = trials[0][0].shape[1], np.random.default_rng(0), []
    shortest = min(len(y) for _, y in trials)
    for i in range(trials[0][1].shape[1]):
        best = np.inf
        for order in ORDERS[: np.searchsorted(ORDERS, shortest // (2 * m + 4), "right")]:
            X = [
                np.hstack([-lagged(y[:, i], order, 1), *(lagged(x, order, 0) for x in u.T),
                           np.ones((len(y) - order, 1))])
                for u, y in trials
            ]  # fmt: skip
            X, b = np.vstack(X), np.concatenate([y[order:, i] for _, y in trials])
            U, sizes, V = np.linalg.svd(X, full_matrices=False)
            kept = sizes > 1e-9 * sizes[0]
            inverse = V[kept].T / sizes[kept]
            c = inverse @ (U[:, kept].T @ b)
            deviation = np.std(b - X @ c)
            criterion = 2 * len(b) * np.log(deviation) + 2 * len(c)
            if criterion < best:
                best, chosen = criterion, (order, c, deviation * inverse)
        order, c, root = chosen
        errors = rng.standard_normal((draws, root.shape[1])) @ root.T
        drawn = np.vstack([c, c + errors])
        rows.append((order, drawn))
    return rows, m


def response_of(rows, m, omega):
    """Of an ARX, the estimate and draws, (draw, n, output, input)."""
    P = []
    for order, c in rows:
        waves = np.exp(-1j * np.outer(np.arange(order + 1), omega))
        A = 1 + c[:, :order] @ waves[1:]
        B = c[:, order:-1].reshape(len(c), m, order + 1) @ waves
        P.append(np.moveaxis(B / A[:, None], 1, 2))
    return np.stack(P, axis=2)


def baseline(logs, of, omega, known, truth):
    """Of the least squares: whether the truth is in its joint 99 % region, its median radius."""
    P, *drawn = response_of(*least_squares(logs, of), omega)
    norms = np.linalg.norm(np.array(drawn) - P, 2, axis=(2, 3))
    radius = np.quantile(norms, 0.95, axis=0)
    region = radius * np.quantile((norms / radius).max(axis=1), 0.99)
    return np.all(np.linalg.norm(P - truth, 2, axis=(1, 2)) <= region), np.median(radius[known])


RESONANT = ("resonance, noise", "four modes", "two channels, resonance")
DESIGN = {"order": 20, "M_max": 0.9, "L_max": 100.0}  # for the resonant kinds


def designed(P, plants):
    """Whether there is a filter for all of the region, and the peak that it has on the truth."""
    low = P.omega[P.known][0]
    omega, Q = np.geomspace(low, np.pi, 400), zero_phase_butterworth(2, 0.3, 1.0)
    try:
        with warnings.catch_warnings(action="ignore"):  # of peaks between the frequencies
            L = synthesise(P, Q, omega, band=(low, 0.3), **DESIGN).filter
    except InfeasibleError:
        return False, 0.0
    return True, rate(response(plants, omega), Q, L, omega).gamma


def counted(kind, records):
    """The row of the table for a kind of record."""
    inside, known, radii, seconds, feasible, kept, others = [], [], [], [], [], [], []
    refused = warned = silent = 0
    for seed in range(records):
        log, plants, *of = KINDS[kind](np.random.default_rng([seed, len(kind)]))
        began = time.process_time()
        try:
            with warnings.catch_warnings(action="ignore"):
                P = measured_response(log, *of)
        except LogError:
            refused += 1
            continue
        seconds.append(time.process_time() - began)
        truth = response(plants, P.omega)
        off = np.linalg.norm(P.response - truth, 2, axis=(1, 2))
        radius, largest = P.radius(0.95), np.linalg.norm(truth, 2, axis=(1, 2)).max()
        regions = [P.radius(confidence, jointly=True) for confidence in (0.9, 0.99)]
        within = [np.all(off <= region) for region in regions]
        inside.append([np.mean(off <= radius), *within])
        known.append(P.known.mean())
        radii.append(np.median(radius[P.known]) / largest)
        warned += bool(P.findings)
        silent += not (within[1] or P.findings)
        held, wide = baseline(log, *(of or [None]), P.omega, P.known, truth)
        others.append([held, wide / largest])
        if kind in RESONANT:
            one, gamma = designed(P, plants)
            feasible.append(one)
            kept += [gamma <= DESIGN["M_max"]] if one else []
    shares = [f"{share:.1%}" for share in np.mean(inside, axis=0)]
    numbers = [f"{np.mean(known):.0%}", f"{np.median(radii):.2g}", f"{np.median(seconds):.2g}"]
    counts = [f"{count}" for count in (refused, warned, silent)]
    held, wide = np.transpose(others)
    arx = [f"{held.mean():.0%}", f"{np.median(wide):.2g}"]
    filters = f"{sum(feasible)}, {sum(kept)}" if feasible else ""
    return [kind, f"{records}", *shares, *numbers, *counts, *arx, filters]


TITLES = [
    "record", "records", "each, 95 %", "all, 90 %", "all, 99 %", "known", "radius", "CPU (s)",
    "refused", "warned", "missed in silence", "least squares: all, 99 %", "radius",
    "filters: feasible, keep 0.9",
]  # fmt: skip


def main(records, kinds):
    """Count, a row for each kind; of all kinds the table goes to figures/performance.md."""
    rows = list(run(partial(counted, records=records), kinds))
    text = table(TITLES, rows)
    print(text)
    if kinds == [*KINDS]:
        publish("regions", text)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200, sys.argv[2:] or [*KINDS])
