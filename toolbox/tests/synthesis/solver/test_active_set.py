"""The warm start: it finds what a cold solve finds, in far fewer and cheaper steps."""

from dataclasses import replace

import numpy as np
import pytest
from paper import paper_choices
from plants import random_response

from ilctools import synthesise
from ilctools.problem.pose import pose
from ilctools.synthesis.design import solve
from ilctools.synthesis.formulate import formulate
from ilctools.synthesis.solver import active_set
from ilctools.synthesis.solver.active_set import (
    Iterate,
    first_multipliers,
    improve,
    model_at,
    resolve,
)


@pytest.fixture(scope="module")
def start(loop, Q, omega):
    """The paper's diagonal filter."""
    return synthesise(loop, Q, omega, **paper_choices())


@pytest.mark.parametrize("structure", ["diagonal", "full"])
def test_a_changed_bound_or_band_takes_a_few_steps(loop, Q, omega, structure):
    start = synthesise(loop, Q, omega, **paper_choices(structure=structure))
    for changes in ({"M_max": 0.88}, {"L_max": 40.0}, {"band": (1e-4, 0.05)}):
        choices = paper_choices(structure=structure, **changes)
        cold = synthesise(loop, Q, omega, **choices)
        warm = synthesise(loop, Q, omega, start=start, **choices)
        assert warm.value == pytest.approx(cold.value, rel=1e-9)
        assert warm.certificate.gap < 1e-8
        # A step costs about half of an iteration of the interior-point method.
        assert warm.solution.method == "active set"
        assert warm.solution.iterations <= 0.6 * cold.solution.iterations


@pytest.mark.parametrize("seed", [0, 7])
def test_a_corrected_step_meets_curved_bounds_to_second_order(seed, monkeypatch):
    """Relaxed by h, they are passed by some h^2 with the first step, by next to nothing then."""
    P, Q, omega = random_response(seed, 2)
    arguments = {"order": 3, "M_max": 0.97, "structure": "full", "band": (0.01, 0.3)}
    start = solve(pose(P, Q, omega, 1.0, L_max=10.0, **arguments))

    def passed(h):
        problem = formulate(pose(P, Q, omega, 1.0, L_max=10.0 * (1 + h), **arguments))
        tried = []

        def recorded(problem, x, splits):
            tried.append(Iterate(problem, x, splits))
            return tried[-1]

        p = Iterate(problem, problem.unknowns(start.coefficients))
        model = model_at(problem, p, first_multipliers(problem, start))
        monkeypatch.setattr(active_set, "Iterate", recorded)
        improve(problem, p, model, np.full(2, 1e9), 0.0)  # a penalty that refuses the first
        return [p.sigma[1].max() / p.limits[1] - 1 for p in tried[:2]]

    (first, corrected), (first_of_half, _) = passed(0.02), passed(0.01)
    assert first > 1e-7 and first / first_of_half == pytest.approx(4, rel=0.05)
    assert abs(corrected) < 0.1 * first  # of third order, h times as much


def test_at_an_optimum_one_step_is_enough_and_from_zero_none_is(start):
    """At L = 0 all singular values coincide."""
    program, optimum = formulate(start.problem), start.solution
    step = resolve(program, optimum, 1)
    assert step.iterations == 1 and step.method == "active set"
    np.testing.assert_allclose(step.coefficients, optimum.coefficients, atol=1e-5)
    zero = {name: 0 * getattr(optimum, name) for name in ("coefficients", "U", "V")}
    assert resolve(program, replace(optimum, **zero), 12) is None


def test_what_the_method_returns_is_judged_more_strictly(loop, Q, omega, start, monkeypatch):
    """With multipliers a little off, its result is discarded for that of the cold solve."""

    def careless(*arguments, **more):
        solution = resolve(*arguments, **more)
        U, V = (1 - 1e-7) * solution.U, (1 - 1e-7) * solution.V
        return replace(solution, U=U, V=V)

    monkeypatch.setattr(active_set, "resolve", careless)
    design = synthesise(loop, Q, omega, start=start, **paper_choices(L_max=49.0))
    assert design.solution.method == "interior point" and design.certificate.gap < 1e-8


def test_a_start_that_does_not_fit_is_refused_or_makes_no_difference(loop, Q, omega, start):
    with pytest.raises(ValueError, match=r"shape \(2, 2, 10\).* have \(2, 2, 9\)"):
        synthesise(loop, Q, omega, order=9, start=start)
    grid, choices = omega[::4], paper_choices()
    cold = synthesise(loop, Q, grid, **choices).value
    full = synthesise(loop, Q, grid, **choices | {"structure": "full"})
    for before in (start, full):
        warm = synthesise(loop, Q, grid, start=before, **choices).value
        assert warm == pytest.approx(cold, rel=1e-9)


def test_where_the_quick_quadratic_solver_gives_up_another_finds_the_same(monkeypatch):
    rng = np.random.default_rng(3)
    half, A = rng.standard_normal((5, 5)), rng.standard_normal((8, 6))
    model = active_set.Model(half @ half.T, np.append(rng.standard_normal(5), 1), A, None, [], 1.0)
    room = rng.uniform(0.1, 1, 8)
    quick = active_set.quadratic_program(model, room, 0.0)
    nothing = np.full(6, np.nan), np.full(8, np.nan)
    monkeypatch.setattr(active_set, "_by_active_set", lambda *_: nothing)
    slow = active_set.quadratic_program(model, room, 0.0)
    for one, other in zip(quick, slow, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-7)
    contradiction = replace(model, A=np.vstack([A[:1], -A[:1]]))
    assert active_set.quadratic_program(contradiction, np.array([-1.0, -1.0]), 0.0) is None
