"""Rods of any material, and a rig that fails."""

import numpy as np
from hypothesis import strategies as st

from ilctools import LearningFilter
from rodlib import Rod
from rodlib.paper import published
from rodlib.rigs import RestartingRig, RigParameters

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
    """Shows something else in one sample, counted from 0."""

    def __init__(self, sample=np.inf, shown=None):
        super().__init__(parameters=RigParameters(modes=10))
        self.sample, self.shown = sample, shown

    def read(self):
        self.sample -= 1
        return self.shown if self.sample == -1 else super().read()


def readings_of(rig, commands):
    """What a rig shows before each command."""
    readings = []
    for command in commands:
        readings.append(rig.read())
        rig.apply(command)
    return np.array(readings)
