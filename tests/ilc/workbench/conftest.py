"""What is tested of the workbench does not depend on how many frequencies there are: take few."""

import pytest

from rodlib.ilc.workbench import settings


@pytest.fixture(
    scope="module", autouse=True
)  # "package" would last until the session ends
def few_frequencies():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(settings, "FREQUENCIES", 60)
        yield
