"""What went wrong in silence, or with a raw error: each is said where the fact is known."""

import pickle
import re
import warnings

import control
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from plants import LOOPS, RestartingModel, bump, random_stable, sigma_of_M, tanks

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    frequency_response,
    measured_response,
    multisine,
    record,
    replay,
    rms,
    run_trials,
    save_law,
    shake,
    state_sequence,
    synthesise,
    trial_norm,
    zero_phase_butterworth,
)
from ilctools.law.notes import loop_note
from ilctools.problem.defaults import lead
from ilctools.problem.pose import pose

TS = 1e-3
MODEL = control.ss(control.sample_system(control.tf([1e4], [1, 40, 1e4]), TS))
Q = zero_phase_butterworth(2, 60.0, TS)
OMEGA = np.geomspace(1, np.pi / TS, 300)
P = frequency_response(MODEL, OMEGA)
LAG = control.ss(0.5, 0.5, 1, 0, 1.0, inputs=["w"], outputs=["x"])
LOOP, TANKS = ClosedLoop(LAG), LOOPS["tanks"]()
LAW = Law(zero_phase_butterworth(2, 0.3, 1.0), LearningFilter([[[0.3]]], 1.0))


@pytest.mark.parametrize("wrong", [P.conj(), np.abs(P)], ids=["exp(-j omega t)", "without phase"])
def test_a_phase_that_no_stable_plant_has_is_said(wrong):
    with warnings.catch_warnings(action="error"):
        synthesise(P, Q, OMEGA)
    with pytest.warns(UserWarning, match=r"the phase of P leads .* pass P.conj\(\)"):
        synthesise(wrong, Q, OMEGA)


@pytest.mark.parametrize("seed", range(20))
def test_the_phase_of_causal_plants_is_no_finding(seed):
    plant = random_stable(seed, m=1 + seed % 2)
    for low, high in ((1e-3, 1), (1e-2, 0.3)):
        omega = np.geomspace(low, high, 80) * np.pi / plant.dt
        assert lead(frequency_response(plant, omega), omega, plant.dt) < 0.15


@pytest.mark.parametrize(("unit", "factor"), [("Hz", 2 * np.pi), ("rad/sample", 1 / TS)])
@pytest.mark.parametrize(("end", "each"), [(1.0, 1), (1.0, 50), (0.9995, 1), (0.991, 1)])
def test_omega_in_another_unit_is_refused(unit, factor, end, each):
    """Whether the last line is at the Nyquist frequency or just below; in rad/s it is not."""
    with pytest.raises(ValueError, match=f"omega is in {unit}, multiply it by {factor:.6g}$"):
        omega = end * OMEGA[each - 1 :: each]
        synthesise(frequency_response(MODEL, omega), Q, omega / factor)
    for plant in (LAG, *map(random_stable, range(10))):
        omega = np.linspace(0.01, end, 100) * (0.5 / plant.dt if unit == "Hz" else np.pi)
        pose(frequency_response(plant, omega), np.exp(-omega), omega, plant.dt)


def test_one_number_as_uncertainty_is_relative_to_P():
    design = synthesise(P, Q, OMEGA, uncertainty=0.05)
    np.testing.assert_allclose(design.problem.radius, 0.05 * np.abs(P.ravel()), rtol=1e-12)
    assert "the radius is 0.05 sigma_max(P)" in str(design) and str(design).count("\n") == 5


@pytest.mark.parametrize("seed", range(10))
def test_omega_in_Hz_is_refused_of_noisy_samples_too(seed):
    """And a noisy table in rad/s that ends where one in Hz would is none."""
    noise = 0.02 * np.random.default_rng(seed).standard_normal((2, len(P), 1, 1))
    noisy = P * (1 + noise[0] + 1j * noise[1])
    with pytest.raises(ValueError, match="as at the Nyquist frequency: omega is in Hz"):
        synthesise(noisy, Q, OMEGA / (2 * np.pi))
    omega = np.geomspace(1, 0.5 / TS, 300)
    lag = frequency_response(control.ss(0.5, 0.5, 1, 0, TS), omega)
    pose(lag * (1 + noise[0] + 1j * noise[1]), Q, omega)


def test_a_stuck_sensor_makes_no_response():
    class Stuck(RestartingModel):
        def read(self):
            return np.array([0.37])

    shaking = multisine(LOOP, lowest=0.05, highest=2.0, amplitude=1.0, hours=0.3)
    with pytest.raises(ValueError, match=r"^log\.y of x never moved: is it connected"):
        measured_response(shake(Stuck(LAG), LOOP, shaking))


def test_the_error_is_what_reference_and_outputs_say():
    log = run_trials(LOOP, LAW, bump(60, [1.0]), trials=2)
    assert replay(log.assign(e=-log.e)).trials.identical(replay(log).trials)


def test_trials_that_diverge_by_their_ends_alone_are_warned_of():
    """Without a bound on L: a certificate of less than one, of trials without ends."""
    for seed in (3, 8, 17):
        plant = random_stable(seed, n=3, m=1, distance=0.05, Ts=1.0)
        loop = ClosedLoop(control.ss(plant.A, plant.B, plant.C, 0, 1.0))
        design = synthesise(loop, zero_phase_butterworth(2, 0.5, 1.0), L_max=None, base=None)
        assert design.certificate.rate < 1
        law, move = design.law(), bump(200, [1.0])
        with pytest.warns(UserWarning, match=r"the error grows.*trial_norm is below 1") as seen:
            run_trials(loop, law, move, trials=10)
        assert len(seen) == 1 and trial_norm(loop.P, law.Q, law.L, 200)[0] > 1


def test_a_gain_that_passes_its_bound_between_the_frequencies_is_said():
    loop = LOOPS["stage"]()
    design = synthesise(loop, zero_phase_butterworth(2, 60.0, TS), order=40)
    dense = np.linspace(1e-3, np.pi, 20_000) / TS
    largest = np.linalg.norm(design.filter.frequency_response(dense), 2, axis=(1, 2)).max()
    assert largest > 1.01 * design.problem.L_max
    assert f"L_max = {design.problem.L_max:g} ({largest:.3g} between the freq" in str(design)


def test_the_mean_over_the_band_is_that_of_many_frequencies():
    """Of thirty frequencies on a line; the sum itself stays that over them."""
    omega = np.linspace(1e-3, 1, 30) * np.pi / 2.0
    choices = {"base": None, "band": (omega[0], 0.3)}
    design = synthesise(TANKS, zero_phase_butterworth(2, 0.15, 2.0), omega, **choices)
    dense = np.geomspace(omega[0], 0.3, 2001)
    sigma, u = sigma_of_M(dense, TANKS, design.Q, design.filter), np.log(dense)
    mean = np.trapezoid(sigma, u) / (u[-1] - u[0])
    assert design.certificate.mean_M == pytest.approx(mean, abs=5e-5)
    assert f"over the band: {mean:.4f}," in design.certificate.details


def test_units_that_differ_are_a_hint_to_scale():
    A, C = np.diag([0.5, 0.6]), np.array([[1.0, 0.2], [0.3, 1.0]])
    for unit, said in ((1.0, False), (1e3, True)):
        S = np.diag([1.0, unit])
        plant = control.ss(A, np.linalg.inv(S), S @ C, 0, 1.0)
        lag = zero_phase_butterworth(2, 0.1, 1.0)
        hints = [t for t in synthesise(plant, lag).certificate.assumptions if "scale = [1," in t]
        assert bool(hints) == said
        assert not said or 100 < float(re.search(r"\[1, (\S+)\]", hints[0])[1]) < 1e4
        scaled = synthesise(plant, lag, scale=S.diagonal()).certificate.assumptions
        assert not [text for text in scaled if "scale = [" in text]


def test_what_holds_a_model_can_be_sent_to_another_process():
    design = synthesise(LOOP, LAW.Q)
    shaking = multisine(LOOP, lowest=0.05, highest=2.0, amplitude=1.0, hours=0.3)
    rig = RestartingModel(LAG, noise=0.01)
    measured = measured_response(shake(rig, LOOP, shaking))
    for thing in (design, design.law().bound_to(LOOP), LOOP, measured, tanks()):
        other = pickle.loads(pickle.dumps(thing))
        assert repr(other) == repr(thing) and type(other) is type(thing)
    other = pickle.loads(pickle.dumps(tanks()))
    assert other.input_labels == tanks().input_labels and other.dt == 2.0
    np.testing.assert_array_equal(other.A, tanks().A)


def test_designs_are_compared_without_an_error():
    design = synthesise(LOOP, LAW.Q)
    assert design == design and design != synthesise(LOOP, LAW.Q)
    assert len({design, design}) == 1


@pytest.mark.parametrize(
    ("words", "call"),
    [
        ("forcing has shape", lambda: state_sequence(np.eye(2), np.ones((4, 1)), [0.0, 0.0])),
        ("A has shape", lambda: state_sequence(np.ones((2, 1)), np.ones((4, 1)), [0])),
        (
            "options = .*'db'.* control.singular_values_plot",
            lambda: synthesise(LAG, LAW.Q).plot(db=True),
        ),
        (r"P has shape \(\), .* \(omega, outputs, inputs\)", lambda: synthesise(5, Q)),
        ("^P holds values of type object", lambda: synthesise({"a": 1}, Q)),
        (r"^Q = 5 is no filter, .* zero_phase_butterworth\(order,", lambda: synthesise(MODEL, 5)),
        (r"^P = Zero.*the plant comes first, as in synth", lambda: synthesise(Q, MODEL)),
        (
            r"^uncertainty = -0.1 must be a radius",
            lambda: synthesise(P, Q, OMEGA, uncertainty=-0.1),
        ),
        (r"^order = 40 must be .*, from 1 to 20", lambda: zero_phase_butterworth(40, 2.0, TS)),
        ("^Q holds values of type <U4", lambda: synthesise(MODEL, "lowp")),
        (r"^Q has shape \(1, 6\)", lambda: synthesise(MODEL, Q.sections)),
    ],
)
def test_an_error_says_what_is_wrong_with_the_argument(words, call):
    with pytest.raises(ValueError, match=words):
        call()


def test_a_reference_with_times_of_another_period_is_refused():
    times = np.arange(60) * 0.5
    table = pd.DataFrame({"x": bump(60, [1.0])[:, 0]}, index=times)
    labelled = xr.DataArray(table, dims=("time", "output"), coords={"time": times})
    for reference in (table, labelled):
        with pytest.raises(ValueError, match=r"reference has times .* 0\.5 s, but Ts is 1 s"):
            run_trials(LOOP, LAW, reference)
        with pytest.raises(ValueError, match="resample it"):
            record(RestartingModel(LAG), LOOP, LAW, reference, trials=1)
    run_trials(LOOP, LAW, table.reset_index(drop=True))  # numbers of samples, not times
    run_trials(LOOP, LAW, table.set_axis(2 * times))


def test_rms_of_a_record_without_reference_says_what_it_lacks():
    with pytest.raises(
        ValueError, match=r"e has no reference and y, but \['y'\]: pass one of them"
    ):
        rms(xr.Dataset({"y": (("time", "channel"), np.ones((9, 1)))}))


def test_a_loop_that_does_not_explain_its_log_is_named():
    log = run_trials(LOOP, LAW, bump(60, [1.0]))
    assert "WARNING" not in repr(replay(log))
    wrong = ClosedLoop(control.ss(0.95, 0.02, 1, 0, 1.0, inputs=["w"], outputs=["x"]))
    log.attrs |= {"loop": loop_note(wrong)}
    assert re.search(r"WARNING: the loop explains [-\d.]+ % of the motion of x", repr(replay(log)))


def test_a_file_that_cannot_be_written_is_called_by_its_name(tmp_path):
    with pytest.raises(FileNotFoundError, match=re.escape(str(tmp_path / "no" / "law.json"))):
        save_law(tmp_path / "no" / "law.json", LAW)
