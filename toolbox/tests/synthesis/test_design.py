"""Designs whose optimum is known, and what is said where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paper import paper_choices
from plants import lags, random_response
from problems import posed

from ilctools import InfeasibleError, synthesise
from ilctools.errors import SolverError
from ilctools.evidence.certificate import certify
from ilctools.models import frequency_response
from ilctools.synthesis.design import refuse_failures
from ilctools.synthesis.everywhere import solve_everywhere


@pytest.mark.parametrize(
    ("factor", "complaint"),
    [(1.001, r"sigma_max\(L\) is 50\.0[45]"), (0.9, "the relative duality gap is")],
)
def test_a_wrong_filter_is_not_returned(loop, Q, factor, complaint):
    """The check does not trust the solver: a filter out of bounds, or not optimal, raises."""
    omega = np.geomspace(1e-4, np.pi, 250)
    problem = posed(loop, Q, omega, 1.0, **paper_choices(band=(1e-4, 0.01)))
    grid, solution = solve_everywhere(problem)
    refuse_failures(certify(problem, grid, solution))
    dishonest = replace(solution, coefficients=solution.coefficients * factor)
    with pytest.raises(SolverError, match=complaint):
        refuse_failures(certify(problem, grid, dishonest))


@settings(max_examples=5)
@given(st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_a_plant_that_one_step_inverts_is_inverted(m, seed):
    """P = G z^-1 has the learning filter G^-1 z, with M = 0."""
    G = np.random.default_rng(seed).standard_normal((m, m)) + 3 * np.eye(m)
    omega = np.linspace(0.1, np.pi, 12)
    P = G * np.exp(-1j * omega)[:, None, None]
    arguments = {"order": 2, "L_max": None, "band": (0.1, 3), "structure": "full"}
    design = synthesise(P, np.ones(12), omega, 1.0, **arguments)
    assert design.value < 1e-5
    np.testing.assert_allclose(design.filter.coefficients[:, :, 0], np.linalg.inv(G), atol=1e-4)


@pytest.mark.parametrize(
    ("changes", "remedy"),
    [
        ({"order": 11, "structure": "diagonal"}, "a longer filter, or a full one, lower"),
        ({"M_max": 0.6, "L_max": 0.2}, "M_max is 0.79.* Raise M_max or L_max"),
        ({"L_max": None}, r"M_max is 0.5(00001)?; .* Raise M_max, take"),  # rounded up
    ],
)
def test_what_cannot_help_is_not_advised(changes, remedy):
    """Delay and zero of (1 - 2 / z) / z^11: on equal steps the mean of M is one up to order 11.

    Its inverse is -(z^12 / 2 + z^13 / 4 + ...), of which the first term leaves one half.
    """
    omega = (np.arange(200) + 0.5) * np.pi / 200
    z = np.exp(1j * omega)[:, None, None]
    arguments = {"order": 12, "M_max": 0.3, "L_max": 30.0, "band": (0.1, 1)} | changes
    with pytest.raises(InfeasibleError, match=remedy):
        synthesise((1 - 2 / z) / z**11, np.ones(200), omega, 1.0, **arguments)


def test_what_is_not_learned_at_one_frequency_is_learned_at_others():
    omega = np.linspace(0.05, 3, 50)
    P, Q = frequency_response(lags(), omega), 1 / (1 + omega**4)
    Q[3] = 0
    design = synthesise(P, Q, omega, 1.0, order=3, band=(0.05, 1), structure="full")
    assert design.sigma_M[3] == 0 and design.certificate.gap < 1e-8


def test_what_stands_in_the_way_is_named():
    """A plant of the wrong sign cannot be learned together with the nominal one."""
    P, Q, omega = random_response(1, 2)
    with pytest.raises(InfeasibleError, match="the main obstacle is plant 2 at") as error:
        synthesise([P, 1.1 * P, -P], Q, omega, 1.0, order=3, L_max=8.0, band=(0.01, 0.3))
    assert error.value.plant == 2 and error.value.omega in omega
    assert error.value.smallest_M_max >= Q.max() * (1 - 1e-6)
