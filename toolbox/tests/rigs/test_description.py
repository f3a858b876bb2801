"""What is known of a rig before its first sample: by names, in places, and once for all."""

import numpy as np
import pytest
from plants import LOOPS, RestartingModel, boiler, bump

from ilctools import ClosedLoop, Law, current_trial_loop, record, zero_phase_butterworth
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
    ("inputs", "measured", "commanded", "known", "measured_as"),
    [
        ((), {}, [], [], {}),
        (("rain",), {}, ["rain"], ["rain"], {}),
        ((), {"rain": 1.0, "lamp": 2.0}, [], ["rain"], {"rain": "disturbance"}),
        (("rain",), {"rain": 1.0}, ["rain"], ["rain"], {}),  # what is sent is known best
    ],
)
def test_disturbances_are_known_that_are_sent_or_measured(
    inputs, measured, commanded, known, measured_as
):
    rig = rig_of("pump, left", "heater", *inputs, measured=measured)
    about = described(rig, BOILER, REFERENCE)
    assert about.signals.commanded == commanded
    assert about.signals.disturbances == known and about.signals.measured_as == measured_as
    rain = np.ones((40, 1))
    if known:
        assert about.flows_of(rain).shape == (1, 40, len(commanded))
    else:
        with pytest.raises(ValueError, match=r"disturbance is not zero for \['rain'\]"):
            about.flows_of(rain)


@pytest.mark.parametrize("name", LOOPS)
def test_what_a_rig_follows_is_stated_for_commands_alone(name):
    loop = LOOPS[name]()
    model = loop.P if isinstance(loop, ClosedLoop) else loop.plant
    rig = RestartingModel(model, ["lamp", *loop.commands])
    rig.limits = {"lamp": (0, 1), loop.commands[-1]: (-2, 3)}
    Q = zero_phase_butterworth(2, 0.1 / loop.Ts, loop.Ts)
    reference = np.ones((2, 30, len(loop.outputs)))
    about = described(rig, loop, reference, Law(Q, None, loop=loop), goes_on=True)
    assert about.limits == about.law.limits == {loop.commands[-1]: (-2.0, 3.0)}
    assert about.actuators.highest.max() == np.inf or len(loop.commands) == 1
    assert (about.trials, about.samples, about.goes_on) == (2, 30, True)
    free = described(rig, loop, reference, Law(Q, None, limits={}, loop=loop))
    assert free.limits == about.limits and free.law.limits == {} and free.actuators is None


@pytest.mark.filterwarnings("ignore:.*the reference starts")
def test_a_rig_is_used_again_as_if_it_had_not_been_used():
    """No state of one experiment is left for the next one."""
    rig, law = rig_of("pump, left", "heater"), Law(zero_phase_butterworth(2, 0.1, 0.5), None)
    first, again = (record(rig, BOILER, law, REFERENCE[0], trials=2) for _ in range(2))
    assert first.identical(again)
