"""What several test files need: the paper's loop, grid and Q-filter."""

import os

import pytest
from matplotlib import rcParams
from repeatable import Q, omega  # noqa: F401


@pytest.fixture(scope="module", autouse=True)
def style_restored():
    """A file of tests that leaves the notebooks' style behind spoils the pictures of others."""
    before = rcParams["figure.figsize"]
    yield
    assert rcParams["figure.figsize"] == before


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
