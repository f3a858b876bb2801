"""What one gets wrong at first, in silence or with a raw error: it is said, or does no harm."""

import pickle
import re
from dataclasses import replace

import control
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from paper import paper_loop
from plants import LOOPS, RestartingModel, altered, axes, bump, furnace, random_stable, tanks
from problems import posed
from scipy import signal

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    convergence,
    current_trial_loop,
    frequency_response,
    least_gain,
    measured_response,
    multisine,
    record,
    replay,
    rms,
    run_trials,
    save_law,
    shake,
    synthesise,
    transfer,
    trial_norm,
    zero_phase_butterworth,
)
from ilctools.law.notes import with_law

TS = 1e-3
MODEL = control.ss(control.sample_system(control.tf([1e4], [1, 40, 1e4]), TS))
Q = zero_phase_butterworth(2, 60.0, TS)
OMEGA = np.geomspace(1, np.pi / TS, 300)
P = frequency_response(MODEL, OMEGA)
LAG = control.ss(0.5, 0.5, 1, 0, 1.0, inputs=["w"], outputs=["x"])
LOOP, CURRENT = ClosedLoop(LAG), current_trial_loop(LAG)
TANKS, PAPER = LOOPS["tanks"](), paper_loop()
LAW = Law(zero_phase_butterworth(2, 0.3, 1.0), LearningFilter([[[0.3]]], 1.0))
IN_MS, CAUSAL = replace(LAW.L, Ts=TS), 1 / (1 + 1j * OMEGA / 60)
LAW_OF_TWO = replace(LAW, L=LearningFilter(0.3 * np.eye(2)[:, :, None], 1.0))
MOVE, ZERO = 2 * np.sin(np.linspace(0, np.pi, 60)) ** 2, np.zeros((5, 2))
TWO = np.stack([MOVE, 3 * MOVE], axis=1)
LOG = with_law(run_trials(CURRENT, LAW, MOVE, None, 4), LAW.bound_to(CURRENT))
TABLE = control.frd(P.T, OMEGA)
AXES, TURNED = ClosedLoop(axes(), units={"x": "m"}), axes()[["y", "x"], :]
OF_AXES = synthesise(AXES, zero_phase_butterworth(2, 1.0, 0.1), order=3, L_max=None)
SCIPY_MODEL = signal.dlti([[0.9]], [[0.1]], [[1]], [[0]], dt=1.0)
SHAKING = multisine(LOOP, lowest=0.05, highest=2.0, amplitude=1.0, hours=0.3)
LIMITED = replace(LAW_OF_TWO, limits={"Q1": (0, 1)})
BOUND = LIMITED.bound_to(PAPER)

HALF = pd.DataFrame({"x": MOVE}, index=0.5 * np.arange(60))


class Stuck(RestartingModel):
    """A rig whose sensor is."""

    def read(self):
        return np.array([0.37])


REFUSED = {  # what the error says, and a call
    # units, and what is exchanged
    "omega must be given: P is an array": lambda: convergence(P, Q, IN_MS),
    "omega must be given, because Q": lambda: synthesise(LOOP, np.ones(60)),
    "omega = Zero.*Q comes second": lambda: synthesise(LOOP, OMEGA, Q),
    "omega, .* a row of increasing frequencies: sort": lambda: synthesise(
        P, OMEGA, Q.frequency_response(OMEGA), TS
    ),
    "P = Zero.*the plant comes first, as in synth": lambda: synthesise(Q, MODEL),
    "P is real at each frequency, .* or in dB": lambda: synthesise(np.abs(P), Q, OMEGA),
    # arrays and models of python-control
    "P is a table .* synthesise takes the table": lambda: ClosedLoop(TABLE),
    r"P.num\[0\]\[0\] has 1 values that are not finite": lambda: synthesise(
        control.tf([np.nan], [1, -0.5], TS)
    ),
    r"loop is a model, .* pass ClosedLoop\(model\)": lambda: run_trials(LAG, LAW, MOVE),
    r"signal has shape \(2, 30\), but must": lambda: IN_MS.apply(np.ones((2, 30))),
    "(?s:.*)as control.frd(?s:.*)log, omega, Ts": lambda: measured_response(TABLE.frdata),
    # numbers that no plant has
    r"reference has values of at most 1e\+300, .*another unit": lambda: synthesise(
        MODEL, Q, reference=np.full(60, 1e300)
    ),
    r"P has values of at most 2.55e-300, .*nearer to one": lambda: synthesise(
        1e-300 * P, Q, OMEGA, order=5, base=None
    ),
    r"scale has values of at most 1e\+300, .*other units": lambda: synthesise(
        OF_AXES.problem.response.models[0], OF_AXES.Q, scale=[1e300, 1e-300]
    ),
    "P.dt = None must be Ts = 1.0": lambda: synthesise(control.ss([], [], [], 2.0), Ts=1.0),
    # what is no plant, no filter, no log
    "Q shifts the phase .* one direction": lambda: synthesise(P, CAUSAL, OMEGA, TS),
    "Q = Trans.* one direction only: pass zero_ph": lambda: synthesise(MODEL, control.tf(MODEL)),
    "P = (?s:.*)to_ss": lambda: synthesise(SCIPY_MODEL, Q),
    "plant = (?s:.*)linearize": lambda: current_trial_loop(
        control.nlsys(None, lambda t, x, u, p: u, dt=1.0)
    ),
    r"log.omega = \[0.0, .{,80}\.\.\.\] must be": lambda: measured_response(
        control.frd(np.ones(200), np.arange(200.0))
    ),
    r"log\.y of x never moved: is its sensor connected": lambda: measured_response(
        shake(Stuck(LAG), LOOP, SHAKING)
    ),
    r"e has the variables \['y'\], but .*: pass one of its variables": lambda: rms(
        xr.Dataset({"y": (("time", "channel"), ZERO)})
    ),
    # sizes
    r"e has dimensions \('time',\)": lambda: rms(xr.DataArray(ZERO[:, 0], dims="time")),
    "P has a radius, which .*: use design.check": lambda: convergence(
        measured_response(control.frd(P.T, OMEGA), uncertainty=0.1 * np.abs(P.ravel())),
        Q,
        IN_MS,
        OMEGA,
    ),
    "order = 10 .* 5 frequencies": lambda: synthesise(P[:5], Q, OMEGA[:5], TS, order=10),
    "hours = 1.2 is too short .* lowest = 0.0262": lambda: multisine(
        TANKS, 0.01, 1.0, [1, 1, 1], 1.2
    ),
    "(?s:.*)infeasible(?s:.*)units, signs and the order": lambda: synthesise(
        [LAG, 1000 * LAG], LAW.Q, order=3, L_max=None
    ),
    "(?s:.*)L_max = 5": lambda: least_gain(MODEL, Q, L_max=5.0),
    "(?s:.*)the main obstacle is": lambda: synthesise([LAG, -LAG], M_max=0.4),  # B of both is zero
    # names, units, times
    "law.labels = .*, but loop.labels = .* in the same order": lambda: run_trials(
        ClosedLoop(TURNED), OF_AXES.law(), TWO
    ),
    "loop.labels = .* plant.labels": lambda: run_trials(AXES, OF_AXES.law(), TWO, plant=TURNED),
    r"design.units\['x'\] = 'm', but P.units\['x'\] = 'mm'": lambda: OF_AXES.check(
        ClosedLoop(axes(), units={"x": "mm"})
    ),
    "trials has times with steps from 0.5 to 0.5 s, but Ts is 1 s": lambda: transfer(
        LOG.assign_coords(time=0.5 * LOG.time), MOVE
    ),
    # more outputs than inputs
    "base = None needs as many .* has 2 inputs and 1 outputs": lambda: synthesise(
        axes()[0, :], OF_AXES.Q, base=None
    ),
    "structure = 'diagonal' needs as many .* has 2 inputs and 1 outputs": lambda: synthesise(
        axes()[0, :], OF_AXES.Q, structure="diagonal"
    ),
    r"scale = .* must be a dict by the names of outputs": lambda: synthesise(
        axes()[:, 0], OF_AXES.Q, scale=[1.0, 2.0]
    ),
    # a loop that is not ours
    "P = None: then Ts and outputs": lambda: ClosedLoop(),
    "P is unstable.*current_trial_loop": lambda: ClosedLoop(control.ss(2.0, 1, 1, 0, 1.0)),
    "P has the inputs .* not equally many": lambda: ClosedLoop(axes()[0, :]),
    r"references\['set x'\] = 'z' must be one of the outputs": lambda: ClosedLoop(
        axes(), references={"set x": "z"}
    ),
    r"references has the keys \['set z'\]": lambda: ClosedLoop(axes(), references={"set z": "x"}),
    r"learned = \['force'\] must name some": lambda: ClosedLoop(axes(), learned=["force"]),
    r"the inputs \['set y'\] of P take neither": lambda: ClosedLoop(
        axes(), references={"set x": "x"}, learned=["set x"]
    ),
    "learned = .* must be a list of different names": lambda: ClosedLoop(
        axes(), learned=["set x", "set x"]
    ),
    r"outputs = \['a'\]": lambda: ClosedLoop(axes(), outputs=["a"]),
    r"controls = \['a'\]": lambda: ClosedLoop(axes(), controls=["a"]),
    "loop has no P": lambda: run_trials(ClosedLoop(Ts=1.0, outputs=["x"]), LAW, MOVE),
    "disturbance is not zero": lambda: run_trials(
        ClosedLoop(LAG, disturbances=["d"]), LAW, MOVE, MOVE
    ),
    # a law
    "Q = samples": lambda: synthesise(P, Q.frequency_response(OMEGA), OMEGA, TS).law(),
    "limits need": lambda: LIMITED.next(ZERO, ZERO, ZERO),
    "u = None": lambda: BOUND.next(ZERO, ZERO),
    r"v or e holds the signals \['b', 'a'\], .*bound_to": lambda: LAW_OF_TWO.next(
        pd.DataFrame(TWO, columns=["b", "a"]), TWO
    ),
}


@pytest.mark.parametrize("words", REFUSED)
def test_an_error_names_the_argument(words):
    with pytest.raises(ValueError, match=f"^{words}"):
        REFUSED[words]()


LATE = MOVE[20:]  # from the middle of a move
SHARE = 100 * np.mean(MOVE > 1)
SAID = {  # what a warning says, and simulated trials that cannot work
    "predicts 0.* x changed by -1 times .*exchanged or reversed": lambda: run_trials(
        AXES, OF_AXES.law(), TWO, None, 3, plant=altered(axes(), B=-1.0)
    ),
    "predicts 0.* x changed by -0.96 times .*exchanged or reversed": lambda: run_trials(
        AXES, OF_AXES.law(), bump(60, [2.0, -1.0]), None, 3,
        plant=control.ss(TURNED, outputs=["x", "y"]),
    ),
    "^no output moves in the 60 samples of a trial": lambda: run_trials(
        ClosedLoop(furnace(60)), LAW, MOVE, None, 2
    ),
    f"^the reference starts {LATE[0]:.3g} in x away from where trials start": lambda: run_trials(
        LOOP, LAW, LATE, None, 2
    ),
    f"^commands were beyond the limits of w in {SHARE:.1f}%.*saturated there": lambda: run_trials(
        LOOP, replace(LAW, limits={"w": (-1.0, 1.0)}), MOVE, None, 1
    ),
}  # fmt: skip


@pytest.mark.parametrize("words", SAID)
def test_simulated_trials_that_cannot_work_are_warned_of(words):
    with pytest.warns(UserWarning, match=words) as seen:
        SAID[words]()
    assert len(seen) == 1 and seen[0].filename == __file__


def test_outputs_in_different_units_without_a_scale_are_said():
    mixed = ClosedLoop(axes(), units={"x": "mm", "y": "K"})
    with pytest.warns(UserWarning, match="the outputs are in K, mm, .* pass `scale`"):
        synthesise(mixed, OF_AXES.Q)
    synthesise(mixed, OF_AXES.Q, scale=[2.0, 0.5])


def test_a_phase_that_no_stable_plant_has_is_said():
    synthesise(P, Q, OMEGA)
    with pytest.warns(UserWarning, match=r"the phase of P leads .* pass P.conj\(\)"):
        synthesise(P.conj(), Q, OMEGA)


def test_frequencies_may_be_rounded():
    """Of a table that ends at the Nyquist frequency, 3141.59 rad/s: as it, and not beyond."""
    table = control.frd(P.T, np.append(OMEGA[:-1], 3142), TS)
    assert synthesise(table, Q).certificate.rate == synthesise(P, Q, OMEGA).certificate.rate


@pytest.mark.parametrize(("unit", "factor"), [("Hz", 2 * np.pi), ("rad/sample", 1 / TS)])
def test_omega_in_another_unit_is_refused(unit, factor):
    """Of a table up to the Nyquist frequency; in rad/s it is not."""
    with pytest.raises(ValueError, match=f"omega is in {unit}, multiply it by {factor:.6g}$"):
        synthesise(P, Q, OMEGA / factor)
    for plant in (LAG, *map(random_stable, range(10))):
        omega = np.linspace(0.01, 1.0, 100) * (0.5 / plant.dt if unit == "Hz" else np.pi)
        posed(frequency_response(plant, omega), np.exp(-omega), omega, plant.dt)


def test_the_error_is_what_reference_and_outputs_say():
    assert replay(LOG.assign(e=-LOG.e)).trials.identical(replay(LOG).trials)


def test_trials_that_diverge_by_their_ends_alone_are_warned_of():
    """Without a bound on L: a certificate of less than one, of trials without ends."""
    plant = random_stable(3, n=3, m=1, distance=0.05, Ts=1.0)
    loop = ClosedLoop(control.ss(plant.A, plant.B, plant.C, 0, 1.0))
    design = synthesise(loop, zero_phase_butterworth(2, 0.5, 1.0), L_max=None, base=None)
    assert design.certificate.rate < 1
    with pytest.warns(UserWarning, match=r"the error grows.*trial_norm is below 1") as seen:
        run_trials(loop, design.law(), bump(200, [1.0]), trials=10)
    assert len(seen) == 1 and trial_norm(loop.P, design.Q, design.filter, 200)[0] > 1


def test_what_holds_a_model_can_be_sent_to_another_process():
    design = synthesise(LOOP, LAW.Q)
    measured = measured_response(shake(RestartingModel(LAG, noise=0.01), LOOP, SHAKING))
    for thing in (design, design.law().bound_to(LOOP), LOOP, measured, tanks()):
        other = pickle.loads(pickle.dumps(thing))
        assert repr(other) == repr(thing) and type(other) is type(thing)
    assert other.input_labels == thing.input_labels


def test_designs_are_compared_without_an_error():
    design = synthesise(LOOP, LAW.Q)
    assert design == design and design != synthesise(LOOP, LAW.Q)
    assert len({design, design}) == 1


def test_a_reference_has_times_of_the_loop_or_numbers_of_samples():
    run_trials(LOOP, LAW, HALF.reset_index(drop=True))
    run_trials(LOOP, LAW, HALF.set_axis(2 * HALF.index))
    times = xr.DataArray(HALF, dims=("time", "output"), coords={"time": HALF.index})
    for wrong in (HALF.x, times):
        with pytest.raises(ValueError, match=r"reference has times .* 0.5 s, but Ts is 1 s"):
            run_trials(LOOP, LAW, wrong)


def test_a_file_that_cannot_be_written_is_called_by_its_name(tmp_path):
    with pytest.raises(FileNotFoundError, match=re.escape(str(tmp_path / "no" / "law.json"))):
        save_law(tmp_path / "no" / "law.json", LAW)


def test_labelled_columns_are_matched_by_name():
    names, frame = PAPER.disturbances, pd.DataFrame(TWO[:, ::-1], columns=["y2", "y1"])
    d = pd.DataFrame({name: [i] * 60 for i, name in enumerate(names)})
    plain = run_trials(PAPER, LAW_OF_TWO, TWO, d.values, 2)
    d, channels = d[names[::-1]], xr.DataArray(frame, dims=["time", "channel"])
    for labelled in (frame, channels):
        assert run_trials(PAPER, LAW_OF_TWO, labelled, d, 2, v=0 * frame).identical(plain)


def test_one_channel_needs_no_axis():
    column = MOVE[:, None]
    plain = run_trials(CURRENT, LAW, MOVE, None, 2, v=MOVE)
    assert run_trials(CURRENT, LAW, column, None, 2, v=column).identical(plain)
    record(RestartingModel(LAG), CURRENT, LAW, MOVE, trials=2, v=MOVE)


def test_where_there_is_nothing_to_learn_nothing_is_said():
    """Neither of zeros nor of a v that stays zero: all warnings are errors here."""
    run = run_trials(CURRENT, LAW, np.zeros(60), trials=4)
    assert not run.e.any() and not run.v.any()
