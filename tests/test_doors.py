"""What does not belong at a public door is refused by an error that names the argument."""

import re
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import control
import numpy as np
import pytest
import skfem
import xarray as xr

import ilctools
import rodlib
from ilctools import alternatives
from rodlib import Rod, approximations

PLANT = control.ss(0.5, [[0.5, 1.0]], 1, 0, 1.0, inputs=["u", "d"], outputs=["y"])
LOOP, PAPER = ilctools.current_trial_loop(PLANT, ["u"]), rodlib.paper_loop()
P, Q = LOOP.P, ilctools.zero_phase_butterworth(2, 0.1, 1.0)
L = ilctools.LearningFilter([[[0.5, 0.1]]], 1.0)
L2 = ilctools.LearningFilter(np.ones((2, 2, 1)), 1.0)
LAW = ilctools.Law(Q, L)
OMEGA, SIGNAL = np.linspace(0.1, 3, 12), np.zeros((6, 1))
ASKED = {"P": LOOP, "Q": Q, "omega": OMEGA, "Ts": 1.0, "order": 2, "band": (0.1, 1.0)}
ASKED |= {"M_max": 0.9, "L_max": 50.0, "structure": "full"}
DESIGN = ilctools.synthesise(**ASKED | {"P": [P, 0.99 * P]})
NOISE = ilctools.trial_noise(LOOP, OMEGA, 1.0)
SPREAD = rodlib.Spread.of_all(0.1)
SPECIMEN = rodlib.draw(SPREAD, 0)
STUDY = rodlib.Study(
    PAPER,
    Q,
    {"L": L2},
    SPREAD,
    omega=np.array([0.001, 0.01, 1.0]),
    reference=np.ones((20, 2)),
    trials=2,
)
SHAKE = {"loop": PAPER, "lowest": 0.3, "highest": 1.0, "amplitude": 1.0, "hours": 0.1}
EXCITATION = ilctools.multisine(**SHAKE, lines=3)
RIG = rodlib.RestartingRig(parameters=rodlib.RigParameters(modes=5))
with warnings.catch_warnings(action="ignore"):
    LOG = ilctools.run_trials(LOOP, LAW, np.ones((70, 1)), None, 2)
    RECORD = ilctools.record(RIG, PAPER, ilctools.Law(Q, None), np.zeros((70, 2)), trials=1)
FILES = TemporaryDirectory(ignore_cleanup_errors=True)
LAW_FILE, LOG_FILE = (Path(FILES.name) / name for name in ("law", "log"))
TABLE = Path(FILES.name) / "table.csv"
TABLE.write_text("t,u,y\n" + "".join(f"{k},{k % 7},{k % 5}\n" for k in range(50)))
ilctools.save_law(LAW_FILE, LAW)
ilctools.save_log(RECORD, LOG_FILE)

# One value of each wrong kind, by the name of the argument.
THING, MODEL = [1.5], [1.5, "P"]
POSITIVE, WHOLE = ["1", np.nan, -1.0, [1.0]], ["1", 1.5, -1]
ARRAY = ["1", np.full((6, 1), np.nan), np.zeros((0, 1))]
WRONG = {
    name: values
    for values, names in (
        (THING, "rod loop law L Q spread specimens nominal element trials_ rest_ path"),
        ([*POSITIVE[:3]], "sensor_psd sensor_variance"),
        (THING, "filters rig excitation log solution design parameters noise_"),
        (MODEL, "P plant system model"),
        (POSITIVE, "Ts cutoff conductivity M_max L_max weight level effort gain step"),
        (POSITIVE, "share lowest highest amplitude hours lag seebeck wait confidence"),
        (WHOLE, "degree states intervals elements cells modes order samples trials"),
        (WHOLE, "number root rods ahead channels preview lines evaluations seed rest"),
        (WHOLE, "trial first Q_order"),
        (ARRAY, "omega s signal v e reference coefficients gains heat_flows weights A"),
        (ARRAY, "disturbance sensors deviations KL alone heaters readings"),
        ([1.5, "y", ["u", "u"]], "controls inputs"),
        ([1.5, "mirror"], "structure ends"),
        ([0.1, (1.0, 0.1), ("a", 1.0)], "band"),
    )
    for name in names.split()
}

# Each door with what belongs there; and what does not, if its name does not say it all.
FOR_TRIALS = {"P": P, "Q": Q, "L": L, "samples": 6}
ON_GRID = {"P": LOOP, "Q": Q, "L": L, "omega": OMEGA}
DOORS = [
    (
        Rod,
        {"conductivity": 55.0, "density": 7800.0, "sections": 4, "sensors": (0.1,)},
        {"density": [*POSITIVE, 1e12], "sections": [*WHOLE, 0, 1001]}
        | {"sensors": [*ARRAY, (0.1, 0.5), ()]},
    ),
    (rodlib.midr, {"rod": Rod(), "degree": 1}, {"degree": [*WHOLE, 0, 21]}),
    (rodlib.exact_response, {"rod": Rod(), "s": [1j]}),
    (
        rodlib.sampled_response,
        {"rod": Rod(), "omega": OMEGA, "Ts": 1.0},
        {"omega": [*ARRAY, [-1e-3], [3.2]], "Ts": [*POSITIVE, 0.0, 1e-7]},
    ),
    (
        approximations.balanced_truncation,
        {"rod": Rod(), "states": 2, "inputs": ["Q1"]},
        {"states": [*WHOLE, 0, 49], "inputs": [[], ["Q5"], "Q1"]},
    ),
    (
        approximations.finite_differences,
        {"rod": Rod(), "intervals": 2},
        {"intervals": [*WHOLE, 0, 1001]},
    ),
    (
        approximations.finite_elements,
        {"rod": Rod(), "element": skfem.ElementLineP1(), "elements": 1},
        {"element": ["P1", skfem.ElementLineP0(), skfem.ElementTriP1()]},
    ),
    (approximations.finite_volumes, {"rod": Rod(), "cells": 2}, {"cells": [*WHOLE, 0, 1001]}),
    (approximations.modal_series, {"rod": Rod(), "modes": 4}, {"modes": [*WHOLE, 0, 10_001]}),
    (
        rodlib.paper_loop,
        {"rod": Rod(), "degree": 1, "Ts": 1.0},
        {"rod": [1.5, Rod(sections=3), Rod(sensors=(0.1,))]}
        | {"Ts": [*POSITIVE, 1e-5, 1e4, np.inf]},
    ),
    (rodlib.assumed_reference, {"samples": 5}, {"samples": [*WHOLE, 0]}),
    (
        rodlib.assumed_disturbance,
        {"samples": 5, "trials": 2, "first": 1},
        {name: [*WHOLE, 0] for name in ("samples", "trials", "first")},
    ),
    (
        rodlib.Spread,
        {"density": 0.1, "gains": 0.1, "sensors": 0.1},
        {"density": [1.0], "gains": [-0.1], "sensors": [-0.1]},
    ),
    (rodlib.Spread.of_all, {"share": 0.1, "rod": Rod()}, {"share": [-0.1, 1.0]}),
    (
        SPREAD.specimen,
        {"deviations": np.zeros(10), "nominal": Rod()},
        {"deviations": [np.zeros(9), [-1.5, *[0] * 9]]},
    ),
    (rodlib.Specimen, {"rod": Rod(), "gains": np.ones(4)}),
    (
        rodlib.draw,
        {"spread": SPREAD, "number": 1, "root": 1, "nominal": Rod()},
        {"spread": [1.5, rodlib.Spread(sensors=0.05)]},
    ),
    (
        rodlib.responses,
        {"loop": PAPER, "specimens": [SPECIMEN], "omega": OMEGA},
        {"specimens": [1.5, [], [Rod()]], "loop": [1.5, LOOP]},
    ),
    (
        rodlib.Study,
        STUDY.__dict__,
        {"loop": [1.5, LOOP], "Q": [1.5, ilctools.zero_phase_butterworth(2, 0.1, 2.0)]}
        | {"filters": [1.5, {}], "omega": [[0.1, 4.0]], "reference": [np.ones((5, 3))]}
        | {"trials": [0]},
    ),
    (STUDY.run, {"rods": 1}, {"rods": [*WHOLE, 0]}),
    (rodlib.RigParameters, {"modes": 5, "lag": 4.0}),
    (rodlib.VirtualRig, {"rod": Rod(), "Ts": 1.0, "seed": 1}),
    (rodlib.RestartingRig, {"rod": Rod(), "parameters": rodlib.RigParameters()}),
    (RIG.apply, {"heat_flows": np.zeros(4)}),
    (rodlib.PeltierParameters, {"cells": 2, "lag": 2.0}),
    (rodlib.PeltierRig, {"rod": Rod(), "Ts": 1.0, "seed": 1}),
    (rodlib.RestartingPeltierRig, {"parameters": rodlib.PeltierParameters()}),
    (
        rodlib.fit_heat_balance,
        {"heaters": np.eye(40, 2), "readings": np.eye(40, 2, -3), "Ts": 1.0},
        {"readings": [*ARRAY, np.ones((20, 2))]},
    ),
    (ilctools.frequency_response, {"system": PLANT, "omega": OMEGA}),
    (ilctools.minimal_realisation, {"plant": PLANT, "controls": ["u"]}),
    (ilctools.current_trial_loop, {"plant": PLANT, "controls": ["u"]}),
    (ilctools.ClosedLoop, {"P": P, "Ts": 1.0, "controls": ["u"]}),
    (ilctools.combinations, {"P": P, "weights": [1.0]}),
    (ilctools.zero_phase_butterworth, {"order": 2, "cutoff": 0.1, "Ts": 1.0}),
    (Q.apply, {"signal": SIGNAL}),
    (ilctools.LearningFilter, {"coefficients": L.coefficients, "Ts": 1.0}),
    (L.frequency_response, {"omega": OMEGA}),
    (ilctools.Law, {"Q": Q, "L": L, "rest": 1, "gain": 0.5}),
    (LAW.next, {"v": SIGNAL, "e": SIGNAL}),
    (
        ilctools.run_trials,
        {"loop": LOOP, "law": LAW, "reference": SIGNAL, "trials": 2, "plant": PLANT},
    ),
    (ilctools.transfer, {"trials": LOG, "reference": np.ones((70, 1))}, {"trials": THING}),
    (ilctools.rms, {"e": xr.DataArray(SIGNAL, dims=("time", "channel"))}),
    (ilctools.synthesise, ASKED),
    (ilctools.synthesise, ASKED | {"band": None, "reference": SIGNAL + 1}, {"band": []}),
    (ilctools.least_gain, {key: ASKED[key] for key in ("P", "Q", "omega", "order")}),
    (DESIGN.check, {"P": LOOP, "omega": OMEGA}),
    (ilctools.rate, ON_GRID),
    (ilctools.convergence, ON_GRID),
    (ilctools.trial_operators, FOR_TRIALS),
    (ilctools.trial_map, FOR_TRIALS),
    (ilctools.trial_norm, FOR_TRIALS),
    (ilctools.trial_noise, {"loop": LOOP, "omega": OMEGA, "sensor_psd": 1.0}),
    (ilctools.converged_noise, {"new": NOISE, "law": LAW}),
    (ilctools.noise_on_trial, {"loop": LOOP, "law": LAW, "samples": 6, "sensor_variance": 1.0}),
    (ilctools.replay, {"trials": RECORD}, {"trials": THING}),
    (ilctools.estimated, {"trials": LOG, "loop": LOOP, "model": PLANT}, {"trials": THING}),
    (
        ilctools.read_table,
        {"path": TABLE, "time": "t", "inputs": {"u": "u"}, "outputs": {"y": "y"}},
        {"time": ["none"], "inputs": [1.5, {"u": "none"}], "outputs": [1.5]},
    ),
    (ilctools.worst_case, {"problem": DESIGN.problem, "L": L}),
    (ilctools.support, {"solution": DESIGN.solution}),
    (ilctools.violation_probability, {"design": DESIGN}),
    (alternatives.p_type, {"gain": 1.0, "ahead": 1, "channels": 1, "Ts": 1.0}),
    (alternatives.gradient, {"P": P, "step": 0.1}),
    (alternatives.stable_inversion, {"P": P}),
    (alternatives.zero_phase_inversion, {"P": P}),
    (alternatives.h_infinity, {"P": P, "Q": Q, "level": 0.95, "effort": 0.01, "preview": 2}),
    (ilctools.NormOptimal, {"P": P, "weight": 1.0, "samples": 6}),
    (alternatives.two_sided_taps, {"L": L}),
    (alternatives.lines, {"samples": 6, "Ts": 1.0}),
    (ilctools.Controller, {"loop": LOOP}),
    (ilctools.multisine, SHAKE | {"lines": 3}),
    (
        ilctools.record,
        {"rig": RIG, "loop": PAPER, "law": ilctools.Law(Q, L2), "reference": SIGNAL * [0, 0]}
        | {"trials": 2},
    ),
    (ilctools.shake, {"rig": RIG, "loop": PAPER, "excitation": EXCITATION}),
    (ilctools.measured_response, {"log": control.frd(L.frequency_response(OMEGA).T, OMEGA)}),
    (ilctools.save_law, {"path": LAW_FILE, "law": LAW}),
    (ilctools.load_law, {"path": LAW_FILE}),
    (ilctools.save_log, {"trials": RECORD, "path": LOG_FILE}, {"trials": THING}),
    (ilctools.load_log, {"path": LOG_FILE}),
    (ilctools.law_of, {"trials": RECORD}, {"trials": THING}),
]
# Tested with their own files, or not called by themselves.
TESTED = """InfeasibleError MISMATCHED Settings TemperatureControlLab alternatives
    approximations expected_radius heat_balance open_workbench plot
    paper_choices state_sequence try_out unreachable_modes"""
ELSEWHERE = {*TESTED.split()}


def wrong(door):
    values = WRONG | door[2] if len(door) > 2 else WRONG
    for name in door[1]:
        for value in values.get(name, THING):
            yield name, value


@pytest.mark.parametrize("door", DOORS, ids=lambda door: door[0].__qualname__)
def test_a_door_is_open_to_what_belongs_there_and_shut_to_what_does_not(door):
    with warnings.catch_warnings(action="ignore"):  # of a measurement that is short
        door[0](**door[1])
    for name, value in wrong(door):
        with pytest.raises(ValueError) as error:
            door[0](**door[1] | {name: value})
            pytest.fail(f"{name} = {value!r} may pass")
        assert re.search(rf"\b{name}\b", str(error.value)), (name, value)
        assert len(str(error.value)) < 500, (name, value)


def test_every_exported_name_is_a_door_or_tested_elsewhere():
    doors = {door[0] for door in DOORS}
    missing = {name for name in rodlib.__all__ if getattr(rodlib, name) not in doors}
    assert missing <= ELSEWHERE
    assert len(rodlib.__all__) <= 70
