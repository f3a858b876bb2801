"""Trials that go wrong are warned of; trials that converge are not."""

import re
import warnings
from dataclasses import replace
from functools import cache

import control
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import PUMPS, RestartingModel, altered, bump, furnace, tanks
from scipy.signal import lfilter
from scipy.stats import f as f_distribution

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    NormOptimal,
    current_trial_loop,
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
from ilctools.signals import TRIAL_AXES
from ilctools.trials.diagnosis import (
    chance,
    chance_of_excess,
    diagnose,
    error_grows,
    known_plants,
    unexplained,
)
from ilctools.trials.rms import rms_by_octave, rms_of

OMEGAS = np.geomspace(1e-4, np.pi, 200)


def white(seed, *shape):
    return np.random.default_rng(seed).standard_normal(shape)


def observed(run, *task, **more):
    """Trials, and the texts of their warnings."""
    with warnings.catch_warnings(record=True, action="always") as seen:
        trials = run(*task, **more)
    return trials, [str(w.message) for w in seen]


def law_of(loop, cutoff, order):
    Q, band = zero_phase_butterworth(2, cutoff, loop.Ts), (1e-4, cutoff / 3)
    return synthesise(loop, Q, OMEGAS / loop.Ts, order=order, band=band).law().bound_to(loop)


@cache
def furnace_law(cutoff):
    """The law of a furnace whose pipe holds 20 samples, bound to its loop."""
    return law_of(current_trial_loop(furnace(20), None, {"valve": 0.1}), cutoff, 30)


@pytest.fixture
def free():
    """The loop of a furnace by its P alone, a law that is bound to none, and a reference."""
    law = furnace_law(0.05)
    loop = ClosedLoop(law.loop.P)
    return loop, Law(law.Q, law.L), bump(600, [10.0])


@pytest.fixture(scope="module")
def tank_law():
    return law_of(current_trial_loop(tanks(), PUMPS), 0.02, 10)


LEVELS = [10.0, 5.0, 8.0]


@pytest.fixture(scope="module")
def cases(tank_law):
    """Laws that converge, the size of a reference, and plants for which they do."""
    slow, fast = (LearningFilter(gain * np.eye(3)[..., None], 2.0) for gain in (0.02, 0.3))
    laws = tank_law, *(Law(tank_law.Q, L, loop=tank_law.loop) for L in (slow, fast))
    plants = [None, furnace(20, gain=1.1), furnace(21, gain=0.9)]
    of_furnace = ((furnace_law(cutoff), [10.0], plants) for cutoff in (0.05, 0.2))
    return [*((law, LEVELS, [None]) for law in laws), *of_furnace]


@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1))
def test_ordinary_trials_are_not_warned_of(cases, seed):
    """Converging, with noise, white or not, and disturbances that repeat or do not."""
    rng = np.random.default_rng(seed)
    law, amplitude, plants = cases[rng.integers(len(cases))]
    law = replace(law, gain=rng.choice([1.0, 0.5, 0.2]))
    samples, trials, m = rng.integers(150, 900), rng.integers(4, 16), len(amplitude)
    pole, d = rng.choice([0, 0.5, 0.9, 0.98]), len(law.loop.disturbances)
    noise = rng.standard_normal((trials, samples + 200, m))
    noise = lfilter([1 - pole], [1, -pole], noise, axis=1)[:, 200:]
    noise *= 10 ** rng.uniform(-4, -0.3) * max(amplitude)
    push = rng.standard_normal((rng.choice([1, trials]), 1, d))
    push = 10 ** rng.uniform(-2, 0.5) * push * bump(samples, np.ones(d))
    push = np.broadcast_to(push, (trials, samples, d))
    plant = plants[rng.integers(len(plants))]
    with warnings.catch_warnings():
        if plant is not None:  # where it is right
            warnings.filterwarnings("ignore", "the convergence rate")
        reference = bump(samples, amplitude)
        run_trials(law.loop, law, reference, push, trials, noise=noise, plant=plant)


def test_the_probability_of_growth_by_chance_is_that_of_counting():
    x = np.sqrt(np.mean(white(0, 200000, 4, 6) ** 2, axis=2))
    increasing = (np.diff(x) > 0).all(axis=1)
    for ratio in (1.5, 3.0):
        seen = np.mean(increasing & (x[:, -1] >= ratio * x[:, 0]))
        assert 0.3 * chance(ratio, 6, 4) < seen < 1.1 * chance(ratio, 6, 4)
    assert chance(2.0, 6, 2) == pytest.approx(f_distribution.sf(4.0, 6, 6))
    assert chance(1e200, 6, 2) < 1e-100


def test_the_probability_of_an_excess_is_that_of_counting():
    """Of noise whose variance is estimated where a gain and a phase were fitted."""
    noise, predicted = white(0, 3000, 3, 15, 1), white(1, 1, 15, 1).repeat(3, axis=0)
    F, n = [], np.array([8.0])  # values in the octave from harmonic 4 on
    for changes in noise:
        _, size, freedom = unexplained(changes[:2] + 5 * predicted[:2], predicted[:2])
        F.append(rms_by_octave(changes[2])[2] ** 2 / size[2])
        assert freedom[2] <= n
    for f in (1.5, 4.0):
        p = chance_of_excess(np.sqrt([f]), 1.0, n, 2)
        assert np.mean(f < np.array(F)) == pytest.approx(p.item(), rel=0.15)
        two = chance_of_excess(np.sqrt([f, f]), 1.0, n, 2)  # octaves
        np.testing.assert_allclose(two, 2 * np.append(p, p))


def test_other_references_and_noise_alone_are_no_growth(cases, free):
    """Noise alone: the error rises to the level of the noise that was learned."""
    law, amplitude, _ = cases[2]
    growing = [bump(200, a * np.array(amplitude)) for a in (0.1, 0.3, 1.0, 3.0, 9.0)]
    run_trials(law.loop, law, np.array(growing), trials=5)
    # of a delay, where sigma_max(M) = 0.9 makes much of noise, but no more than it must
    law = Law(zero_phase_butterworth(2, 3.0, 1.0), LearningFilter([[[1.9]]], 1.0))
    delay = ClosedLoop(control.ss(0, 1, 1, 0, 1.0)), law
    for task, trials, least in (free[:2], 12, 1), (delay, 5, 3):
        noise = white(trials % 12, trials, 900, 1)
        size = rms(run_trials(*task, 0 * noise[0], trials=trials, noise=noise).e).values
        assert least < size[-1] / size[0] < 5


@pytest.mark.parametrize(("gain", "moved"), [(2.0, "2"), (0.3, "0.3")])
def test_another_gain_of_P_is_noticed_in_trial_3(gain, moved, free):
    """After one of another task, which does not count. Of twice the gain e changes its sign."""
    plant, noise = gain * free[0].P, 0.02 * white(1, 4, 600, 1)
    tasks = np.outer([0.1, 1, 1, 1], free[2])[..., None]
    with pytest.warns(
        UserWarning, match=f"trial 4 has .* trial [23],.* outlet changed by {moved} "
    ):
        run_trials(*free[:2], tasks, None, 4, plant=plant, noise=noise)
    run_trials(*free, trials=2, plant=plant)  # in the first two the noise is not known


def test_an_error_that_creeps_away_from_the_best_is_noticed(free):
    """By 2 % in each trial, where P has the wrong sign: too little to show from the one before."""
    loop, law, reference = free
    case = loop, replace(law, gain=0.02), reference, None, 6
    noise = 0.02 * white(1, 6, 600, 1)
    with pytest.warns(UserWarning, match=r"rate .*trial 3 has 1\.\d+ .* of trial 1,"):
        run = run_trials(*case, plant=-loop.P, noise=noise)
    assert np.all(np.diff(rms(run.e).values) < 0.03 * rms(run.e).values[0])
    run_trials(*case, plant=loop.P, noise=noise)


def test_a_disturbance_that_grows_by_as_much_in_each_trial_is_no_other_plant(free):
    """Trials after the best one it is as many times as large as from one to the next."""
    loop, law, reference = free
    noise = 0.1 * np.arange(8)[:, None, None] * white(2, 600, 1) + 0.02 * white(1, 8, 600, 1)
    run = run_trials(loop, replace(law, gain=0.02), reference, None, 8, noise=noise, plant=loop.P)
    size = rms(run.e).values
    assert size.argmin() == 2 and size[-1] > 1.05 * size.min()


def test_slow_convergence_is_noticed(tank_law):
    """Nothing else would show that the pump on the right is weak."""
    model, noise = tanks(), 0.02 * white(3, 9, 600, 3)
    weak = altered(model, B=[1, 1, 1, 0.3])
    case = tank_law.loop, tank_law, bump(600, LEVELS), None, 9
    run, [text] = observed(run_trials, *case, plant=weak, noise=noise)
    assert re.search(r"rate .* up to 0\.0.* right changed by", text)
    assert rms(run.e).values[-1] < 0.1 * rms(run.e).values[0]
    noise[1] += bump(600, [2.0, 1.0, 0.0])  # a new disturbance, and later another
    noise[5] -= bump(600, [1.0, 2.0, 1.0])
    run_trials(*case, plant=model, noise=noise)


# Of a loop without a model trials are judged by the P that the law was designed for.

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


@pytest.mark.parametrize("gain", [0.4, 0.92, 1.08, 1.8])
def test_a_plant_outside_the_radius_is_noticed_by_trial_4_and_no_other(gain):
    P = measured_response(control.frd(PLANT, OMEGA), uncertainty=np.full(200, RADIUS))
    law = synthesise(P, CUTOFF, OMEGA).law()
    log, texts = observed(record, axis(gain), LOOP, law, REFERENCE, trials=6)
    noticed = [re.match("after trial [34]: the convergence rate", text) for text in texts]
    assert any(noticed) == bool(texts) == (abs(gain - 1) > RADIUS)
    assert not replay(log).warnings  # a log has no P


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
    run, texts = observed(run_trials, loop, law, later, v=v, plant=gain * PLANT)
    size = rms(run).values
    assert size[1] > 1.4 * size[0]
    assert any("the error grows" in text for text in texts) == (gain > 2)


def of_file(law, tmp_path):
    """The law, saved and read, by which it forgets the plants of its design."""
    save_law(tmp_path / "law.json", law)
    return load_law(tmp_path / "law.json")


@pytest.fixture(params=["filter", "table", "file", "norm-optimal"])
def law_alone(request, tmp_path):
    """A law that has a P, by any way to it, for a loop that has none."""
    match request.param:
        case "filter":
            return synthesise(PLANT, CUTOFF, order=20).law()
        case "table":
            return synthesise(table_of(PLANT), CUTOFF, OMEGA, 0.01).law()
        case "file":
            return of_file(synthesise(PLANT, CUTOFF).law(), tmp_path)
        case "norm-optimal":
            return Law(CUTOFF, NormOptimal(PLANT, 0.01, len(REFERENCE)))


def test_an_output_in_another_unit_than_the_reference_is_noticed(law_alone):
    """The reference in mm, y in m: learning would take hundreds of trials."""
    with pytest.warns(UserWarning, match="Is a signal in another unit") as seen:
        record(axis(1e-3), LOOP, law_alone, REFERENCE, trials=4)
    [text] = [str(w.message) for w in seen]  # once, though trial 4 shows it, too
    assert seen[0].filename == __file__
    assert text.startswith("after trial 3: the convergence rate") and "even if P is wrong" in text
    came = float(re.search(r"x changed by (\S+) times the change", text)[1])
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
    _, texts = observed(record, *task, trials=3, reset=reset, stop={"y": None})
    [text] = [text for text in texts if "did not move" in text]
    moves = np.ptp(control.forced_response(PLANT, inputs=REFERENCE).outputs)
    assert text.startswith("after trial 1: y did not move in trial 1, where the model predicts")
    assert float(re.search(r"movement of (\S+):", text)[1]) == pytest.approx(moves, rel=0.01)
    assert not any("not the predicted one" in text for text in texts)


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


@pytest.mark.parametrize("broad", [True, False])
def test_a_jump_of_few_degrees_of_freedom_may_be_chance(broad):
    """Of a slow sine, four times the error is no evidence; of many harmonics, it is."""
    sine = np.sin(2 * np.pi * np.arange(400) / 400)
    error = lfilter([1.0], [1.0, -0.9], white(0, 400)) if broad else sine
    e = np.array([1.0, 4.0])[:, None, None] * error[:, None]
    signals = {name: (TRIAL_AXES, 0 * e) for name in ("reference", "forgotten", "learned")}
    trials = xr.Dataset({"e": (TRIAL_AXES, e), **signals}, {"trial": [1, 2]})
    assert bool(error_grows(trials.assign(rms=rms_of(trials.e)))) == broad
