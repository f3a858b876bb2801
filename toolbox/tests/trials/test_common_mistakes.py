"""What one gets wrong at first is an error that names the argument, or does no harm."""

import warnings
from dataclasses import replace

import control
import numpy as np
import pandas as pd
import pytest
from paper import paper_loop
from plants import LOOPS, RestartingModel, axes, bump, furnace
from scipy import signal

from ilctools import (
    ClosedLoop,
    Controller,
    Law,
    LearningFilter,
    convergence,
    current_trial_loop,
    load_law,
    load_log,
    measured_response,
    multisine,
    record,
    run_trials,
    save_law,
    save_log,
    synthesise,
    transfer,
    zero_phase_butterworth,
)
from ilctools.law.notes import with_law

LAG = control.ss(0.9, 0.1, 1, 0, 1.0, inputs=["heater"], outputs=["oven"])
LOOP, PAPER = current_trial_loop(LAG), paper_loop()
TANKS = LOOPS["tanks"]()
Q = zero_phase_butterworth(2, 0.1, 1.0)
OMEGA = np.geomspace(1e-3, np.pi, 80)
CAUSAL = signal.freqz(*signal.butter(2, 0.1 / np.pi), worN=OMEGA)[1]
BAND = {"band": (0.001, 0.02), "L_max": None, "order": 10}
DESIGN = synthesise(LOOP, Q, OMEGA, **BAND)
LAW = Law(Q, DESIGN.filter)
MOVE = 2 * np.sin(np.linspace(0, np.pi, 60)) ** 2
TWO = np.stack([MOVE, 3 * MOVE], axis=1)
LAW_OF_TWO = Law(Q, LearningFilter(0.3 * np.eye(2)[:, :, None], 1.0))
LOG = with_law(run_trials(LOOP, LAW, MOVE, None, 4), LAW.bound_to(LOOP))
BOTH = run_trials(PAPER, LAW_OF_TWO, TWO, None, 2)
OTHER_NAMES = pd.DataFrame(TWO, columns=["T1", "T2"])
CAUSAL_MODEL = control.tf([0.1], [1, -0.9], 1.0)
SCIPY_MODEL = signal.dlti([[0.9]], [[0.1]], [[1]], [[0]], dt=1.0)
NONLINEAR = control.nlsys(None, lambda t, x, u, p: u, dt=1.0)
AXES, TURNED = ClosedLoop(axes(), units={"x": "m"}), axes()[["y", "x"], :]
Q_OF_AXES = zero_phase_butterworth(2, 1.0, 0.1)
OF_AXES = synthesise(AXES, Q_OF_AXES, order=3, L_max=None, structure="full")
FURNACE = furnace()
MOVES = bump(60, [1.0, 2.0])
IN_MM = ClosedLoop(axes(), units={"x": "mm"})


def design(P=LOOP, Q=Q, omega=OMEGA, **more):
    return synthesise(P, Q, omega, **BAND | {"Ts": 1.0} | more)


def response(omega=OMEGA):
    return LOOP.frequency_response(omega)


REFUSED = {  # what the error names, and a call
    "omega in Hz, to judge": (
        "omega is in Hz",
        lambda: convergence(response(), Q, DESIGN.filter, OMEGA / (2 * np.pi)),
    ),
    "Q and omega exchanged": ("omega holds", lambda: synthesise(LOOP, OMEGA, Q)),
    "their samples exchanged": (
        "omega, .* must be a row of increasing",
        lambda: design(response(), OMEGA, Q.frequency_response(OMEGA)),
    ),
    "Q in one direction": ("Q turns the phase .* one direction", lambda: design(Q=CAUSAL)),
    "a model as Q": ("Q = .* one direction", lambda: design(Q=CAUSAL_MODEL)),
    "a path as P": ("P holds values of type <U7", lambda: design("rod.csv")),
    "scipy's model as P": ("(?s)P = .*to_ss", lambda: design(SCIPY_MODEL)),
    "scipy's model as a plant": ("plant = ", lambda: current_trial_loop(SCIPY_MODEL)),
    "a nonlinear plant": ("(?s)plant = .*linearize", lambda: current_trial_loop(NONLINEAR)),
    "few frequencies": (
        "order = 10 .* 5 frequencies",
        lambda: design(response(OMEGA[::16]), omega=OMEGA[::16]),
    ),
    "a design for its filter": ("L = .* pass L.filter", lambda: Law(Q, DESIGN)),
    "columns of other signals": (
        r"reference .*T1.*y1",
        lambda: run_trials(PAPER, LAW_OF_TWO, OTHER_NAMES, None, 2),
    ),
    "a column too few": (
        r"reference has shape \(60,\)",
        lambda: run_trials(PAPER, LAW_OF_TWO, MOVE, None, 2),
    ),
    "amplitudes": ("amplitude = ", lambda: multisine(PAPER, 0.01, 1.0, [1, 1, 1], 1.2)),
    "too few hours": (
        "hours = 1.2 is too short .* lowest = 0.0262",
        lambda: multisine(TANKS, 0.01, 1.0, [1, 1, 1], 1.2),
    ),
    "outputs in another order, to check": (
        r"design.labels = \['x', 'y', .* P.labels = \['y', 'x'",
        lambda: OF_AXES.check(TURNED),
    ),
    "outputs in another order, of several": (
        r"P\[1\].labels = \['y', 'x'",
        lambda: synthesise([axes(), TURNED], Q_OF_AXES),
    ),
    "outputs in another order, to simulate": (
        "plant.labels",
        lambda: run_trials(AXES, OF_AXES.law(), MOVES, plant=TURNED),
    ),
    "outputs in another order, to learn": (
        "law.labels = .*, loop.labels = .* in the same order",
        lambda: run_trials(ClosedLoop(TURNED), OF_AXES.law(), MOVES),
    ),
    "names in another order": ("P.labels", lambda: ClosedLoop(axes(), outputs=["y", "x"])),
    "another unit, to check": (r"P.units\['x'\] = 'mm'", lambda: OF_AXES.check(IN_MM)),
    "a time that contradicts Ts": (
        "trials has times with steps from 0.5 to 0.5 s, but Ts is 1 s",
        lambda: transfer(LOG.assign_coords(time=0.5 * LOG.time), MOVE),
    ),
    "more outputs than inputs, a model": (
        "P has 1 inputs and 2 outputs.* combinations",
        lambda: synthesise(axes()[:, 0], Q_OF_AXES),
    ),
    "more outputs than inputs, samples": (
        r"P\[1\] has 2 inputs and 3 outputs.* combinations",
        lambda: synthesise([np.ones((80, 2, 2)), np.ones((80, 3, 2))], Q, OMEGA),
    ),
    "more outputs than inputs, a table": (
        "log has 2 inputs and 3 outputs.* combinations",
        lambda: measured_response(control.frd(np.ones((3, 2, 80)), OMEGA)),
    ),
    "more outputs than inputs, a loop": (
        "2 outputs.* combinations",
        lambda: current_trial_loop(axes()[:, 0]),
    ),
    "a DataFrame as a log": ("log = .*(?s:.*) read_table", lambda: measured_response(OTHER_NAMES)),
    "a path as a log": ("log = 'log.csv' .*load_log", lambda: measured_response("log.csv")),
    "many frequencies": (
        r"^log.omega = \[0.0, .{,80}\.\.\.\] must be",
        lambda: measured_response(control.frd(np.ones(200), np.arange(200.0))),
    ),
    "a weight of many states": (
        r"^Qs must be symmetric .{,300}$",
        lambda: current_trial_loop(FURNACE, Qs=-np.eye(31)),
    ),
    "outputs in mm for m": (
        "(?s)infeasible.*units, signs and the order",
        lambda: synthesise([LAG, 1000 * LAG], Q, OMEGA, order=3, L_max=None),
    ),
}


@pytest.mark.parametrize(("words", "call"), REFUSED.values(), ids=REFUSED)
def test_an_error_names_the_argument(words, call):
    with warnings.catch_warnings(action="error"), pytest.raises(ValueError, match=words):
        call()


def test_labelled_columns_are_matched_by_name():
    frame = pd.DataFrame(TWO[:, ::-1], columns=["y2", "y1"])
    turned = BOTH.reference.isel(channel=[1, 0])
    for reference in (frame, turned, pd.DataFrame(TWO)):
        assert run_trials(PAPER, LAW_OF_TWO, reference, None, 2).identical(BOTH)
    names = PAPER.disturbances
    d = pd.DataFrame({name: [i] * 60 for i, name in enumerate(names)})
    plain = run_trials(PAPER, LAW_OF_TWO, TWO, d.values, 2)
    d = d[names[::-1]]
    assert run_trials(PAPER, LAW_OF_TWO, TWO, d, 2, v=0 * frame).identical(plain)


def test_one_channel_needs_no_axis():
    column, runs = MOVE[:, None], []
    for move in (MOVE, column):
        runs.append(run_trials(LOOP, LAW, move, None, 2, v=move))
        rig = RestartingModel(LAG)
        runs.append(record(rig, LOOP, LAW, move, trials=2, v=move))
    assert runs[0].identical(runs[2]) and runs[1].identical(runs[3])
    following = LAW.next(MOVE, 0.5 * MOVE)
    np.testing.assert_array_equal(following[:, None], LAW.next(column, 0.5 * column))
    assert Controller(LOOP).step([0.0], [1.0]).shape == (1,)


def test_a_log_and_a_law_are_distinguished(tmp_path):
    log, law = tmp_path / "log.csv", tmp_path / "law.json"
    save_log(LOG, log)
    save_law(law, LAW)
    with pytest.raises(ValueError, match="law_of"):
        load_law(log)
    with pytest.raises(ValueError, match="load_law"):
        load_log(law)


FLIPPED, SWAPPED = -np.eye(2), np.eye(2)[::-1]
LIMITED = Law(Q, LearningFilter([[[0.5]]], 1.0), limits={"w1": (-1.0, 1.0)})
ON_W = ClosedLoop(control.ss(0.5, 0.5, 1, 0, 1.0, inputs=["w1"], outputs=["x"]))
LATE = MOVE[20:]  # from the middle of a move
SAID = {  # what a warning says, and the arguments of run_trials
    "both signs wrong": (
        "predicts 0.*-1 in x came; .*exchanged or reversed",
        (AXES, OF_AXES.law(), MOVES, None, 3),
        FLIPPED,
    ),
    "outputs exchanged": (
        "predicts 0.*-0.96 in x came; .*exchanged or reversed",
        (AXES, OF_AXES.law(), bump(60, [2.0, -1.0]), None, 3),
        SWAPPED,
    ),
    "a start away from rest": (
        rf"^the reference starts {LATE[0]:.3g} in x from where trials do",
        (ON_W, replace(LIMITED, limits={}), LATE, None, 2),
        None,
    ),
    "a reference beyond the limits": (
        rf"^commands were beyond the limits of w1 in {100 * np.mean(MOVE > 1):.1f}%.*cut off",
        (ON_W, LIMITED, MOVE, None, 1),
        None,
    ),
}


@pytest.mark.parametrize(("words", "case", "turned"), SAID.values(), ids=SAID)
def test_simulated_trials_that_cannot_work_are_warned_of(words, case, turned):
    plant = None
    if turned is not None:
        names = {"inputs": ["set x", "set y"], "outputs": ["x", "y"]}
        P = axes()
        plant = control.ss(P.A, P.B, turned @ P.C, 0, 0.1, **names)
    with pytest.warns(UserWarning, match=words) as seen:
        run_trials(*case, plant=plant)
    assert len(seen) == 1 and seen[0].filename == __file__


def test_where_there_is_nothing_to_learn_nothing_is_said():
    """Neither of zeros nor of a v that stays zero: all warnings are errors here."""
    run = run_trials(LOOP, LAW, np.zeros(60), trials=4)
    assert not run.e.any() and not run.v.any()
