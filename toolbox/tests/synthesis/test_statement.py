"""The CVXPY statement; how it compares with the structured solver is in test_interior_point."""

import numpy as np
import pytest
from problems import plant, posed

from ilctools.evidence.optimality import lower_bound
from ilctools.synthesis.formulate import formulate
from ilctools.synthesis.solver.program import Infeasible
from ilctools.synthesis.statement import solve


@pytest.mark.parametrize(
    ("structure", "objective", "L_max"),
    [("diagonal", "sum", 5.0), ("full", "peak", 5.0), ("full", "sum", None)],
)
def test_its_multipliers_prove_its_optimum(structure, objective, L_max):
    P, Q, omega = plant(2)
    problem = posed(P, Q, omega, structure, objective, L_max)
    solution = solve(formulate(problem))
    z = np.exp(1j * np.outer(omega, np.arange(1, 5)))
    M = Q[:, None, None] * (np.eye(2) - P @ np.einsum("ijk,nk->nij", solution.coefficients, z))
    sigma = np.linalg.norm(M, 2, axis=(1, 2))
    value = sigma[omega < 1].sum() if objective == "sum" else sigma.max()
    bound = lower_bound(problem, solution.U, solution.V)
    assert value * (1 - 1e-4) < bound < value * (1 + 1e-9)  # so accurate is Clarabel
    assert solution.largest == pytest.approx(sigma.max())
    assert "Clarabel" in solution.method and solution.iterations > 3


def test_what_is_infeasible_is_said_to_be():
    P, Q, omega = plant(2)
    with pytest.raises(Infeasible) as error:
        solve(formulate(posed(P, Q, omega, "diagonal", M_max=0.05)))
    peak = solve(formulate(posed(P, Q, omega, "diagonal", "peak"))).largest
    assert error.value.nearest.largest == pytest.approx(peak, rel=1e-6)
