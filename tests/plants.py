"""Plants that are not the rod, with names and units of their own."""

import control
import numpy as np


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
    pumps, levels = ["pump A", "pump B", "pump C"], ["left", "middle", "right"]
    model = control.ss(A, B, np.eye(3), 0, inputs=["leak", *pumps], outputs=levels)
    return control.sample_system(model, Ts, method="zoh")


def furnace(samples=30, Ts=1.0):
    """A valve, a first-order lag, and a pipe that takes `samples` more to the thermometer."""
    numerator, denominator = [0.2], np.append([1.0, -0.95], np.zeros(samples))
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
