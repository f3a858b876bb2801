"""What is known of a rig before its first sample: by names, in places, and once for all."""

from dataclasses import replace

import numpy as np
import pytest
from plants import RestartingModel, boiler, bump

from ilctools import Law, current_trial_loop, zero_phase_butterworth
from ilctools.rigs.description import described

BOILER = current_trial_loop(boiler(), boiler().input_labels[:2])  # pump and heater; rain disturbs
REFERENCE = bump(40, [2.0, 1.0])[None]


def rig_of(*inputs, **attributes):
    rig = RestartingModel(boiler(), inputs)
    vars(rig).update(attributes)
    return rig


def test_signals_stand_where_the_driver_has_them():
    """Commands in the order of the loop, then commanded disturbances; the rest stays zero."""
    inputs = ("spare", "heater", "rain", "pump, left")
    signals = described(rig_of(*inputs), BOILER, REFERENCE).signals
    assert signals.commands == ["pump, left", "heater"] and signals.commanded == ["rain"]
    assert signals.places == [3, 1, 2] and [*signals.inputs] == [*inputs]
    assert signals.controls == [] and signals.measured_as == {}


@pytest.mark.parametrize(
    ("commanded", "measured", "measured_as"),
    [
        ([], {"lamp": 2.0}, {}),
        ([], {"rain": 1.0, "lamp": 2.0}, {"rain": "disturbance"}),
        (["rain"], {}, {}),
        (["rain"], {"rain": 1.0}, {}),  # what is sent is known best
    ],
)
def test_disturbances_are_known_that_are_sent_or_measured(commanded, measured, measured_as):
    rig, known = rig_of(*BOILER.commands, *commanded, measured=measured), [*commanded, *measured_as]
    about, rain = described(rig, BOILER, REFERENCE), np.ones((40, 1))
    assert about.signals.commanded == commanded
    assert about.signals.disturbances == known and about.signals.measured_as == measured_as
    if known:
        assert about.flows_of(rain).shape == (1, 40, len(commanded))
    else:
        with pytest.raises(ValueError, match=r"disturbance is not zero for \['rain'\]"):
            about.flows_of(rain)


def test_what_a_rig_follows_is_stated_for_commands_alone():
    rig = rig_of("lamp", *BOILER.commands, limits={"lamp": (0, 1), "heater": (-2, 3)})
    law = Law(zero_phase_butterworth(2, 0.1, 0.5), None, loop=BOILER)
    reference = np.ones((2, 30, 2))
    about = described(rig, BOILER, reference, law, goes_on=True)
    assert about.limits == about.law.limits == {"heater": (-2.0, 3.0)}
    assert about.actuators.highest.tolist() == [np.inf, 3.0]
    assert (about.trials, about.samples, about.goes_on) == (2, 30, True)
    free = described(rig, BOILER, reference, replace(law, limits={}))
    assert free.limits == about.limits and free.law.limits == {} and free.actuators is None
