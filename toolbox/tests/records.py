"""Records of plants, and their regression written out: every row of the regressors at once."""

import control
import numpy as np
import xarray as xr
from numpy.polynomial.polynomial import polyadd
from scipy.signal import detrend, lfilter

from ilctools import ClosedLoop
from ilctools.measurement.arx.regressors import Regressors
from ilctools.measurement.arx.trials import Trials, series_of
from ilctools.measurement.excitation import with_excitation
from ilctools.models import frequency_response
from ilctools.signals import dataset
from ilctools.singular_values import largest_singular_values


def held(rng, *shape, samples=3):
    """Noise that is held for some samples, (..., time)."""
    *others, N = shape
    return np.repeat(rng.standard_normal((*others, N // samples + 1)), samples, axis=-1)[..., :N]


def steps(rng, N):
    """A step test: a rest, one up, one down, one back, none of them of the same length."""
    ends = np.cumsum(rng.uniform([0.03, 0.3, 0.25], [0.1, 0.4, 0.35]))
    return np.select([np.arange(N) < end * N for end in ends], [0, 1, -0.5], 0.4)


def backlash(u, gap):
    """What is behind a gap, which begins in its middle (the play operator)."""
    behind, x = np.zeros(len(u)), 0.0
    for t, ahead in enumerate(u):
        behind[t] = x = min(max(x, ahead - gap / 2), ahead + gap / 2)
    return behind


def in_a_loop(plant, controller, r, noise):
    """u and y of u = c / d (r - y), y = b / a u + noise, polynomials of 1 / z."""
    (b, a), (c, d) = plant, controller
    characteristic = polyadd(np.convolve(a, d), np.convolve(b, c))
    u = lfilter(np.convolve(c, a), characteristic, r - noise)
    return u, lfilter(b, a, u) + noise


def pair(natural, damping):
    """The denominator of a resonance."""
    pole = np.exp(natural * (-damping + 1j * np.sqrt(1 - damping**2)))
    return np.poly([pole, pole.conj()]).real


def resonant(natural, damping):
    """A resonance of gain one behind a delay of a sample: numerator and denominator."""
    a = pair(natural, damping)
    return np.array([0, a.sum() / 2, a.sum() / 2]), a


def dead(u, zone):
    """Nothing as long as |u| is less than half the zone, from there on as much less."""
    return u - np.clip(u, -zone / 2, zone / 2)


def log_of(u, y, Ts=1.0, d=()):
    """One trial from commands (input, time) and known disturbances to outputs (output, time)."""
    variables, coordinates = {}, {"trial": [1], "time": Ts * np.arange(y.shape[1])}
    roles = ("control", "input", "u", u), ("output", "channel", "y", y)
    for role, dimension, name, rows in (*roles, ("source", "source", "disturbance", d)):
        if len(rows):
            variables[name] = ("trial", "time", dimension), np.transpose(rows)[None]
            coordinates[role] = dimension, [f"{name[0]}{i}" for i in range(len(rows))]
            coordinates[f"{role}_unit"] = dimension, [""] * len(rows)
    return xr.Dataset(variables, coordinates, {"Ts": Ts})


SHAKEN = ClosedLoop(Ts=1.0, outputs=["y"])


def shaken(plant, plan, rng, bent=np.array, noise=0.003):
    """A log of an excited plant behind a curve, experiment after experiment from rest."""
    w = plan.signals
    y = lfilter(*plant, bent(w), axis=1) + noise * rng.standard_normal(w.shape)
    log = dataset(1.0, ["y"], [], [], {"y": ""}, y=y, reference=0 * w, v=w)
    return with_excitation(log, plan, SHAKEN, {})


def gain_of(bent, plans):
    """The gain of the best linear approximation of a curve, over the phases of many plans."""
    w = np.concatenate([plan.signals[:, : plan.period].ravel() for plan in plans])
    return np.sum(bent(w) * w) / np.sum(w * w)


def answer(plant, u):
    """Outputs of a model to inputs from rest, (channel, time)."""
    return control.forced_response(plant, inputs=u, squeeze=False).outputs


def moved(plant, N, seed=0, noise=0.02, samples=3):
    """A log of a model under noise that is held, from rest."""
    rng = np.random.default_rng(seed)
    u = held(rng, plant.ninputs, N, samples=samples)
    y = answer(plant, u)
    y = y + noise * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    return log_of(u, y, plant.dt)


def error(estimate, plant):
    return largest_singular_values(estimate.response - frequency_response(plant, estimate.omega))


def covers(estimate, plant):
    """Whether the joint region of 99 % has the truth in it."""
    return np.all(error(estimate, plant) <= estimate.radius(0.99, jointly=True) + 1e-9)


def trials_of(trials, N=60, m=2, noise=0.1, seed=0):
    """A group of trials of a lag to each of m inputs."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((trials, N, m))
    y = sum(lfilter([0, j + 1.0], [1, -0.6], u[..., j]) for j in range(m))
    y = y + noise * rng.standard_normal((trials, N))
    return Trials(u=u, y=y[..., None], names=tuple(f"trial {k}" for k in range(trials)))


def group_of(y, *u, known=0):
    """Trials from inputs to one output, (trial, time) each, all relative to the first sample."""
    y, *u = (x - x[:, :1] for x in (y, *u))
    return Trials(np.stack(u, 2), y[..., None], tuple(f"trial {k}" for k in range(len(y))), known)


def dense(groups, layout):
    """[X, y], without offset and slope, and which rows are of means."""
    rows, means = [], []
    for series in series_of(groups):
        columns = np.vstack([Regressors(series, layout).rows(), series.y]).T
        rows.append(detrend(columns[layout.skipped :], axis=0))
        means += [series.is_mean] * len(rows[-1])
    return np.concatenate(rows), np.array(means)
