"""Plants as models, loops and rigs, and what tests ask of them."""

import control
import numpy as np

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    current_trial_loop,
    frequency_response,
    zero_phase_butterworth,
)
from ilctools.models import impulse_response

PUMPS = ["pump A", "pump B", "pump C"]
LEVELS = ["left", "middle", "right"]


_S = control.tf("s")
STAGE_WITH_MODES = control.sample_system(  # lightly damped, behind a loop of 100 rad/s
    control.ss(1e4 / (_S**2 + 120 * _S + 1e4) * (0.9 + 0.1 * 4e4 / (_S**2 + 4 * _S + 4e4))), 1e-3
)


def lag(pole=0.9, gain=1.0, Ts=1.0):
    """Of first order, with this gain at rest."""
    return control.ss(pole, gain * (1 - pole), 1, 0, Ts)


def lags(gain=1.0, pole=0.9):
    """Two lags with coupling."""
    A = [[pole, 0.05], [0.02, pole - 0.1]]
    return control.ss(A, gain * np.diag([0.1, 0.2]), np.eye(2), 0, 1.0)


def copies(count):
    """One axis with as many gains."""
    axis = control.ss(control.sample_system(control.tf([400], [1, 20, 400]), 0.01))
    return [axis * (1 + k / 400) for k in range(count)]


def others(count, seed=0):
    """Axes with poles of their own."""
    random, plants = np.random.default_rng(seed), []
    for _ in range(count):
        corner, damping = 20 * random.uniform(0.8, 1.25), random.uniform(0.35, 0.65)
        plant = control.tf([corner**2], [1, 2 * damping * corner, corner**2])
        plants.append(control.ss(control.sample_system(plant, 0.01)))
    return plants


def coupled(count):
    """Two channels, each plant with poles and gains of its own."""
    random = np.random.default_rng(1)
    return [lags(random.uniform(0.9, 1.1), random.uniform(0.85, 0.93)) for _ in range(count)]


def sigma_of_M(omega, P, Q, L):
    """sigma_max(Q (I - P L)) by the book; each a model, a filter, or samples on omega."""
    P, Q, L = (
        X if isinstance(X, np.ndarray)
        else frequency_response(X, omega) if isinstance(X, control.LTI)
        else X.frequency_response(omega)
        for X in (P, Q, L)
    )  # fmt: skip
    return np.linalg.norm(Q[:, None, None] * (np.eye(L.shape[-1]) - P @ L), 2, axis=(-2, -1))


def stage(length=1e-3, force=1.0, Ts=1e-3):
    """A motion stage of 2 kg with viscous friction; `length` is a unit in m, `force` one in N."""
    mass, damping = 2.0, 8.0  # kg, N s/m
    A = [[0.0, 1.0], [0.0, -damping / mass]]
    B = np.array([[0.0, 0.0], [1.0, -1.0]]) / mass * force / length
    model = control.ss(A, B, [[1.0, 0.0]], 0, inputs=["F", "friction"], outputs=["x"])
    return control.sample_system(model, Ts, method="zoh")


def tanks(Ts=2.0):
    """Three tanks in a row, each with a pump; levels in cm, flows in ml/s, a leak in the second."""
    area, pipe, outlet = 150.0, 12.0, 6.0  # cm2, cm2/s, cm2/s
    exchange = np.array([[-1.0, 1.0, 0.0], [1.0, -2.0, 1.0], [0.0, 1.0, -1.0]])
    A = (pipe * exchange - np.diag([0.0, 0.0, outlet])) / area
    B = np.array([[0.0, 1.0, 0, 0], [-1.0, 0, 1.0, 0], [0.0, 0, 0, 1.0]]) / area
    model = control.ss(A, B, np.eye(3), 0, inputs=["leak", *PUMPS], outputs=LEVELS)
    return control.sample_system(model, Ts, method="zoh")


def furnace(samples=30, Ts=1.0, gain=1.0):
    """A valve, a first-order lag, and a pipe that takes `samples` more to the thermometer."""
    numerator, denominator = [0.2 * gain], np.append([1.0, -0.95], np.zeros(samples))
    return control.tf(numerator, denominator, Ts, inputs=["valve"], outputs=["outlet"])


def random_plant(rng, n=4, m=2):
    """Two controls u1, u2 and a disturbance, which has feedthrough."""
    A = rng.standard_normal((n, n))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    D = np.hstack([np.zeros((m, m)), rng.standard_normal((m, 1))])
    return control.ss(
        A, rng.standard_normal((n, m + 1)), rng.standard_normal((m, n)), D, 1.0,
        inputs=["u1", "u2", "d"],
    )  # fmt: skip


def random_response(seed, m, n=24, gain=1.0, grid=np.linspace):
    """A stable plant with coupling, and a low-pass Q, on n frequencies up to Nyquist.

    Where a decade is coarse for L, bounds on it are added between; on a line none are.
    """
    rng = np.random.default_rng(seed)
    omega = grid(1e-2, np.pi, n)
    z = np.exp(1j * omega)[:, None, None]
    poles = rng.uniform(0.3, 0.95, (m, m))
    P = np.eye(m) + 0.2 * rng.standard_normal((m, m))
    P = gain * P * (1 - poles) / (z - poles)
    return P, 1 / (1 + (omega / 0.5) ** 4), omega


LOOPS = {  # with one output, three, and a delay
    "stage": lambda: current_trial_loop(stage(), ["F"], sizes={"x": 1.0, "F": 3.0}),
    "tanks": lambda: current_trial_loop(tanks(), PUMPS),
    "furnace": lambda: current_trial_loop(furnace(12)),
}


def boiler():
    """A pump and a heater, coupled, and rain."""
    A, B = [[0.9, 0.05], [0.0, 0.8]], [[0.1, 0.0, 0.02], [0.0, 0.3, 0.0]]
    names = {"inputs": ["pump, left", "heater", "rain"], "outputs": ["depth", "heat"]}
    return control.ss(A, B, np.eye(2), 0, 0.5, **names)


def axes():
    """Two axes under PIDs of their own, from w to y; P(0) is not I."""
    A, B, C = [[0.8, 0.1], [0.0, 0.7]], np.diag([0.5, 0.9]), [[1.0, 0.2], [0.1, 1.0]]
    return control.ss(A, B, C, 0, 0.1, inputs=["set x", "set y"], outputs=["x", "y"])


def altered(model, A=1.0, B=1.0):
    """The same model, with A and the columns of B and D times these factors."""
    names = {"inputs": model.input_labels, "outputs": model.output_labels}
    return control.ss(A * model.A, B * model.B, model.C, B * model.D, model.dt, **names)


def bump(samples, amplitude):
    """From rest to an amplitude and back, shape (time, channel)."""
    return np.outer(np.sin(np.pi * np.arange(samples) / samples) ** 2, amplitude)


def lifted(model, samples):
    """The matrix of a whole trial, from the impulse response of a model."""
    h, (p, m) = impulse_response(model, samples), (model.noutputs, model.ninputs)
    matrix = np.zeros((samples, p, samples, m))
    for k in range(samples):
        matrix[k:, :, k] = h[: samples - k]
    return matrix.reshape(samples * p, samples * m)


def as_matrix(apply, samples, channels):
    """Matrix of a linear map of signals, column by column."""
    units = np.eye(samples * channels).reshape(-1, samples, channels)
    return apply(units).reshape(len(units), -1).T


def frequencies(Ts, n=60):
    """Up to the Nyquist frequency, rad/s."""
    return np.geomspace(1e-4, 0.99, n) * np.pi / Ts


def random_stable(seed, n=4, m=2, distance=0.1, scale=1.0, Ts=0.5):
    """With feedthrough; its largest pole at a distance from the unit circle."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= (1 - distance) / np.abs(np.linalg.eigvals(A)).max()
    B, C, D = (rng.standard_normal(shape) for shape in ((n, m), (m, n), (m, m)))
    return control.ss(A, scale * B, C, scale * D, Ts)


def complex_normal(rng, *shape):
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


class ModelRig:
    """A sampled model as a rig, noisy, with actuators reversed."""

    def __init__(self, model, inputs=None, *, signs=1.0, noise=0.0):
        self.model, self.inputs, self.signs = model, inputs or model.input_labels, signs
        self.random, self.noise = np.random.default_rng(0), noise
        self.x = np.zeros(model.nstates)
        self.sent, self.ends = [], 0

    def read(self):
        noise = self.noise * self.random.standard_normal(self.model.noutputs)
        return self.model.C @ self.x + noise

    def apply(self, commands):
        self.sent.append(np.array(commands))
        effect = dict(zip(self.inputs, self.signs * self.sent[-1], strict=True))
        u = np.array([effect.get(name, 0.0) for name in self.model.input_labels])
        self.x = self.model.A @ self.x + self.model.B @ u

    def safe(self):
        self.ends += 1


class RestartingModel(ModelRig):
    """The same, every trial from rest."""

    def begin(self, trial):
        self.x = np.zeros(self.model.nstates)


class Axis:
    """Follows slowly; with whatever else a rig may have."""

    def __init__(self, **more):
        self.x = 0.0  # mm
        vars(self).update(more)

    def read(self):
        return [self.x]

    def apply(self, w):
        self.x += 0.2 * (w[0] - self.x)


class HomedAxis(Axis):
    """The same, every trial from zero."""

    def begin(self, trial):
        self.x = 0.0


TASK = {  # of an axis, as `record` takes it
    "loop": ClosedLoop(Ts=0.01, outputs=["x"], units={"x": "mm"}),
    "law": Law(zero_phase_butterworth(2, 60.0, 0.01), LearningFilter([[[0.5]]], 0.01)),
    "reference": bump(200, [1.0]),
}
