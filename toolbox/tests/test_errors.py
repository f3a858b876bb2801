"""Exceptions of the toolbox have one home."""

import importlib
import pkgutil

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
