"""Rods of any material, and one with the modes of its series as states."""

import control
import numpy as np
from hypothesis import strategies as st

from rodlib import Rod, exact_response

MATERIALS = st.builds(
    Rod,
    length=st.floats(0.05, 2),
    width=st.floats(0.01, 0.1),
    height=st.floats(0.005, 0.05),
    density=st.floats(500, 20000),
    heat_capacity=st.floats(100, 4000),
    heat_transfer=st.floats(1, 500),
    conductivity=st.floats(1, 400),
    sections=st.integers(1, 6),
    sensors=st.just((0.03, 0.05)),
)


# of notebook 11
BRASS = Rod(
    length=0.6,
    density=8500.0,
    heat_capacity=380.0,
    conductivity=120.0,
    sections=6,
    sensors=(0.15, 0.35, 0.55),
)


def readings_of(rig, commands):
    """What a rig shows before each command."""
    readings = []
    for command in commands:
        readings.append(rig.read())
        rig.apply(command)
    return np.array(readings)


def modal_model(specimen, Ts, modes=250):
    """The rod behind a hold with so many modes, the others as gains that act within a sample."""
    rod = specimen.rod
    n = np.arange(modes)
    rate = rod.kappa_2 + rod.conductivity * (n * np.pi / rod.length) ** 2
    p = np.exp(-rate * Ts / rod.kappa_1)
    middles = (np.arange(rod.sections) + 0.5) / rod.sections
    shown = np.cos(np.outer(rod.sensors, n * np.pi / rod.length))
    r = np.zeros((modes, rod.sections + 1))
    r[:, :-1] = np.cos(np.outer(n * np.pi, middles)) * np.sinc(n / 2 / rod.sections)[:, None]
    r[:, :-1] *= (np.where(n, 2, 1) / (rod.width * rod.height * rod.length * rate))[:, None]
    r[0, -1] = 1
    gains = np.append(specimen.gains, 1)
    left = exact_response(rod, 0.0)[0].real - shown @ r
    m = len(rod.sensors)
    A = np.diag(np.append(p, np.zeros(m)))
    B = np.vstack([(1 - p)[:, None] * r, left]) * gains
    C = np.hstack([shown, np.eye(m)])
    return control.ss(A, B, C, 0, Ts, inputs=rod.inputs, outputs=rod.outputs)
