"""Tests are the same in every run; what several test files need in both packages."""

import matplotlib
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

matplotlib.use("agg")
slow = [HealthCheck.too_slow]  # which a machine may be
settings.register_profile(
    "repeatable", derandomize=True, deadline=None, max_examples=10, suppress_health_check=slow
)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def Q():
    from ilctools import zero_phase_butterworth

    return zero_phase_butterworth(2, 0.1, 1.0)


@pytest.fixture(scope="session")
def omega():
    return np.geomspace(1e-4, np.pi, 1000)
