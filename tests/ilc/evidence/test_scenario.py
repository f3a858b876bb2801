"""The scenario bound: its equation in exact fractions, and the rate at which new plants fail."""

from fractions import Fraction
from math import comb
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.stats import binom

from rodlib.ilc import support, synthesise, violation_probability
from rodlib.ilc.evidence.scenario import scenario_bound
from rodlib.ilc.problem.problem import Cuts, Solution, largest_singular_values


@given(st.integers(1, 60), st.data(), st.sampled_from([1e-9, 1e-3, 0.5, 0.99]))
def test_the_bound_solves_its_equation(samples, data, beta):
    N, k = samples, data.draw(st.integers(0, samples - 1))

    def difference(t):
        left = sum(comb(m, k) * t ** (m - k) for m in range(k, N + 1))
        return Fraction(beta) / (N + 1) * left - comb(N, k) * t ** (N - k)

    epsilon = Fraction(scenario_bound(N, k, beta))
    nearby = Fraction(1, 10**12) * epsilon + Fraction(1, 2**52)
    assert difference(1 - epsilon - nearby) > 0 > difference(1 - epsilon + nearby)


def test_bounds_with_a_closed_form():
    assert scenario_bound(7, 7) == 1
    assert scenario_bound(1, 0, 0.1) == pytest.approx(1 - 0.1 / 1.9, rel=1e-12)
    t = 0.01 / (6 * (7 - 0.01))  # beta / (N + 1) (1 + N t) = N t
    assert scenario_bound(6, 5, 0.01) == pytest.approx(1 - t, rel=1e-12)


@pytest.mark.parametrize("samples", [20, 1000, 100_000])
@pytest.mark.parametrize("k", [1, 5, 15])
def test_to_wait_and_judge_costs_little_against_knowing_the_support_before(samples, k):
    """With at most k plants of support the violation has the tail of a binomial distribution."""
    known = brentq(
        lambda epsilon: binom.cdf(k - 1, samples, epsilon) - 1e-6, 1e-9, 1 - 1e-9
    )
    assert known < scenario_bound(samples, k) < min(1, 2.2 * known)


def test_the_bound_grows_with_the_support_and_falls_with_the_samples():
    in_k = [scenario_bound(500, k) for k in range(501)]
    in_N = [scenario_bound(N, 5) for N in (5, 6, 10, 100, 1000, 10**4, 10**5, 10**6)]
    assert np.all(np.diff(in_k) > 0) and np.all(np.diff(in_N) < 0)


def design(others, cuts):
    """What a synthesis has of its problem and solution, for so many other plants."""
    problem = SimpleNamespace(plants=np.empty((1 + others, 1, 1, 1)))
    return SimpleNamespace(
        problem=problem, solution=Solution(np.empty(0), None, None, 0, "", 0, cuts)
    )


def test_the_support_are_the_other_plants_with_multipliers():
    plant = np.array([0, 4, 2, 4, 7, 9])
    N = np.array([1, 0.5, 1e-3, 0.2, 1e-12, 0])[:, None, None] * np.ones((6, 2, 1))
    several = design(9, Cuts(plant, np.zeros(6, dtype=int), N, np.empty((6, 0))))
    assert support(several.solution).tolist() == [2, 4]
    assert violation_probability(several, 1e-3) == scenario_bound(9, 2, 1e-3)
    assert support(design(9, None).solution).size == 0
    with pytest.raises(ValueError, match="design is for one plant alone"):
        violation_probability(design(0, None))


def interval(plants):
    """The shortest interval around random numbers: two of them are its support."""
    return plants.min(), plants.max()


def test_new_plants_violate_a_scalar_program_no_more_often_than_said():
    """The violation is known here: what the interval misses. At beta = 0.1 and in 2000 designs."""
    rng = np.random.default_rng(0)
    ends = np.array([interval(rng.uniform(size=50)) for _ in range(2000)])
    violation = 1 - (ends[:, 1] - ends[:, 0])
    assert np.mean(violation > scenario_bound(50, 2, 0.1)) < 0.1


@pytest.mark.parametrize("m", [1, 2])
def test_fresh_plants_break_a_design_no_more_often_than_said(m):
    """First-order lags behind a coupling: the rate among 10,000 new ones, for five designs."""
    omega = np.linspace(0.05, np.pi, 12)
    z = np.exp(1j * omega)[:, None, None]
    Q = 1 / (1 + omega**4)

    def lags(count, rng):
        pole, gain = rng.uniform([[0.1], [0.7]], [[0.4], [1.3]], (2, count))[
            ..., None, None, None
        ]
        coupling = np.eye(m) + 0.1 * rng.standard_normal((count, 1, m, m))
        return (1 - pole) * gain / (z - pole) * coupling

    rng = np.random.default_rng(m)
    fresh, nominal, rates, bounds = (
        lags(10_000, rng),
        0.75 * np.eye(m) / (z - 0.25),
        [],
        [],
    )
    for _ in range(5):
        plants = [nominal, *lags(60, rng)]
        design = synthesise(plants, Q, omega, 1.0, order=2, objective="peak", L_max=5.0,
                            band=(0.05, 1.0))  # fmt: skip
        L = design.filter.frequency_response(omega)
        M = Q[:, None, None] * (np.eye(m) - fresh @ L)
        peaks = (
            largest_singular_values(M.reshape(-1, m, m))
            .reshape(len(fresh), -1)
            .max(axis=1)
        )
        rates.append(np.mean(peaks > design.certificate.grid_M))
        bounds.append(violation_probability(design, 1e-3))
        assert (
            1 <= len(support(design.solution)) < 2 * m * m + 2
        )  # one more than coefficients
    assert np.all(np.array(rates) < bounds)
    assert max(rates) > 0.01  # the design is not merely cautious
