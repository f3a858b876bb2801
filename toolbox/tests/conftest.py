"""What several test files need: the loop that the method was published for."""

import pytest
from repeatable import Q, omega  # noqa: F401


@pytest.fixture(scope="session")
def loop():
    from paper import paper_loop

    return paper_loop()
