"""What several test files need: the paper's loop, grid and Q-filter."""

import matplotlib
import numpy as np
import pytest
from hypothesis import settings

from rodlib import paper_loop, zero_phase_butterworth

matplotlib.use("agg")
settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=25)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def loop():
    return paper_loop()


@pytest.fixture(scope="session")
def Q():
    return zero_phase_butterworth()


@pytest.fixture(scope="session")
def omega():
    return np.geomspace(1e-4, np.pi, 1000)
