"""What several test files need: the paper's loop, grid and Q-filter."""

import os

import pytest
import rounding
from repeatable import Q, omega  # noqa: F401

from rodlib.paper.repository import ROOT


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
