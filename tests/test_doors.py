"""What does not belong at a public door is refused by an error that names the argument."""

import re
import warnings
from inspect import Parameter, signature
from pathlib import Path
from tempfile import TemporaryDirectory

import control
import documented
import numpy as np
import pytest
import xarray as xr

import ilctools
import rodlib
from rodlib import Rod

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
SPREAD = rodlib.Spread.of_all(0.1)
SPECIMEN = rodlib.draw(SPREAD, 0)
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

# Values of each wrong kind, by the name of the argument. Each argument of a door stands here, or in
# LEFT_OUT.
THING, MODEL = [1.5], [1.5, "P"]
POSITIVE, WHOLE = ["1", np.nan, -1.0, [1.0]], ["1", 1.5, -1]
ARRAY = ["1", np.full((6, 1), np.nan), np.zeros((0, 1))]
WRONG = {
    name: values
    for values, names in (
        (
            THING,
            """rod nominal specimens spread parameters element known rig excitation loop law L Q
            problem log path time stop note delay of Qs Rs Qo Ro base everywhere objective reset
            limits units sizes outputs measured disturbance disturbances executor""",
        ),
        (MODEL, "P plant system model"),
        (
            POSITIVE,
            """Ts cutoff conductivity density M_max L_max weight gain length width height
            heat_capacity heat_transfer limit noise quantum fan sink_capacity convection emissivity
            temperature reach share pilot lowest highest amplitude hours lag steepness duration""",
        ),
        (
            WHOLE,
            """degree cells modes order samples trials sections realisations decimals number root
            lines seed rest pause""",
        ),
        (
            ARRAY,
            """omega s signal v e y errors reference coefficients gains heat_flows sensors
            deviations plateaus flows""",
        ),
        ([1.5, "1"], "first trial scale initial_state"),
        (["1", -1.0], "uncertainty"),
        (["1", np.nan], "ambient_rate"),
        ([1.5, "y", ["u", "u"]], "controls inputs learned"),
        ([1.5, "y", {"w": "none"}], "references"),
        ([1.5, "mirror"], "structure ends between"),
        ([0.1, (1.0, 0.1), ("a", 1.0)], "band"),
        ([0.1, (0.0, 1.0), ("a", 1.0)], "L_high"),
    )
    for name in names.split()
}

# What no case here tries, with the reason.
LEFT_OUT = {
    "choices": "least_gain passes them on to the checks of synthesise",
    "options": "read_table passes them on to pandas.read_csv",
    "u": "only a law with limits reads it: toolbox/tests/law/test_limits.py",
    "applied": "only a law with limits reads it: toolbox/tests/law/test_limits.py",
    "region": "Synthesis.law gives it, not a user",
    "labels": "Synthesis.law gives it, not a user",
    "output_limits": "Synthesis.law gives it, not a user",
    "past": "only a law with limits of outputs reads it: toolbox/tests/law/test_output_limits.py",
}

# What belongs there, by the name of the argument; what has a default keeps it.
RIGHT = {
    "rod": Rod(), "s": [1j], "omega": OMEGA, "Ts": 1.0, "cells": 2, "samples": 6, "trials": 2,
    "share": 0.1, "gains": np.ones(4), "deviations": np.zeros(10), "spread": SPREAD, "number": 1,
    "specimens": [SPECIMEN], "heat_flows": np.zeros(4), "P": P, "Q": Q, "L": L, "law": LAW,
    "loop": LOOP, "plant": PLANT, "system": PLANT, "controls": ["u"], "order": 2, "cutoff": 0.1,
    "signal": SIGNAL, "v": SIGNAL, "reference": SIGNAL, "coefficients": L.coefficients,
    "weight": 1.0, "e": xr.DataArray(SIGNAL, dims=("time", "channel")),
    "problem": DESIGN.problem, "rig": RIG, "excitation": EXCITATION,
}  # fmt: skip

# What else does not belong at a door.
FURTHER = {
    Rod: {"density": [1e12], "sections": [0, 1001], "sensors": [(0.1, 0.5), ()]},
    rodlib.midr: {"degree": [0, 21]},
    rodlib.sampled_response: {"omega": [[-1e-3], [3.2]], "Ts": [0.0, 1e-7]},
    rodlib.finite_volumes: {"cells": [0, 1001]},
    rodlib.paper_loop: {"rod": [Rod(sections=3), Rod(sensors=(0.1,))], "Ts": [1e-5, 1e4, np.inf]},
    rodlib.assumed_reference: {"samples": [0], "steepness": [0.0, 0.69], "plateaus": [(10.0, 6.0)]},
    rodlib.assumed_disturbance: {
        "samples": [0],
        "trials": [0],
        "first": [0, -1],
        "flows": [(5.0,)],
        "duration": [0.0, 0.71],
    },
    rodlib.Spread: {"density": [1.0], "gains": [-0.1], "sensors": [-0.1]},
    rodlib.Spread.of_all: {"share": [-0.1, 1.0]},
    SPREAD.specimen: {"deviations": [np.zeros(9)]},
    rodlib.responses: {"specimens": [[], [Rod()]], "loop": [LOOP]},
    rodlib.RigParameters: {"modes": [10_001]},
    ilctools.LearningFilter: {"first": [10**7]},
    ilctools.trial_norm: {"rest": [6]},
    ilctools.read_table: {"time": ["none"], "inputs": [{"u": "none"}]},
}

# Tested with their own files, or not called by themselves.
TESTED = """InfeasibleError Rig TemperatureControlLab
    heat_balance open_workbench plot paper_choices
    state_sequence try_out"""
ELSEWHERE = {*TESTED.split()}

# What does belong at a door, if the name of the argument does not say it.
OWN = {
    rodlib.responses: {"loop": PAPER},
    LAW.next: {"e": SIGNAL},
    ilctools.transfer: {"trials": LOG, "reference": np.ones((70, 1))},
    ilctools.ClosedLoop: {"P": P},
    ilctools.current_trial_loop: {"controls": ["u"]},
    ilctools.synthesise: ASKED,
    ilctools.least_gain: {"P": LOOP, "omega": OMEGA, "Ts": 1.0},
    DESIGN.check: {"P": LOOP},
    ilctools.convergence: {"P": LOOP},
    ilctools.replay: {"trials": RECORD},
    ilctools.read_table: {"path": TABLE, "time": "t", "inputs": {"u": "u"}, "outputs": {"y": "y"}},
    ilctools.multisine: SHAKE,
    ilctools.record: {"loop": PAPER, "law": ilctools.Law(Q, L2), "reference": SIGNAL * [0, 0]},
    ilctools.shake: {"loop": PAPER},
    ilctools.measured_response: {"log": control.frd(L.frequency_response(OMEGA).T, OMEGA)},
    ilctools.save_law: {"path": LAW_FILE},
    ilctools.load_law: {"path": LAW_FILE},
    ilctools.save_log: {"trials": RECORD, "path": LOG_FILE},
    ilctools.load_log: {"path": LOG_FILE},
    ilctools.law_of: {"trials": RECORD},
}
DOORS = [
    *(documented.door(name) for name in documented.DOORS if name not in ELSEWHERE),
    rodlib.Spread.of_all,
    SPREAD.specimen,
    RIG.apply,
    Q.apply,
    L.frequency_response,
    LAW.next,
    DESIGN.check,
]
CASES = [*((door, OWN.get(door, {})) for door in DOORS)]
CASES.append((ilctools.synthesise, ASKED | {"band": None, "reference": SIGNAL + 1}))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case[0].__qualname__)
def test_a_door_is_open_to_what_belongs_there_and_shut_to_what_does_not(case):
    (door, own), further = case, FURTHER.get(case[0], {})
    arguments = signature(door).parameters
    names = {*arguments} - {*LEFT_OUT}
    assert not names - {*WRONG}, "name them in WRONG, or in LEFT_OUT with the reason"
    needed = [name for name in names if arguments[name].default is Parameter.empty]
    right = {name: RIGHT[name] for name in needed if name not in own} | own
    with warnings.catch_warnings(action="ignore"):  # of a measurement that is short
        door(**right)
    for name in names:
        for value in [*WRONG[name], *further.get(name, [])]:
            with pytest.raises(ValueError) as error:
                door(**right | {name: value})
                pytest.fail(f"{name} = {value!r} may pass")
            assert re.search(rf"\b{name}\b", str(error.value)), (name, value)
            assert len(str(error.value)) < 500, (name, value)


def test_what_is_tested_elsewhere_is_exported_and_names_are_few():
    assert {*documented.DOORS} >= ELSEWHERE
    assert len(rodlib.__all__) <= 28 and len(ilctools.__all__) <= 46
