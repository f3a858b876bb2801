"""What a message names can be imported."""

import importlib
import pkgutil

import pytest

import ilctools
from ilctools import errors


def test_every_exception_of_the_toolbox_is_in_one_place():
    for module in pkgutil.walk_packages(ilctools.__path__, "ilctools."):
        for name, thing in vars(importlib.import_module(module.name)).items():
            ours = isinstance(thing, type) and thing.__module__.startswith("ilctools")
            if ours and issubclass(thing, Exception) and name.endswith("Error"):
                assert thing.__module__ == "ilctools.errors" and {"errors"} < {*dir(ilctools)} == {
                    *ilctools.__all__
                }
    assert errors.InfeasibleError is ilctools.InfeasibleError


def test_a_rig_that_is_none_is_refused_by_a_name_that_is_a_door():
    loop = ilctools.ClosedLoop(Ts=1.0, outputs=["y"])
    law = ilctools.Law(ilctools.zero_phase_butterworth(2, 0.1, 1.0), None)
    with pytest.raises(ValueError, match="must be a Rig"):
        ilctools.record(3, loop, law, [[0.0]] * 70)
    assert hasattr(ilctools.Rig, "read") and hasattr(ilctools.Rig, "apply")
