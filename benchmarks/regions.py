"""How often the truth lies within the region of an estimate, for records of many kinds.

Plants and records are drawn by seed. A kind has a log or several, the plants behind them, and
further arguments of the estimate. Of CURVED kinds, which are not one linear plant, only the
warnings count. Up to five minutes a kind on one core.
"""

import time
import warnings
from functools import partial, reduce

import numpy as np
import pandas as pd
from numpy.polynomial.polynomial import polyadd
from records import backlash, dead, held, in_a_loop, pair, resonant, steps
from runner import publish, run, table
from scipy.signal import cont2discrete, freqz, lfilter

from ilctools import (
    InfeasibleError,
    convergence,
    measured_response,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.errors import LogError
from ilctools.signals import dataset

RECORDS = 200  # of a kind
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
    return resonant(rng.uniform(0.15, 0.8), rng.uniform(0.05, 0.3))


def first_order(T, gain=1.0, delay=1):
    """A lag of T samples, with this gain at rest."""
    pole = np.exp(-1 / T)
    return np.append(np.zeros(delay), gain * (1 - pole)), np.array([1, -pole])


def beside(one, other):
    """The sum of two plants."""
    (b, a), (d, c) = one, other
    return polyadd(np.convolve(b, c), np.convolve(d, a)), np.convolve(a, c)


def late(rng):
    """A lag behind a delay of 100 to 250 samples."""
    return first_order(rng.uniform(10, 60), delay=rng.integers(101, 252))


def slow(rng):
    """Two lags, sampled a hundred times too fast."""
    a = np.poly(np.exp(-1 / rng.uniform([150, 10], [400, 50])))
    return np.array([0, a.sum()]), a


def fast_and_slow(rng):
    """A lag of 10 samples, and beside it one of 200 to 400 with a tenth to a fifth of the gain."""
    share = rng.uniform(0.1, 0.2)
    return beside(first_order(10.0, 1 - share), first_order(rng.uniform(200, 400), share))


def undershooting(rng):
    """A lag of 4 to 8 samples, less one of 150 to 400 with a fifth to a half of the gain."""
    fast, slowly = first_order(rng.uniform(4, 8)), rng.uniform(150, 400)
    return beside(fast, first_order(slowly, -rng.uniform(0.2, 0.5)))


def arch(N):
    """Up, down again, and a rest."""
    return np.sin(np.pi * np.minimum(np.arange(N) / (0.8 * N), 1)) ** 2


def answer(plant, u, rng, start=0.0):
    """Of one plant to one input, from rest, or after other inputs that ended just now."""
    before = start * rng.standard_normal(200 if start else 0)
    return lfilter(*plant, np.append(before, u))[len(before) :]


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
    signals = {"reference": u, "v": 0 * u} if of == "w" else {"u": u}
    return dataset(1.0, outputs, inputs, [], {}, y=y, **signals)


def single(u, y, of="u"):
    """A log of one trial, signals (time,) or (channel, time)."""
    return several(*(np.atleast_2d(signal).T[None] for signal in (u, y)), of)


def learned(rng, trials=8, N=100, start=0.0, delay=0, make=lag, last=0):
    """Trials under learning, or the last of them, with a disturbance that repeats."""
    b, a = make(rng)
    plant = np.append(np.zeros(delay), b), a
    Q, omega = zero_phase_butterworth(2, 0.3, 1.0), np.geomspace(0.01, np.pi, 100)
    with warnings.catch_warnings(action="ignore"):
        law = synthesise(1.2 * response([[plant]], omega), Q, omega, Ts=1.0, M_max=0.95).law()
    r, disturbance = 3 * arch(N)[:, None], coloured(rng, N, 0.3)
    w, y = np.zeros((2, trials, N, 1))
    v = 0 * r
    for k in range(trials):
        w[k] = r + v
        y[k, :, 0] = answer(plant, w[k, :, 0], rng, start) + disturbance + white(rng, N)
        v = law.next(v, r - y[k])
    return several(w[-last:], y[-last:]), [[plant]]


def open_loop(rng, make=lag, excite=steps, N=100, noise=white, start=0.0, bent=np.array, drift=0):
    """A test of the plant by itself, of u as it is bent, while its gain rises by a share."""
    plant, u = make(rng), excite(rng, N)
    gain = np.linspace(1 - drift / 2, 1 + drift / 2, N)
    y = gain * answer(plant, bent(u), rng, start) + noise(rng, N)
    return single(u, y), [[plant]]


def reference(rng, N=100):
    """One trial of a closed loop, whose reference moves, with a disturbance."""
    plant, w = lag(rng), np.cumsum(steps(rng, N) - 0.2) / 20
    y = lfilter(*plant, w) + coloured(rng, N, 0.05) + white(rng, N)
    return single(w, y, "w"), [[plant]]


def two(rng, N=100, common=0.0):
    """Two channels, with 0.3 times such gains to each other, moved in steps at different times.

    Of the noise a share (1 at most) is in both.
    """
    a, (b, c), (d, e), f = (lag(rng) for _ in range(4))
    plants = [[a, (0.3 * b, c)], [(0.3 * d, e), f]]
    u = np.array([steps(rng, N), np.roll(steps(rng, N)[::-1], N // 6)])
    u[1] -= u[1, 0]
    y = [sum(lfilter(*p, x) for p, x in zip(row, u, strict=True)) for row in plants]
    noise = np.sqrt(common) * white(rng, N) + np.sqrt(1 - common) * white(rng, u.shape)
    return single(u, y + noise), plants


def disturbed(rng, N=150):
    """Two channels, while a heater is switched and the air drifts, both of which were recorded."""
    log, plants = two(rng, N)
    heater = np.repeat(rng.integers(0, 2, N), rng.integers(10, 30))[:N]
    air = np.cumsum(0.1 * rng.standard_normal(N))
    moved = [sum(lfilter(*lag(rng), d) for d in (heater, air)) for _ in plants]
    y, known = log.y + np.stack(moved, axis=1), np.stack([heater, air], axis=1)[None]
    signals = {"u": log.u.values, "y": y.values, "disturbance": known}
    channels = log.output.values, log.control.values, ["heater", "air"]
    return dataset(1.0, *channels, {}, **signals), plants


def modes(rng, damped=0.03):
    """Four modes, damped by 0.005 or more, the last near the Nyquist frequency; gain one."""
    natural = np.append(rng.uniform(0.15, 2.2, 3), rng.uniform(2.6, 3.0))
    damping, gains = rng.uniform(0.005, damped, 4), rng.uniform(0.3, 1, 4)
    gains *= rng.choice([-1, 1], 4) * np.where(natural > 1, 0.3, 1)
    poles = map(pair, natural, damping)
    each = [([0, gain * a.sum()], a) for gain, a in zip(gains, poles, strict=True)]
    b, a = reduce(beside, each)
    return b * a.sum() / np.abs(b.sum()), a


def weak_mode(rng):
    """A mode, and next to it a weaker one, both damped by 0.005 to 0.01."""
    natural = rng.uniform(0.3, 1.0)
    large, (b, a) = (
        resonant(natural * ratio, rng.uniform(0.005, 0.01)) for ratio in (1, rng.uniform(1.04, 1.2))
    )
    return beside(large, (rng.uniform(0.2, 0.7) * b, a))


def flexible(rng, N=1500, make=modes, noise=NOISE):
    """A structure with lightly damped modes, moved by white noise."""
    plant, u = make(rng), white(rng, N, 1.0)
    y = lfilter(*plant, u)
    return single(u, y + white(rng, N, noise * y.std())), [[plant]]


def feedback(rng, N=600, moves=1.0, logged=True):
    """The plant in a loop of a PI controller, with coloured noise; of the commands."""
    plant, r, noise = lag(rng), moves * held(rng, N), coloured(rng, N, 0.05)
    u, y = in_a_loop(plant, ([0.32, -0.3], [1.0, -1.0]), r, noise)
    log = single(u, y)
    if logged:
        log["reference"] = log.y.copy(data=r[None, :, None])
    return log, [[plant]], "u"


def regulated(rng, N=600):
    """The same loop without its reference, which moves as little as the noise, or rests."""
    return feedback(rng, N, rng.choice([0.0, 0.05]), logged=False)


def of_three_lengths(rng):
    plant = resonance(rng)
    own = partial(noisy, rng, make=lambda rng: plant, start=0.3)
    return [own(N=N)[0] for N in (200, 500, 3000)], [[plant]]


def saturating(rng, trials=20, N=150):
    """The first three trials are driven three times as hard as the others, and are cut off."""
    plant, u = lag(rng), np.cumsum(white(rng, (trials, N), 0.1), axis=1) + 3 * arch(N)
    u[:3] *= 3
    y = lfilter(*plant, u.clip(-4, 4)) + coloured(rng, N, 0.1) + white(rng, (trials, N))
    return several(u[..., None], y[..., None], "u"), [[plant]]


def integrator(rng):
    """An integrator, which does not settle."""
    return np.array([0, rng.uniform(0.02, 0.1)]), np.array([1.0, -1.0])


def spring(rng, N=2000, stiffening=0.1):
    """A resonance whose spring stiffens with the square of its travel; the truth is for none."""
    u, omega, damping, step = held(rng, N), 0.3, 0.02, 0.25
    y, v, x = [], 0.0, 0.0
    for force in u:
        y.append(x)
        for _ in range(round(1 / step)):
            pull = omega**2 * (x + stiffening * x**3) + 2 * damping * omega * v
            v += step * (omega**2 * force - pull)
            x += step * v
    b, a, _ = cont2discrete(([omega**2], [1, 2 * damping * omega, omega**2]), 1.0)
    return single(u, np.array(y) + white(rng, N)), [[(b[0], a)]]


noisy = partial(open_loop, excite=held)
swept = partial(open_loop, excite=partial(held, samples=10), N=400)
CURVED = {
    "three trials saturate": saturating,
    "quadratic": partial(noisy, N=400, bent=lambda u: u + 0.2 * u**2),
    "gain drifts by 20 %": partial(noisy, N=400, drift=0.2),
    "a loop without its reference": regulated,
    "cubic, 1 %": partial(noisy, N=2000, bent=lambda u: u + 0.01 * u**3),
    "gain drifts by 4 %": partial(noisy, N=2000, drift=0.04),
    "a spring that stiffens": spring,
    "an integrator": partial(noisy, N=600, make=integrator),
    "backlash": partial(swept, bent=partial(backlash, gap=0.3)),
    "dead zone": partial(swept, bent=partial(dead, zone=0.6)),
}
KINDS = {
    "steps": open_loop,
    "noise, coloured noise": partial(noisy, noise=coloured),
    "steps, drift": partial(open_loop, noise=drifting),
    "steps, wrong start": partial(open_loop, start=1.0),
    "steps, short": partial(open_loop, N=40),
    "resonance, noise": partial(noisy, make=resonance),
    "a reference moves": reference,
    "two channels": two,
    "learning": learned,
    "learning, 2 trials": partial(learned, trials=2),
    "learning, starts differ": partial(learned, start=0.3),
    "learning, delay of 30": partial(learned, delay=30, N=200),
    "learning, converged": partial(learned, trials=24, last=4),
    "learning, slow": partial(learned, trials=4, N=800, make=slow),
    "four modes": flexible,
    "feedback, coloured noise": feedback,
    "slow, 10,000 samples": partial(
        open_loop, make=slow, excite=partial(held, samples=300), N=10_000
    ),
    "fast and slow": partial(
        open_loop, make=fast_and_slow, excite=partial(held, samples=60), N=800
    ),
    "fast, less a slow part": partial(
        open_loop, make=undershooting, excite=partial(held, samples=20), N=800
    ),
    "a long delay, noise": partial(noisy, make=late, N=2000),
    "a long delay, steps": partial(open_loop, make=late, N=2000),
    "three lengths": of_three_lengths,
    "known disturbances": disturbed,
    **CURVED,
    "outputs with a common noise": partial(two, common=0.8),
    "CD arm": partial(flexible, make=partial(modes, damped=0.02), noise=0.1),
    "a weak mode": partial(flexible, N=1200, make=weak_mode, noise=0.1),
}


def response(plants, omega):
    """Of plants as numerators and denominators of 1/z, (n, m, m)."""
    rows = [[freqz(b, a, omega)[1] for b, a in row] for row in plants]
    return np.moveaxis(np.array(rows), 2, 0)


RESONANT = ("resonance, noise", "four modes", "CD arm")
DESIGN = {"order": 20, "M_max": 0.9, "L_max": 100.0}  # for the resonant kinds


def designed(P, plants):
    """Whether there is a filter for all of the region, and whether it keeps M_max on the truth."""
    low = P.omega[P.known][0]
    if low >= 0.3:
        return False, False
    omega, Q = np.geomspace(low, np.pi, 400), zero_phase_butterworth(2, 0.3, 1.0)
    try:
        L = synthesise(P, Q, omega, band=(low, 0.3), **DESIGN).filter
    except InfeasibleError:
        return False, False
    return True, convergence(response(plants, omega), Q, L, omega).rate <= DESIGN["M_max"]


def judged(kind, seed):
    """What an estimate from one record says, and how far it is right, by column of the table."""
    log, plants, *of = KINDS[kind](np.random.default_rng([seed, len(kind)]))
    began = time.process_time()
    try:
        P = measured_response(log, *of)
    except LogError as refused:
        warned = "one linear plant" in str(refused)
        return {"refused": True, "warned": warned, "missed in silence": False}
    seconds, truth = time.process_time() - began, response(plants, P.omega)
    off, sizes = np.linalg.norm([P.response - truth, truth], 2, axis=(2, 3))
    most, all_ = (np.all(off <= P.radius(share, jointly=True)) for share in (0.9, 0.99))
    result = {
        "known": P.known.mean(),
        "radius": np.median(P.radius(0.95)[P.known]) / sizes.max(),
        "CPU (s)": seconds,
        "refused": False,
        "warned": bool(P.findings),
        "missed in silence": not (all_ or P.findings),
    }
    if kind not in CURVED:
        each = np.mean(off <= P.radius(0.95))
        result |= {"each, 95 %": each, "all, 90 %": most, "all, 99 %": all_}
    if kind in RESONANT:
        result["feasible"], result["kept"] = designed(P, plants)
    return result


def counted(kind):
    """The row of the table for a kind of record."""
    with warnings.catch_warnings(action="ignore"):
        rows = pd.DataFrame([judged(kind, seed) for seed in range(RECORDS)], dtype=float)
    cells = [
        format(rows[column].agg(how), form) if column in rows else ""
        for column, (how, form) in COLUMNS.items()
    ]
    filters = f"{rows.feasible.sum():g}, {rows.kept.sum():g}" if kind in RESONANT else ""
    return [kind, f"{RECORDS}", *cells, filters]


COLUMNS = {  # of the records, and how it is printed
    **dict.fromkeys(["each, 95 %", "all, 90 %", "all, 99 %"], ("mean", ".1%")),
    "known": ("mean", ".0%"),
    **dict.fromkeys(["radius", "CPU (s)"], ("median", ".2g")),
    **dict.fromkeys(["refused", "warned", "missed in silence"], ("sum", "g")),
}
TITLES = ["record", "records", *COLUMNS, "filters: feasible, keep 0.9"]


if __name__ == "__main__":
    publish("regions", table(TITLES, list(run(counted, KINDS))))
