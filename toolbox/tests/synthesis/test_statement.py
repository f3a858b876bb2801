"""The statement in CVXPY, and that the toolbox's solver finds the same."""

import numpy as np
import pytest
from plants import half, random_response, response_of, sigma_of_M

from ilctools import synthesise
from ilctools.synthesis.statement import statement

pytestmark = pytest.mark.filterwarnings("ignore:.*between the frequencies omega")


CHOICES = {"order": 3, "M_max": 0.97, "band": (0.01, 0.3)}


@pytest.mark.parametrize(
    ("L_max", "m", "structure", "objective"),
    half([0.5, None], [1, 2, 3], ["diagonal", "full"], ["sum", "peak"]),
)
def test_synthesise_finds_its_optimum(L_max, m, structure, objective):
    P, Q, omega = random_response(m, m)
    choices = CHOICES | {"L_max": L_max, "structure": structure, "objective": objective}
    coefficients, value = statement(P, Q, omega, 1.0, **choices)
    sigma_M = sigma_of_M(omega, P, Q, response_of(coefficients, omega))
    in_band = (omega >= 0.01) & (omega <= 0.3)
    reached = sigma_M[in_band].sum() if objective == "sum" else sigma_M.max()
    assert reached == pytest.approx(value, rel=1e-5)
    assert sigma_M.max() <= 0.97 * (1 + 1e-6)
    design = synthesise(P, Q, omega, 1.0, **choices)
    assert design.value == pytest.approx(value, rel=1e-5)
    assert L_max is None or design.certificate.grid_L > 0.99 * L_max  # it counts


def test_what_is_infeasible_has_no_value():
    coefficients, value = statement(
        *random_response(2, 2), 1.0, **CHOICES | {"M_max": 0.5}, L_max=0.1
    )
    assert value == np.inf and np.isnan(coefficients).all()
