"""The scenario bound: its equation in exact fractions, and the rate at which new plants fail."""

from fractions import Fraction
from math import comb
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import sigma_of_M

from ilctools import synthesise, violation_probability
from ilctools.evidence.scenario import scenario_bound, support
from ilctools.problem.problem import Cuts, Solution


@given(st.integers(1, 60), st.data(), st.sampled_from([1e-9, 1e-3, 0.5, 0.99]))
def test_the_bound_solves_its_equation(samples, data, beta):
    N, k = samples, data.draw(st.integers(0, samples - 1))

    def difference(t):
        left = sum(comb(m, k) * t ** (m - k) for m in range(k, N + 1))
        return Fraction(beta) / (N + 1) * left - comb(N, k) * t ** (N - k)

    epsilon = Fraction(scenario_bound(N, k, beta))
    nearby = Fraction(1, 10**10)  # brentq's tolerance of log t, and rounding of logarithms
    assert difference(1 - epsilon - nearby) > 0 > difference(1 - epsilon + nearby)
    assert scenario_bound(N, N, beta) == 1


def design(others, cuts):
    """What a synthesis has of its problem and solution, for so many other plants."""
    problem = SimpleNamespace(plants=np.empty((1 + others, 1, 1, 1)), base=None)
    solution = Solution(np.empty(0), None, None, 0, 0, cuts)
    return SimpleNamespace(problem=problem, solution=solution)


def test_the_support_are_the_other_plants_with_multipliers():
    plant = np.array([0, 4, 2, 4, 7, 9])
    N = np.array([1, 0.5, 1e-3, 0.2, 1e-12, 0])[:, None, None] * np.ones((6, 2, 1))
    several = design(9, Cuts(plant, np.zeros(6, dtype=int), N))
    assert support(several.solution).tolist() == [2, 4]
    assert violation_probability(several, 1e-3) == scenario_bound(9, 2, 1e-3)
    assert support(design(9, None).solution).size == 0
    with pytest.raises(ValueError, match="one plant alone"):
        violation_probability(design(0, None))


def test_fresh_plants_break_a_design_no_more_often_than_said():
    """First-order lags behind a coupling: the rate among 3,000 new ones, for two designs."""
    omega = np.linspace(0.05, np.pi, 12)
    z = np.exp(1j * omega)[:, None, None]
    Q = 1 / (1 + omega**4)
    asked = {"order": 2, "objective": "peak", "L_max": 5.0, "band": (0.05, 1.0)}

    def lags(count, rng):
        pole = rng.uniform(0.1, 0.4, (count, 1, 1, 1))
        gain = rng.uniform(0.7, 1.3, (count, 1, 1, 1))
        coupling = np.eye(2) + 0.1 * rng.standard_normal((count, 1, 2, 2))
        return (1 - pole) * gain / (z - pole) * coupling

    rng = np.random.default_rng(2)
    fresh, nominal, rates = lags(3_000, rng), 0.75 * np.eye(2) / (z - 0.25), []
    for _ in range(2):
        result = synthesise([nominal, *lags(60, rng)], Q, omega, 1.0, **asked)
        peaks = sigma_of_M(omega, fresh, Q, result.filter).max(axis=1)
        rates.append(np.mean(peaks > result.certificate.grid_M))
        assert rates[-1] < violation_probability(result, 1e-3)
        assert 1 <= len(support(result.solution)) < 10  # one more than coefficients
    assert max(rates) > 0.01  # the design is not merely cautious
