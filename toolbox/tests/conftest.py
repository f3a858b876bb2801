"""What several test files need: the loop that the method was published for, its grid and Q."""

import matplotlib
import pytest
from hypothesis import HealthCheck, settings
from paper import paper_grid, paper_loop

from ilctools import zero_phase_butterworth

matplotlib.use("agg")
slow = [HealthCheck.too_slow]  # which a machine may be
settings.register_profile(
    "repeatable", derandomize=True, deadline=None, max_examples=10, suppress_health_check=slow
)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def loop():
    return paper_loop()


@pytest.fixture(scope="session")
def Q():
    return zero_phase_butterworth(2, 0.1, 1.0)


@pytest.fixture(scope="session")
def omega():
    return paper_grid()
