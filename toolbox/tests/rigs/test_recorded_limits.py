"""Experiments within the limits of a rig: what is sent, said, recorded, gone on with, replayed."""

import warnings
from dataclasses import replace

import control
import numpy as np
import pytest
from plants import LOOPS, PUMPS, RestartingModel, axes, bump

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    load_log,
    measured_response,
    multisine,
    record,
    run_trials,
    save_log,
    shake,
    zero_phase_butterworth,
)
from ilctools.logs.replay import replay
from ilctools.measurement.record import Record

CASES = {  # loop, cut-off, heights, limits
    "stage": (LOOPS["stage"](), 300.0, [2.0], {"F": (-6.0, 4.0)}),
    "tanks": (LOOPS["tanks"](), 0.4, [3.0, 2.0, 4.0], dict.fromkeys(PUMPS, (-10.0, 25.0))),
    "axes": (ClosedLoop(axes()), 3.0, [2.0, -1.0], {"set x": (-1.0, 1.5)}),
}


def experiment(case):
    """A rig that says what it follows, its loop, a law without limits, and a reference."""
    loop, cutoff, heights, limits = CASES[case]
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    L = LearningFilter(0.3 * np.eye(len(heights))[..., None], loop.Ts)
    rig = RestartingModel(loop.P if isinstance(loop, ClosedLoop) else loop.plant, loop.commands)
    rig.limits = limits
    return rig, loop, Law(Q, L), bump(80, heights)


pytestmark = pytest.mark.filterwarnings("ignore:.*commands were beyond")


@pytest.mark.parametrize("case", CASES)
def test_within_limits_rig_simulation_log_and_replay_agree(case, tmp_path):
    """Sample by sample with the Controller, and from the matrices of the loop."""
    rig, loop, law, reference = experiment(case)
    path, limited = tmp_path / "log.csv", replace(law, limits=rig.limits)
    with pytest.warns(UserWarning, match="after trial 1: .* learned within") as seen:
        record(rig, loop, law, reference, trials=2, path=path)
    assert len(seen) == 1 and seen[0].filename == __file__
    log = record(rig, loop, law, reference, trials=4, path=path)
    run = run_trials(loop, limited, reference, trials=4)
    for name in log.data_vars:
        size = np.abs(run["u" if name == "delta" else name]).max() + 1e-9
        np.testing.assert_allclose(log[name], run[name], atol=2e-5 * size)
    commands = log.u if "u" in log else log.reference + log.v
    sent, actuators = np.array(rig.sent)[-80:], limited.bound_to(loop).actuators
    assert actuators.can(sent) and not actuators.can(commands.values[0])

    log = load_log(path)
    moves = Record.of(log)  # for an estimate of P: w is what asks for what was applied
    for w, y in zip(moves.groups[0].u, moves.groups[0].y * moves.sizes.outputs, strict=True):
        answer = control.forced_response(loop.P, inputs=(w * moves.sizes.inputs).T, squeeze=False)
        np.testing.assert_allclose(answer.outputs.T, y, atol=1e-4 * np.abs(y).max())
    replayed = replay(log)
    assert "the recorded v is that of the law in every trial" in repr(replayed)
    assert not replayed.warnings and not replayed.omissions
    assert replayed.fit.to_numpy().min() > 1 - 1e-6  # from what was applied
    save_log(log.assign(v=log.v * 1.01), path)
    assert "v departs from the law" in replay(load_log(path)).agreement


def test_without_limits_of_the_law_the_rig_cuts_off_and_it_is_said_of_each_trial(tmp_path):
    rig, loop, law, reference = experiment("tanks")
    free, rig.limit = replace(law, limits={}), 2.0
    rig.limits = dict.fromkeys(PUMPS, (-2.0, 2.0))
    path = tmp_path / "log.csv"
    with pytest.warns(UserWarning, match="beyond the limits of pump A") as seen:
        log = record(rig, loop, free, reference, trials=2, path=path)
    assert len(seen) == 2 and "applied" not in log and "actuators" not in load_log(path).attrs
    with pytest.raises(ValueError, match="see its actuators"):
        record(rig, loop, law, reference, path=path)
    narrow = {"pump A": (-1.0, 1.0)}  # the rig's own stand for the others
    log = record(rig, loop, replace(law, limits=narrow), reference, trials=1)
    low, high = np.transpose([(rig.limits | narrow)[name] for name in loop.commands])
    np.testing.assert_array_equal(log.applied, np.clip(log.u, low, high))
    np.testing.assert_array_equal(log.applied[0], rig.sent[-len(reference) :])
    cut_off = (log.u != log.applied).any(("trial", "time"))
    assert cut_off.values.all()  # at a limit of the law, and at one of the rig
    rig.limits = {"fan": (0, 1)}
    with pytest.raises(ValueError, match=r"rig\.limits is about"):
        record(rig, loop, law, reference)


@pytest.mark.parametrize("case", CASES)
def test_a_measurement_beyond_limits_is_warned_of(case):
    rig, loop, *_ = experiment(case)
    excitation = multisine(loop, 0.1 / loop.Ts, 1.0 / loop.Ts, 1.0, 0.4 * loop.Ts, lines=8)
    largest = np.abs(loop.asked(shake(rig, loop, excitation)).values).max()
    for share in (1.01, 0.7):
        rig.limit = share * largest
        rig.limits = dict.fromkeys(loop.commands, (-rig.limit, rig.limit))
        with warnings.catch_warnings(action="error" if share > 1 else "ignore"):
            log = shake(rig, loop, excitation)
        with warnings.catch_warnings(action="ignore"):  # findings, too
            measured = measured_response(log)
        assert bool(measured.findings) == (share < 1)
