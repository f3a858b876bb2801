"""The statement in CVXPY, and that the toolbox's solver finds the same."""

import numpy as np
import pytest
from paper import paper_choices
from plants import half, random_response, response_of, sigma_of_M
from problems import plant

from ilctools import synthesise
from ilctools.synthesis.statement import statement

pytestmark = pytest.mark.filterwarnings("ignore:.*between the frequencies omega")


def of_a_lag(m):
    P, Q, omega = plant(m, grid=np.linspace)
    return P, Q, omega, {"order": 4, "M_max": 0.9, "L_max": 5.0, "band": (1e-3, 1)}


def of_random_plants(m):
    P, Q, omega = random_response(m, m)
    return P, Q, omega, {"order": 3, "M_max": 0.97, "L_max": None, "band": (0.01, 0.3)}


@pytest.mark.parametrize(
    ("case", "m", "structure", "objective"),
    half([of_a_lag, of_random_plants], [1, 2, 3], ["diagonal", "full"], ["sum", "peak"]),
)
def test_synthesise_finds_its_optimum(case, m, structure, objective):
    P, Q, omega, choices = case(m)
    choices |= {"structure": structure, "objective": objective}
    coefficients, value = statement(P, Q, omega, 1.0, **choices)
    sigma_M = sigma_of_M(omega, P, Q, response_of(coefficients, omega))
    in_band = (omega >= choices["band"][0]) & (omega <= choices["band"][1])
    reached = sigma_M[in_band].sum() if objective == "sum" else sigma_M.max()
    assert reached == pytest.approx(value, rel=1e-5)
    assert sigma_M.max() <= choices["M_max"] * (1 + 1e-6)
    assert synthesise(P, Q, omega, 1.0, **choices).value == pytest.approx(value, rel=1e-5)


@pytest.mark.parametrize(("structure", "objective"), [("diagonal", "sum"), ("full", "peak")])
def test_it_is_that_of_the_papers_problems(loop, Q, structure, objective):
    # so fine at the end that the bound on L needs no more
    omega = np.union1d(np.geomspace(1e-4, 0.1, 30), np.linspace(0.1, np.pi, 30))
    choices = paper_choices(structure=structure, objective=objective)
    P, of_Q = loop.frequency_response(omega), Q.frequency_response(omega)
    _, value = statement(P, of_Q, omega, 1.0, **choices)
    design = synthesise(P, of_Q, omega, 1.0, **choices)
    assert design.value == pytest.approx(value, rel=1e-6)
    assert design.certificate.gap < 1e-6


def test_what_is_infeasible_has_no_value():
    P, Q, omega, choices = of_a_lag(2)
    coefficients, value = statement(P, Q, omega, 1.0, **choices | {"M_max": 0.05})
    assert value == np.inf and np.isnan(coefficients).all()
