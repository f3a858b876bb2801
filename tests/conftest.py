"""What several test files need: the paper's loop, grid and Q-filter."""

import os

import matplotlib
import numpy as np
import pytest
import rounding
from hypothesis import HealthCheck, settings

from rodlib.paper.repository import ROOT

matplotlib.use("agg")
slow = [HealthCheck.too_slow]  # which a machine may be
settings.register_profile(
    "repeatable", derandomize=True, deadline=None, max_examples=10, suppress_health_check=slow
)
settings.load_profile("repeatable")


def pytest_addoption(parser):
    parser.addoption("--rounding", type=int, metavar="SEED", help="vary the rounding, by a seed")


def pytest_configure(config):
    seed = config.getoption("rounding")
    if seed is not None:
        before = os.environ.get("PYTHONPATH", "")
        folder = ROOT / "build" / f"rounding-{seed}"
        os.environ["PYTHONPATH"] = rounding.search_path(folder, seed, before)
        rounding.vary(seed)


@pytest.fixture
def gate(tmp_path):
    """A named pipe: a process that reads it waits until the test has ended, however it ends."""
    path = tmp_path / "gate"
    os.mkfifo(path)
    with open(path, "r+b", buffering=0):
        yield path


@pytest.fixture(scope="session")
def loop():
    from rodlib import paper_loop

    return paper_loop()


@pytest.fixture(scope="session")
def Q():
    from ilctools import zero_phase_butterworth

    return zero_phase_butterworth(2, 0.1, 1.0)


@pytest.fixture(scope="session")
def omega():
    return np.geomspace(1e-4, np.pi, 1000)
