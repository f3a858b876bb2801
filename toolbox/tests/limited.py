"""Random tasks with limits of outputs, each with plants that are wrong within the radius."""

from typing import NamedTuple

import control
import numpy as np
from plants import bump

from ilctools import ClosedLoop, frequency_response, synthesise, zero_phase_butterworth
from ilctools.errors import InfeasibleError


class Task(NamedTuple):
    """A loop with its law, what it is asked, and the plants on which it is tried."""

    loop: ClosedLoop
    plain: object  # the law without limits of outputs
    law: object
    reference: np.ndarray
    noise: np.ndarray  # of each output, at most
    truths: list


def task(seed: int, p: int, m: int, errors: int = 3) -> Task | None:
    """One with p outputs and m inputs; None where no filter converges within its radius."""
    rng = np.random.default_rng([seed, p, m])
    P, radius = plant(rng, p, m), rng.uniform(0.02, 0.3)
    outputs, inputs = P.output_labels, P.input_labels
    one_for_one = {} if p == m else {"references": {}, "learned": inputs}
    units = rng.choice([1.0, 1e-3, 40.0], p)  # one output in mm, another in kN
    of_inputs = units if p == m else np.ones(m)
    loop = ClosedLoop(in_units(P, units, of_inputs), **one_for_one)
    scale = dict(zip(outputs, units, strict=True))
    Q = zero_phase_butterworth(2, rng.uniform(0.3, 1.0), 1.0)
    try:
        design = synthesise(loop, Q, uncertainty=radius, scale=scale)
    except InfeasibleError:
        return None
    if design.rate >= 1:
        return None
    samples = int(rng.integers(120, 250))
    r = bump(samples, rng.uniform(0.5, 1.5, p)) * units
    noise = rng.choice([0.0, 1e-3]) * units
    above = r.max(axis=0) * (1 + rng.uniform(0.001, 0.05, p)) + 2 * noise
    limits = {}
    for name, high, r_i, n in zip(outputs, above, r.T, noise, strict=True):
        low = -0.1 * high
        if rng.random() < 0.3:  # a limit that changes with time
            high = np.minimum(high * rng.uniform(1, 1.5, samples), r_i + 0.2 * high) + 2 * n
        limits[name] = rng.choice([-np.inf, low]), high
    options = {"rest": int(rng.choice([0, 12])), "gain": rng.choice([1.0, 1.0, 0.4])}
    if rng.random() < 0.3:
        widest = 3 * np.abs(r).max() if p == m else 30.0
        options["limits"] = {inputs[0]: (-widest, widest)}
    law = design.law(
        **options | {"limits": options.get("limits", {}) | limits},
        noise=dict(zip(outputs, noise, strict=True)),
    )
    response = design.problem.response
    truths = []
    for k in range(errors):
        wrong = P + error(rng, k, P, response.omega, response.radius)
        wrong.update_names(inputs=inputs, outputs=outputs)
        truths.append(in_units(wrong, units, of_inputs))
    return Task(loop, design.law(**options), law, r, noise, truths)


def plant(rng, p, m):
    """Stable, with a gain of about one at rest."""
    n = 2 * max(p, m)
    A = np.diag(rng.uniform(0.5, 0.97, n))
    if rng.random() < 0.4:  # a resonance
        size, angle = rng.uniform(0.8, 0.95), rng.uniform(0.1, 0.5)
        A[:2, :2] = size * turn(angle)
    B, C = rng.normal(size=(n, m)), rng.normal(size=(p, n))
    at_rest = C @ np.linalg.solve(np.eye(n) - A, B)
    if np.linalg.cond(at_rest) > 20:
        return plant(rng, p, m)
    B = B @ np.linalg.inv(at_rest) if p == m else B / np.linalg.norm(at_rest, 2)
    names = {"inputs": [f"w{j}" for j in range(m)], "outputs": [f"T{i}" for i in range(p)]}
    return control.ss(A, B, C, 0, 1.0, **names)


def turn(angle):
    """A rotation of the plane."""
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def in_units(P, outputs, inputs):
    """A model with the units of its outputs so many times smaller, and of its inputs."""
    model = np.diag(outputs) * P * np.diag(1 / inputs)
    model.update_names(inputs=P.input_labels, outputs=P.output_labels)
    return model


def error(rng, kind, P, omega, radius):
    """A stable Delta that meets the radius somewhere: of P's own dynamics, or of rank one."""
    p, m = P.noutputs, P.ninputs
    if kind == 0:
        Delta = rng.normal(size=(p, p)) * P
    else:
        u, v = rng.normal(size=(p, 1)), rng.normal(size=(1, m))
        size, angle = rng.uniform(0.3, 0.97), rng.choice([0.0, rng.uniform(0.05, 1.5)])
        B, C = np.vstack([v, 0 * v]), np.hstack([u, 0 * u])
        Delta = control.ss(size * turn(angle), B, C, rng.choice([0.0, 1.0]) * u @ v, 1.0)
    gain = np.linalg.norm(frequency_response(Delta, omega), 2, axis=(1, 2))
    return rng.choice([-1.0, 1.0]) * np.min(radius / gain) * Delta
