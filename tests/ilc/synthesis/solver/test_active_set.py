"""The warm start: it finds what a cold solve finds, in far fewer and cheaper steps."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import random_response

from rodlib import InfeasibleError, synthesise
from rodlib.ilc.problem.pose import pose
from rodlib.ilc.synthesis.design import solve
from rodlib.ilc.synthesis.formulate import formulate
from rodlib.ilc.synthesis.solver import active_set
from rodlib.ilc.synthesis.solver.active_set import (
    Iterate,
    first_multipliers,
    improve,
    model_at,
    resolve,
)

CHANGES = [
    *({"M_max": value} for value in (0.97, 0.88)),
    {"L_max": 40.0},
    {"band": (1e-4, 0.05)},
]


@pytest.fixture(scope="module", params=["diagonal", "full"])
def before(request, loop, Q, omega):
    return request.param, synthesise(loop, Q, omega, 1.0, structure=request.param)


@pytest.mark.parametrize("changes", CHANGES, ids=str)
def test_a_changed_bound_or_band_takes_a_few_steps(before, loop, Q, omega, changes):
    structure, start = before
    cold = synthesise(loop, Q, omega, 1.0, structure=structure, **changes)
    warm = synthesise(loop, Q, omega, 1.0, structure=structure, start=start, **changes)
    assert warm.value == pytest.approx(cold.value, rel=1e-9)
    assert warm.certificate.gap < 1e-8
    # A step costs about half of an iteration of the interior-point method.
    assert warm.solution.method == "active set"
    assert warm.solution.iterations <= 0.6 * cold.solution.iterations


@pytest.mark.filterwarnings("ignore:the filter leaves")
@pytest.mark.filterwarnings("ignore:the samples are too coarse")
@settings(max_examples=6)
@given(
    st.integers(1, 3),
    st.sampled_from([1, 3, 8]),
    st.sampled_from(["diagonal", "full"]),
    st.sampled_from(["sum", "peak"]),
    st.sampled_from([1e-6, 1.0, 1e6]),
    st.sampled_from([0.8, 1.02, 2.0]),
    st.integers(0, 999),
)
def test_random_responses(m, order, structure, objective, gain, change, seed):
    """A start never changes the result, whatever the plant, its unit and the change."""
    P, Q, omega = random_response(seed, m, gain=gain)
    arguments = {
        "order": order,
        "band": (0.01, 0.3),
        "structure": structure,
        "M_max": 0.97,
    }
    arguments |= {"objective": objective}
    try:
        start = synthesise(P, Q, omega, 1.0, L_max=10.0 / gain, **arguments)
        cold = synthesise(P, Q, omega, 1.0, L_max=change * 10.0 / gain, **arguments)
    except InfeasibleError:
        return
    warm = synthesise(
        P, Q, omega, 1.0, L_max=change * 10.0 / gain, start=start, **arguments
    )
    assert warm.value == pytest.approx(cold.value, rel=1e-8, abs=1e-9)
    assert warm.certificate.failures == []


@pytest.mark.parametrize("seed", [0, 1, 4, 7])
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
        improve(
            problem, p, model, np.full(2, 1e9), 0.0
        )  # a penalty that refuses the first
        return [p.sigma[1].max() / p.limits[1] - 1 for p in tried[:2]]

    (first, corrected), (first_of_half, _) = passed(0.02), passed(0.01)
    assert first > 1e-7 and first / first_of_half == pytest.approx(4, rel=0.05)
    assert abs(corrected) < 0.1 * first  # of third order, h times as much


def test_at_an_optimum_one_step_is_enough(loop, Q, omega):
    design = synthesise(loop, Q, omega, 1.0)
    start = design.solution
    found = resolve(formulate(design.problem), start, 1)
    assert found.iterations == 1 and found.method == "active set"
    np.testing.assert_allclose(found.coefficients, start.coefficients, atol=1e-5)


def test_where_the_method_does_not_converge_it_says_so(loop, Q, omega):
    """From L = 0, where all singular values coincide."""
    P = loop.frequency_response(omega)
    start = synthesise(loop, Q, omega, 1.0)
    zero = type(start.solution)(
        0 * start.filter.coefficients, 0 * P, 0 * P, 1.0, "none", 0
    )
    assert resolve(formulate(start.problem), zero, 12) is None


def test_what_the_method_returns_is_judged_more_strictly(loop, Q, omega, monkeypatch):
    """With multipliers a little off, its result is discarded for that of the cold solve."""
    start = synthesise(loop, Q, omega, 1.0)
    calls = []

    def careless(*arguments, **more):
        found = resolve(*arguments, **more)
        calls.append(found)
        return replace(found, U=found.U * (1 - 1e-7), V=found.V * (1 - 1e-7))

    monkeypatch.setattr(active_set, "resolve", careless)
    design = synthesise(loop, Q, omega, 1.0, start=start, L_max=49.0)
    assert len(calls) == 2 and None not in calls
    assert design.solution.method == "interior point" and design.certificate.gap < 1e-8


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"order": 9}, r"coefficients of shape \(2, 2, 10\).*must have \(2, 2, 9\)"),
        (
            {"omega": slice(None, None, 2)},
            "on 1000 frequencies, but must have .* on 500",
        ),
    ],
)
def test_a_start_that_does_not_fit_is_refused(loop, Q, omega, changes, message):
    start = synthesise(loop, Q, omega, 1.0)
    grid = omega[changes.pop("omega", slice(None))]
    with pytest.raises(ValueError, match=message):
        synthesise(loop, Q, grid, 1.0, start=start, **changes)


def test_a_full_filter_is_no_start_for_a_diagonal_one(loop, Q, omega):
    start = synthesise(loop, Q, omega, 1.0, structure="full")
    with pytest.raises(ValueError, match="start is a full filter"):
        synthesise(loop, Q, omega, 1.0, start=start)


def test_where_the_quick_quadratic_solver_gives_up_another_finds_the_same(monkeypatch):
    rng = np.random.default_rng(3)
    half, A = rng.standard_normal((5, 5)), rng.standard_normal((8, 6))
    model = active_set.Model(
        half @ half.T, np.append(rng.standard_normal(5), 1), A, None, [], 1.0
    )
    room = rng.uniform(0.1, 1, 8)
    quick = active_set.quadratic_program(model, room, 0.0)
    nothing = np.full(6, np.nan), np.full(8, np.nan)
    monkeypatch.setattr(active_set, "_by_active_set", lambda *_: nothing)
    slow = active_set.quadratic_program(model, room, 0.0)
    for one, other in zip(quick, slow, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-7)
    contradiction = replace(model, A=np.vstack([A[:1], -A[:1]]))
    assert (
        active_set.quadratic_program(contradiction, np.array([-1.0, -1.0]), 0.0) is None
    )
