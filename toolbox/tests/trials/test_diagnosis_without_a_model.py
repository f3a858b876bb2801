"""Trials of a loop without a model are judged by the P that the law was designed for."""

import re
import warnings

import control
import numpy as np
import pytest
from plants import RestartingModel

from ilctools import (
    ClosedLoop,
    Law,
    NormOptimal,
    load_law,
    measured_response,
    record,
    replay,
    rms,
    run_trials,
    save_law,
    synthesise,
    transfer,
    zero_phase_butterworth,
)
from ilctools.trials.diagnosis import GRID, diagnose, known_plants, largest_M

PLANT = control.ss(control.tf([400], [1, 20, 400])).sample(0.01)
LOOP = ClosedLoop(Ts=0.01, outputs=["x"], units={"x": "mm"})
REFERENCE = 20 * np.sin(np.pi * np.clip(np.arange(-50, 350) / 250, 0, 1)) ** 4
RADIUS = 0.1  # of sigma_max(Delta), where P(0) = 1
CUTOFF = zero_phase_butterworth(2, 40.0, 0.01)
LOW = zero_phase_butterworth(2, 20.0, 0.01)
OMEGA = np.geomspace(0.04, np.pi / 0.01, 200)


def table_of(plant):
    """Its response (frequency, output, input) on OMEGA."""
    return np.moveaxis(plant(np.exp(0.01j * OMEGA), squeeze=False), -1, 0)


def axis(gain=1.0, plant=PLANT, noise=0.002):
    return RestartingModel(control.ss(gain * plant, inputs=["w1"]), noise=noise)


@pytest.fixture(scope="module")
def law():
    P = measured_response(control.frd(PLANT, OMEGA), uncertainty=np.full(200, RADIUS))
    return synthesise(P, CUTOFF, OMEGA).law()


@pytest.mark.parametrize("gain", [0.4, 0.92, 1.08, 1.8])
def test_a_plant_outside_the_radius_is_noticed_by_trial_4_and_no_other(law, gain):
    with warnings.catch_warnings(record=True, action="always") as seen:
        log = record(axis(gain), LOOP, law, REFERENCE, trials=6)
    said = [str(w.message)[:42] for w in seen]
    if abs(gain - 1) < RADIUS:
        assert not said
    else:
        assert re.match("after trial [34]: the convergence rate", said[0])
    assert not replay(log).warnings  # a log has no P


def test_the_rate_is_that_of_the_worst_plant_within_the_radius(law):
    omega, [P] = GRID / law.Ts, known_plants(law)
    response, radius = P(omega)
    Q, L = (f.frequency_response(omega).ravel() for f in (law.Q, law.L))
    expected = Q * (np.abs(1 - response.ravel() * L) + radius * np.abs(L))
    np.testing.assert_allclose(largest_M(law, P), expected, rtol=1e-9)


def coupled(gain=1.0):
    """Two axes that move each other."""
    two = control.append(PLANT, 0.5 * PLANT)
    return control.ss(two.A, gain * two.B, [[1, 0.4], [0.3, 1]] @ two.C, 0, 0.01)


@pytest.mark.parametrize("choices", [{"base": None}, {"scale": [1.0, 3.0], "base": 0.1}])
def test_trials_of_a_list_are_judged_by_each_of_its_plants(choices):
    plants = [coupled(gain) for gain in (1.0, 1.5, 0.8)]
    design = synthesise(plants, LOW, **choices)
    task = ClosedLoop(plants[0]), design.law(), np.column_stack([REFERENCE, -REFERENCE])
    with warnings.catch_warnings(action="error"):
        for plant in plants:
            run_trials(*task, plant=plant, trials=6)
    with pytest.warns(UserWarning, match="the convergence rate is not the predicted one"):
        run_trials(*task, plant=coupled(0.4), trials=6)


@pytest.mark.parametrize("gain", [1.0, 2.5])
def test_what_Q_forgets_of_a_given_v_is_no_divergence(gain):
    """And a law that diverges is warned of after a transfer, too."""
    loop, later = ClosedLoop(PLANT), np.roll(-REFERENCE, 30)
    law = synthesise(loop, LOW).law()
    v = transfer(run_trials(loop, law, REFERENCE, trials=6), later).v
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        run = run_trials(loop, law, later, v=v, plant=gain * PLANT)
    size = rms(run).values
    assert size[1] > 1.4 * size[0]
    assert any("the error grows" in str(w.message) for w in seen) == (gain > 2)


def test_trials_that_differ_by_noise_alone_leave_v_uncertain():
    task = ClosedLoop(PLANT), Law(LOW, None), REFERENCE
    noise = 1e-3 * np.random.default_rng(0).standard_normal((2, 400, 1))
    trials = [run_trials(*task, trials=1, noise=white[None]) for white in noise]
    with pytest.warns(UserWarning, match="may be off by") as seen:
        assert len(repr(transfer(trials, -REFERENCE))) < 200
    assert len(seen) == 1


def of_file(law, tmp_path):
    """The law, saved and read, by which it forgets the plants of its design."""
    save_law(tmp_path / "law.json", law)
    return load_law(tmp_path / "law.json")


LAWS = {
    "filter": lambda path: synthesise(PLANT, CUTOFF, order=20).law(),
    "table": lambda path: synthesise(table_of(PLANT), CUTOFF, OMEGA, 0.01).law(),
    "file": lambda path: of_file(synthesise(PLANT, CUTOFF).law(), path),
    "norm-optimal": lambda path: Law(CUTOFF, NormOptimal(PLANT, 0.01, len(REFERENCE))),
}


@pytest.fixture(params=[*LAWS])
def law_alone(request, tmp_path):
    """A law that has a P, by any way to it, for a loop that has none."""
    return LAWS[request.param](tmp_path)


def test_an_output_in_another_unit_than_the_reference_is_noticed(law_alone):
    """The reference in mm, y in m: learning would take hundreds of trials."""
    with pytest.warns(UserWarning, match="is a signal in another unit") as seen:
        record(axis(1e-3), LOOP, law_alone, REFERENCE, trials=4)
    [text] = [str(w.message) for w in seen]  # once, though trial 4 shows it, too
    assert seen[0].filename == __file__
    assert text.startswith("after trial 3: the convergence rate") and "even if P is wrong" in text
    came = float(re.search(r"of the changes that this predicts, (\S+) in x came", text)[1])
    assert came == pytest.approx(1e-3, rel=0.05)  # two digits, and noise


@pytest.mark.parametrize(("stuck", "reset"), [(0.0, True), (-40.0, False)])
def test_an_output_that_does_not_move_is_named_after_the_first_trial(stuck, reset):
    """Once, though it never moves in any trial; the other output, which does, is not named."""
    two = control.append(PLANT, PLANT)
    law = synthesise(two, CUTOFF, reach=None if reset else 50).law()
    loop = ClosedLoop(Ts=0.01, outputs=["x", "y"], units={"x": "mm", "y": "mm"})
    rig = RestartingModel(control.ss(two, inputs=loop.inputs), noise=0.002)
    outputs = rig.read
    rig.read = lambda: [outputs()[0], stuck]
    task = rig, loop, law, np.column_stack([REFERENCE, REFERENCE]) + 5.0
    with warnings.catch_warnings(record=True, action="always") as seen:
        record(*task, trials=3, reset=reset, stop={"y": None})
    [text] = [str(w.message) for w in seen if "did not move" in str(w.message)]
    moves = np.ptp(control.forced_response(PLANT, inputs=REFERENCE).outputs)
    assert text.startswith("after trial 1: y did not move in trial 1, where the model predicts")
    assert float(re.search(r"movement of (\S+):", text)[1]) == pytest.approx(moves, rel=0.01)
    assert not any("not the predicted one" in str(w.message) for w in seen)


def test_an_output_that_stands_still_as_its_reference_does_is_not_dead():
    """As a sensor with steps of a millimetre, where v moves the plant by less."""
    law, rig = synthesise(PLANT, CUTOFF).law(), axis()
    rig.read = lambda: [5.0]
    with warnings.catch_warnings(action="ignore"):
        log = record(rig, LOOP, law, np.full(400, 5.05), trials=3)
    assert log.v.values.any() and "dead" not in diagnose(log, law.bound_to(LOOP), first=1)


@pytest.mark.parametrize(("gain", "omega"), [(0.75, 20), (1, 26)])
def test_a_plant_that_is_wrong_by_a_quarter_and_converges_is_no_news(law_alone, gain, omega):
    """In its gain, or slower or faster than the model, whose omega is 20 rad/s."""
    plant = control.ss(control.tf([omega**2], [1, omega, omega**2])).sample(0.01)
    with warnings.catch_warnings(action="error"):
        run = record(axis(gain, plant, noise=0.01), LOOP, law_alone, REFERENCE, trials=6)
    assert rms(run).values[-1] < 0.1 * rms(run).values[0]


@pytest.mark.parametrize("gains", [[1.0], [1.0, 1.2]])
def test_a_plant_is_judged_by_the_mean_model_in_a_law_that_was_read(tmp_path, gains):
    """In the outputs' own units; not by that of a diagonal filter, which knows no coupling."""
    design = synthesise([coupled(gain) for gain in gains], LOW, scale=[1.0, 7.0])
    [P] = known_plants(of_file(design.law(), tmp_path))
    response, radius = P(OMEGA)
    expected = np.mean([table_of(coupled(gain)) for gain in gains], axis=0)
    np.testing.assert_allclose(response, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert not radius.any()
    diagonal = synthesise(coupled(), LOW, structure="diagonal")
    assert len(known_plants(diagonal.law())) == 1
    assert not known_plants(of_file(diagonal.law(), tmp_path))
