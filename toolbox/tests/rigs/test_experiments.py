"""Experiments on rigs: as simulated, by names, within limits, and refused before they begin."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import control
import numpy as np
import pytest
import xarray as xr
from plants import LOOPS, PUMPS, ModelRig, RestartingModel, axes, boiler, bump

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    current_trial_loop,
    load_log,
    measured_response,
    multisine,
    record,
    replay,
    run_trials,
    shake,
    zero_phase_butterworth,
)
from ilctools.measurement.record import Record

pytestmark = pytest.mark.filterwarnings("ignore:.*commands were beyond")
BOILER = current_trial_loop(boiler(), boiler().input_labels[:2])


@pytest.mark.filterwarnings("ignore:.*the reference starts")
def test_a_rig_that_is_the_loops_plant_gives_the_simulation_by_names(tmp_path):
    """Each trial with a reference of its own; the third goes on from the log of two."""
    plant, path = boiler(), tmp_path / "log.csv"
    units = {"pump, left": "l/min", "heater": "W", "depth": "mm", "heat": "degC"}
    loop = current_trial_loop(plant, plant.input_labels[:2], units=units)
    law = Law(
        zero_phase_butterworth(2, 0.1, 0.5), LearningFilter(np.ones((2, 2, 4)) / 3, 0.5), 4, 0.3
    )
    rng = np.random.default_rng(0)
    reference, rain = rng.standard_normal((3, 40, 2)), rng.standard_normal((3, 40, 1))
    device = RestartingModel(plant, ("spare", "heater", "rain", "pump, left"))
    for k in (2, 3):
        task = reference[:k], rain[:k], k
        log = record(device, loop, law, *task, path=path, stop={"depth": None})
    run = run_trials(loop, law, reference, rain, 3)
    xr.testing.assert_allclose(log, run, atol=1e-9)
    assert log.attrs["Ts"] == 0.5 and device.ends == 2
    for name in run.data_vars:
        assert log[name].attrs == run[name].attrs
    assert not np.any(np.array(device.sent)[:, 0])


Q10 = zero_phase_butterworth(2, 0.1, 0.5)
REFUSED = [  # what is wrong, and what the error says
    ({"rig": SimpleNamespace(read=len, apply=len, Ts=2.0)}, "rig.Ts = 2.0"),
    (
        {"loop": current_trial_loop(control.ss(0.5, 1, 1, 0, 0.5))} | {"reference": np.zeros(10)},
        "rig.inputs",
    ),
    ({"law": Law(Q10, None, 10)}, "rest = 10"),
    ({"decimals": {"z": 3}}, "decimals has the keys"),
    ({"decimals": {"u": 0.5}}, "decimals.*u.* = 0.5"),
    ({"stop": {"z": (0, 1)}}, "stop has the keys"),
    ({"stop": {"heat": (1, 0)}}, "stop.*lower limit first"),
    ({"path": "nowhere/log.csv"}, "path = .*nowhere.log.csv"),
]


@pytest.mark.parametrize(("changes", "message"), REFUSED)
def test_an_experiment_that_cannot_work_is_not_begun(changes, message):
    rig = ModelRig(boiler())
    valid = {"rig": rig, "loop": BOILER, "law": Law(Q10, None), "trials": 2}
    signals = {"reference": np.zeros((10, 2)), "disturbance": np.zeros((2, 10, 1))}
    with pytest.raises(ValueError, match=message):
        record(**valid | signals | changes)
    assert not rig.sent


LIMITED = [  # loop, cut-off, heights, limits
    (LOOPS["stage"](), 300.0, [2.0], {"F": (-6.0, 4.0)}),
    (LOOPS["tanks"](), 0.4, [3.0, 2.0, 4.0], dict.fromkeys(PUMPS, (-10.0, 25.0))),
    (ClosedLoop(axes()), 3.0, [2.0, -1.0], {"set x": (-1.0, 1.5)}),
]


def experiment(loop, cutoff, heights, limits):
    """A rig that says what it follows, its loop, a law without limits, and a reference."""
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    L = LearningFilter(0.3 * np.eye(len(heights))[..., None], loop.Ts)
    rig = RestartingModel(loop.P if isinstance(loop, ClosedLoop) else loop.plant, loop.commands)
    rig.limits = limits
    return rig, loop, Law(Q, L), bump(80, heights)


@pytest.mark.parametrize("case", LIMITED, ids=["stage", "tanks", "axes"])
def test_within_limits_rig_simulation_log_and_replay_agree(case, tmp_path):
    """Sample by sample with the Controller, and from the matrices of the loop."""
    rig, loop, law, reference = experiment(*case)
    path, limited = tmp_path / "log.csv", replace(law, limits=rig.limits)
    with pytest.warns(UserWarning, match="after trial 1: .* learns v within") as seen:
        record(rig, loop, law, reference, trials=2, path=path)
    assert len(seen) == 1 and seen[0].filename == __file__
    log = record(rig, loop, law, reference, trials=4, path=path)
    run = run_trials(loop, limited, reference, trials=4)
    for name in log.data_vars:
        size = np.abs(run["u" if name == "delta" else name]).max() + 1e-9
        np.testing.assert_allclose(log[name], run[name], atol=2e-5 * size)
    log = load_log(path)
    moves = Record.of(log)  # for an estimate of P: w is what asks for what was applied
    for w, y in zip(moves.groups[0].u, moves.groups[0].y * moves.sizes.outputs, strict=True):
        answer = control.forced_response(loop.P, inputs=(w * moves.sizes.inputs).T, squeeze=False)
        np.testing.assert_allclose(answer.outputs.T, y, atol=1e-4 * np.abs(y).max())
    replayed = replay(log)
    assert "the recorded v agrees with the law in every trial" in repr(replayed)
    assert not replayed.warnings and not replayed.omissions
    assert replayed.fit.to_numpy().min() > 1 - 1e-6  # from what was applied


def test_without_limits_of_the_law_the_rig_cuts_off_and_it_is_said_of_each_trial(tmp_path):
    rig, loop, law, reference = experiment(*LIMITED[1])
    free, rig.limit = replace(law, limits={}), 2.0
    rig.limits = dict.fromkeys(PUMPS, (-2.0, 2.0))
    path = tmp_path / "log.csv"
    with pytest.warns(UserWarning, match="limits of pump A.*the law does not know") as seen:
        log = record(rig, loop, free, reference, trials=2, path=path)
    assert len(seen) == 2 and "applied" not in log and "actuators" not in load_log(path).attrs
    rig.limits = {"fan": (0, 1)}
    with pytest.raises(ValueError, match=r"rig\.limits has the keys"):
        record(rig, loop, law, reference)


def test_a_measurement_beyond_limits_is_warned_of():
    rig, loop, *_ = experiment(*LIMITED[0])
    excitation = multisine(loop, 0.1 / loop.Ts, 1.0 / loop.Ts, 1.0, 0.4 * loop.Ts, lines=8)
    largest = np.abs(np.asarray(loop.asked(shake(rig, loop, excitation)))).max()
    for share in (1.01, 0.7):
        rig.limit = share * largest
        rig.limits = dict.fromkeys(loop.commands, (-rig.limit, rig.limit))
        with warnings.catch_warnings(action="error" if share > 1 else "ignore"):
            log = shake(rig, loop, excitation)
        with warnings.catch_warnings(action="ignore"):  # findings, too
            measured = measured_response(log)
        assert bool(measured.findings) == (share < 1)
