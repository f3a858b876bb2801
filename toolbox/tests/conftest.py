"""What several test files need: the loop that the method was published for."""

import pytest
from paper import paper_loop
from repeatable import Q, omega  # noqa: F401


@pytest.fixture(scope="session")
def loop():
    return paper_loop()
