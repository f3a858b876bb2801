"""Trials of a loop without a model are judged by the P that the law was designed for."""

import warnings

import control
import numpy as np
import pytest
from plants import RestartingModel, altered

from ilctools import (
    ClosedLoop,
    Law,
    measured_response,
    record,
    replay,
    rms,
    run_trials,
    synthesise,
    transfer,
    zero_phase_butterworth,
)
from ilctools.trials.diagnosis import GRID, known_plants, largest_M

PLANT = control.ss(control.tf([400], [1, 20, 400])).sample(0.01)
LOOP = ClosedLoop(Ts=0.01, outputs=["x"], units={"x": "mm"})
REFERENCE = 20 * np.sin(np.pi * np.clip(np.arange(-50, 350) / 250, 0, 1)) ** 4
RADIUS = 0.1  # of sigma_max(Delta), where P(0) = 1


def axis(gain=1.0, seed=0):
    return RestartingModel(control.ss(gain * PLANT, inputs=["w1"]), noise=0.002, seed=seed)


@pytest.fixture(scope="module")
def law():
    omega = np.geomspace(0.04, np.pi / 0.01, 200)
    table = control.frd(PLANT(np.exp(0.01j * omega)), omega)
    P = measured_response(table, uncertainty=np.full(200, RADIUS))
    return synthesise(P, zero_phase_butterworth(2, 40.0, 0.01), omega).law()


@pytest.mark.parametrize("gain", [0.4, 1.8])
def test_a_plant_outside_the_radius_is_noticed_by_trial_4(law, gain):
    with pytest.warns(UserWarning, match="after trial [34]: the convergence rate"):
        log = record(axis(gain), LOOP, law, REFERENCE, trials=6)
    assert not replay(log).warnings  # a log has no P


@pytest.mark.parametrize(("gain", "seed"), [(1.0, 0), (0.92, 1), (1.08, 2)])
def test_a_plant_within_the_radius_is_not_warned_of(law, gain, seed):
    with warnings.catch_warnings(action="error"):
        record(axis(gain, seed), LOOP, law, REFERENCE, trials=6)


def test_the_rate_is_that_of_the_worst_plant_within_the_radius(law):
    omega, [P] = GRID / law.Ts, known_plants(law)
    response, radius = P(omega)
    Q, L = (f.frequency_response(omega).ravel() for f in (law.Q, law.L))
    expected = Q * (np.abs(1 - response.ravel() * L) + radius * np.abs(L))
    np.testing.assert_allclose(largest_M(law, P), expected, rtol=1e-9)


@pytest.mark.parametrize("choices", [{"base": None}, {"scale": [1.0, 3.0], "base": 0.1}])
def test_trials_of_a_list_are_judged_by_each_of_its_plants(choices):
    two = control.append(PLANT, PLANT)
    coupled = control.ss(two.A, two.B, [[1, 0.2], [0, 1]] @ two.C, 0, 0.01)
    *plants, other = (altered(coupled, B=gain) for gain in (1.0, 1.5, 0.8, 0.4))
    design = synthesise(plants, zero_phase_butterworth(2, 20.0, 0.01), **choices)
    task = ClosedLoop(plants[0]), design.law(), np.column_stack([REFERENCE, -REFERENCE])
    with warnings.catch_warnings(action="error"):
        for plant in plants:
            run_trials(*task, plant=plant)
    with pytest.warns(UserWarning, match="the convergence rate is not the predicted one"):
        run_trials(*task, plant=other)


@pytest.mark.parametrize("gain", [1.0, 2.5])
def test_what_Q_forgets_of_a_given_v_is_no_divergence(gain):
    """And a law that diverges is warned of after a transfer, too."""
    loop, later = ClosedLoop(PLANT), np.roll(-REFERENCE, 30)
    law = synthesise(loop, zero_phase_butterworth(2, 20.0, 0.01)).law()
    v = transfer(run_trials(loop, law, REFERENCE, trials=6), later).v
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        run = run_trials(loop, law, later, v=v, plant=gain * PLANT)
    size = rms(run).values
    assert size[1] > 1.4 * size[0]
    assert any("the error grows" in str(w.message) for w in seen) == (gain > 2)


def test_trials_that_differ_by_noise_alone_leave_v_uncertain():
    task = ClosedLoop(PLANT), Law(zero_phase_butterworth(2, 20.0, 0.01), None), REFERENCE
    noise = 1e-3 * np.random.default_rng(0).standard_normal((2, 400, 1))
    trials = [run_trials(*task, trials=1, noise=white[None]) for white in noise]
    with pytest.warns(UserWarning, match="may be off by") as seen:
        assert len(repr(transfer(trials, -REFERENCE))) < 200
    assert len(seen) == 1
