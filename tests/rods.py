"""Rods of any material, and one with the modes of its series as states."""

import control
import numpy as np
from hypothesis import strategies as st

from ilctools import LearningFilter
from rodlib import Rod
from rodlib.paper import published
from rodlib.rigs import RestartingRig, RigParameters
from rodlib.rod import labelled
from rodlib.rod import modes as modes_of

PRINTED = LearningFilter(published.matrix("L_diagonal"), 1.0)  # the paper's diagonal one
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


class Failing(RestartingRig):
    """Goes wrong in one sample, counted from 0: it shows a list, or an error comes."""

    def __init__(self, sample=np.inf, shown=None):
        super().__init__(parameters=RigParameters(modes=10))
        self.sample, self.shown, self.commands = sample, shown, []

    def read(self):
        self.sample -= 1
        if self.sample != -1:
            return super().read()
        if isinstance(self.shown, list):
            return self.shown
        raise self.shown

    def apply(self, heat_flows):
        self.commands.append(np.array(heat_flows))
        super().apply(heat_flows)


def readings_of(rig, commands):
    """What a rig shows before each command."""
    readings = []
    for command in commands:
        readings.append(rig.read())
        rig.apply(command)
    return np.array(readings)


def modal_model(specimen, Ts, modes=250):
    """The rod behind a hold with so many modes, whose elements have gains."""
    s, B, C = modes_of(specimen.rod, np.arange(modes))
    model = labelled(specimen.rod, np.diag(s), B * [*specimen.gains, 1], C)
    return control.sample_system(model, Ts, "zoh")
