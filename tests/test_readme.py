"""The README's snippets: run in order, in one namespace and an empty folder."""

import re
import shutil
from contextlib import nullcontext

import numpy as np
import pytest

from rodlib import load_log
from rodlib.ilc.laboratory import law_of, loop_of
from rodlib.ilc.laboratory.temperature_control_lab import heat_balance
from rodlib.ilc.problem import convergence_matrix, largest_singular_values
from rodlib.ilc.trials import rms
from rodlib.paper.repository import ROOT

SNIPPETS = re.findall(
    r"^```python\n(.*?)^```$",
    (ROOT / "README.md").read_text(encoding="utf-8"),
    flags=re.MULTILINE | re.DOTALL,
)


@pytest.fixture(scope="module")
def left(tmp_path_factory):
    """The namespace after each snippet; what a reader brings along is put into the folder."""
    pytest.importorskip("tclab")
    folder = tmp_path_factory.mktemp("reader")
    shutil.copy(ROOT / "data" / "stage" / "closed-loop.csv", folder)
    error = np.sin(np.linspace(0, 2 * np.pi, 500))
    np.savetxt(folder / "last-trial.csv", np.column_stack([0 * error, error]), delimiter=",")
    namespace, states = {}, []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for number, snippet in enumerate(SNIPPETS):
            with pytest.warns(match="the loop is not linear") if number == 3 else nullcontext():
                exec(snippet, namespace)
            states.append(dict(namespace))
        states[2]["found"] = load_log("my-rig.csv")
    return states


def test_there_are_four_ways_in_and_one_step_further(left):
    assert len(SNIPPETS) == 5
    for state, channels in zip(left[:4], (1, 3, 2, 2), strict=True):
        design = state["design"]
        assert not design.certificate.failures
        assert len(design.filter.coefficients) == channels
        assert design.sigma_M.max() < 0.9 and design.sigma_L.max() < design.problem.L_max * 1.000001


def test_from_a_table_comes_the_next_trials_signal(left):
    state = left[0]
    expected = state["Q"].apply(state["design"].filter.apply(state["e"]))
    assert state["v_next"].shape == (500, 1) and np.abs(expected).max() > 0
    np.testing.assert_allclose(state["v_next"], expected, rtol=0, atol=1e-12)


def test_from_parameters_come_trials_that_converge(left):
    errors = rms(left[1]["trials"].e).values
    assert errors[0] > 1 and errors[-1] < 0.01 * errors[0]
    assert left[1]["loop"].disturbances == ["Q2", "Q4", "Q6", "theta_a"]


def test_on_the_emulator_a_log_is_recorded(left):
    state = left[2]
    errors = rms(state["log"].e).values
    assert errors[0] > 1 and np.all(errors[1:] < 0.32)  # a step of its thermometers
    found = state["found"]
    assert np.array_equal(found.y, state["log"].y)
    Q, L = law_of(found)
    assert state["Q"] == Q and np.array_equal(L.coefficients, state["design"].filter.coefficients)
    assert loop_of(found).controls == ["Q1", "Q2"]


def test_without_a_model_the_bound_holds_on_the_emulator(left):
    """For its own heat balance, with the parameters in its source."""
    state = left[3]
    own = heat_balance(200 / 5720, 100 / 5720, 1 / 20, 1 / 100, 140.0, 2.0)
    L = state["design"].filter.frequency_response(state["omega"])
    P = state["loop"].frequency_response(state["omega"], own)
    S = state["design"].problem.scale
    M = convergence_matrix(P, state["Q"].frequency_response(state["omega"]), L) * S / S[:, None]
    assert largest_singular_values(M).max() < state["design"].certificate.grid_M


def test_for_many_plants_the_bounds_hold(left):
    left = left[-1]
    robust, within = left["robust"], left["design"]
    assert not robust.certificate.failures and not within.certificate.failures
    assert len(robust.problem.others) == 200 and within.problem.radius is not None
    P = np.stack([robust.problem.plant(k) for k in range(0, 201, 20)])
    L = robust.filter.frequency_response(left["omega"])
    response = left["Q"].frequency_response(left["omega"])
    M = response[:, None, None] * (np.eye(2) - P @ L)
    assert np.linalg.norm(M, 2, axis=(2, 3)).max() <= 0.95 * (1 + 1e-9)
    assert 0 < left["violation_probability"](robust) < 0.2
