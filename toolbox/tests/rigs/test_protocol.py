"""What is a rig: two methods are enough, and one is not."""

from types import SimpleNamespace

import pytest
from plants import TASK, Axis

from ilctools import Rig, record


def test_a_rig_is_what_reads_and_applies_and_nothing_else():
    assert isinstance(Axis(), Rig)
    for driver in (SimpleNamespace(read=list), SimpleNamespace(apply=list), None, Axis):
        with pytest.raises(ValueError, match="rig = "):
            record(driver, **TASK)
