"""What is tested of the workbench does not depend on how many frequencies there are: take few."""

import plants
import pytest

from ilctools import current_trial_loop
from rodlib.workbench import settings
from rodlib.workbench.plant import Plant


@pytest.fixture(scope="session")
def stage():
    sizes, units = {"x": 1.0, "F": 3.0}, {"x": "mm"}
    return Plant("", current_trial_loop(plants.stage(), ["F"], sizes, units))


@pytest.fixture(scope="module", autouse=True)  # "package" would last until the session ends
def few_frequencies():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(settings, "FREQUENCIES", 60)
        yield
