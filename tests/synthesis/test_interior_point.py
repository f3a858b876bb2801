"""The structured solver, by way of synthesise: against CVXPY, and where it gets hard."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rodlib import InfeasibleError, synthesise, zero_phase_butterworth
from rodlib.problem import pose
from rodlib.synthesis import interior_point
from rodlib.synthesis.program import formulate


def random_plant(seed, m, n=30, gain=1.0):
    """A stable plant with coupling, and a low-pass Q, on n frequencies up to Nyquist."""
    rng = np.random.default_rng(seed)
    omega = np.geomspace(1e-2, np.pi, n)
    z = np.exp(1j * omega)[:, None, None]
    poles = rng.uniform(0.3, 0.95, (m, m))
    P = np.eye(m) + 0.2 * rng.standard_normal((m, m))
    P = gain * P * (1 - poles) / (z - poles)
    return P, 1 / (1 + (omega / 0.5) ** 4), omega


@pytest.mark.parametrize("objective", ["sum", "peak"])
@pytest.mark.parametrize(
    ("m", "structure"), [(1, "full"), (2, "full"), (3, "diagonal"), (4, "full")]
)
def test_structured_and_cvxpy_find_the_same_optimum(m, structure, objective):
    P, Q, omega = random_plant(m, m, n=25)
    arguments = {"order": 3, "L_max": 20.0, "band": (0.01, 0.3), "M_max": 0.97}
    arguments |= {"structure": structure, "objective": objective}
    ours = synthesise(P, Q, omega, 1.0, **arguments)
    theirs = synthesise(P, Q, omega, 1.0, solver="cvxpy", **arguments)
    assert ours.value == pytest.approx(theirs.value, rel=1e-5)
    assert ours.certificate.gap < 1e-8
    assert theirs.certificate.gap < 1e-5


@pytest.mark.parametrize("objective", ["sum", "peak"])
@pytest.mark.parametrize("structure", ["diagonal", "full"])
def test_structured_and_cvxpy_agree_on_the_papers_problems(loop, Q, omega, structure, objective):
    grid = omega[::4]
    arguments = {"band": (grid[0], 0.02), "structure": structure, "objective": objective}
    ours = synthesise(loop, Q, grid, 1.0, **arguments)
    theirs = synthesise(loop, Q, grid, 1.0, solver="cvxpy", check=False, **arguments)
    assert ours.certificate.gap < 1e-8
    # Clarabel ends "almost solved"; its multipliers prove how good it and we are at least.
    assert theirs.certificate.lower_bound <= ours.value * (1 + 1e-9)
    assert abs(theirs.value / ours.value - 1) <= theirs.certificate.gap < 1e-4


@settings(max_examples=25)
@given(
    st.integers(1, 4),
    st.sampled_from([1, 2, 5, 10]),
    st.sampled_from(["diagonal", "full"]),
    st.sampled_from(["sum", "peak"]),
    st.sampled_from([1e-6, 1.0, 1e6]),
    st.integers(0, 999),
)
def test_every_filter_is_certified_or_refused_with_a_reason(
    m, order, structure, objective, gain, seed
):
    """Any size, order and scaling: a gap of 1e-8, and no bound passed by more than 1e-9."""
    P, Q, omega = random_plant(seed, m, gain=gain)
    L_max = 10.0 / gain
    arguments = {"order": order, "band": (0.01, 0.3), "structure": structure, "L_max": L_max}
    try:
        design = synthesise(P, Q, omega, 1.0, objective=objective, M_max=0.9, **arguments)
    except InfeasibleError:
        peak = synthesise(P, Q, omega, 1.0, objective="peak", M_max=0.999999, **arguments)
        assert peak.value > 0.9
        return
    certificate = design.certificate
    assert certificate.gap < 1e-8
    assert certificate.grid_M <= 0.9 * (1 + 1e-9)
    assert certificate.grid_L <= L_max * (1 + 1e-9)
    scaled = synthesise(P / gain, Q, omega, 1.0, objective=objective, **arguments | {"L_max": 10.0})
    assert design.value == pytest.approx(scaled.value, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("order", [1, 40])
@pytest.mark.parametrize("structure", ["diagonal", "full"])
def test_shortest_and_longest_filters_on_the_papers_plant(loop, Q, omega, order, structure):
    grid = omega[::4]
    arguments = {"band": (grid[0], 0.01), "structure": structure, "order": order, "M_max": 0.99995}
    design = synthesise(loop, Q, grid, 1.0, check=False, **arguments)
    assert design.certificate.gap < 1e-8 and design.certificate.grid_M < 1
    shorter = synthesise(loop, Q, grid, 1.0, **arguments | {"order": 1})
    assert design.value <= shorter.value * (1 + 1e-8)  # a longer filter can do all of a shorter


@pytest.mark.parametrize("margin", [1.001, 1.00001])
def test_nearly_infeasible_problems_are_solved(loop, Q, omega, margin):
    grid = omega[::4]
    arguments = {"band": (grid[0], 0.01), "L_max": 50.0}
    peak = synthesise(loop, Q, grid, 1.0, objective="peak", **arguments).value
    design = synthesise(loop, Q, grid, 1.0, M_max=peak * margin, **arguments)
    assert design.certificate.gap < 1e-7
    assert design.certificate.grid_M <= peak * margin * (1 + 1e-9)
    with pytest.raises(InfeasibleError) as error:
        synthesise(loop, Q, grid, 1.0, M_max=peak / margin, **arguments)
    assert f"smallest feasible M_max is {peak:.6g}" in str(error.value)


@pytest.mark.parametrize("objective", ["sum", "peak"])
@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_without_a_bound_filters_compete_up_to_a_gain_that_doubles_can_hold(
    loop, Q, omega, objective, unit
):
    """The limit counts in units of each input: a plant in other units has the same optimum."""
    P, U = loop.frequency_response(omega), np.diag([1.0, unit])
    design = synthesise(P @ U, Q, omega, 1.0, L_max=None, objective=objective)
    response = Q.frequency_response(omega)[:, None, None] * P @ U
    gain = np.linalg.norm(response, axis=1).max(axis=0)[:, None, None] * design.filter.coefficients
    assert np.abs(gain).max() < 1e7
    assert design.certificate.failures == []
    if objective == "peak":
        assert design.value == pytest.approx(0.461827, abs=1e-6)  # Clarabel: 0.4618272


def lag(T, cutoff, n=400):
    """The lag 1 / (T s + 1) behind a zero-order hold, and Q, at logarithmic frequencies."""
    omega = np.geomspace(1e-4, np.pi, n)
    a = np.exp(-1 / T)
    P = ((1 - a) / (np.exp(1j * omega) - a))[:, None, None]
    return P, zero_phase_butterworth(2, cutoff).frequency_response(omega), omega


@pytest.mark.parametrize("order", [19, 20, 21, 22])
def test_the_gap_may_widen_before_it_closes(order):
    """While the objective falls by orders of magnitude, the dual does not follow at once."""
    arguments = (*lag(30, 0.3), 1.0)
    keywords = {"order": order, "band": (1e-4, 0.1)}
    design = synthesise(*arguments, L_max=50.0, **keywords)
    if order == 20:
        reference = synthesise(*arguments, L_max=50.0, solver="cvxpy", check=False, **keywords)
        assert reference.certificate.lower_bound <= design.value <= reference.value
    start = synthesise(*arguments, L_max=45.0, **keywords)
    again = synthesise(*arguments, L_max=50.0, start=start, **keywords)
    assert again.value == pytest.approx(design.value, rel=1e-6)


@pytest.mark.parametrize("T", [3.0, 30.0, 300.0])
@pytest.mark.parametrize("order", [10, 40])
@pytest.mark.parametrize("gain", [1e-6, 1e6])
def test_a_perfect_filter_is_certified(T, order, gain):
    """Where the optimum is next to zero, the gap counts by the objective without learning."""
    P, Q, omega = lag(T, 0.05, n=100)
    design = synthesise(P * gain, Q, omega, 1.0, order=order, L_max=5 * T / gain, band=(1e-4, 0.01))
    certificate = design.certificate
    assert design.value < 1e-3 * certificate.idle
    assert design.value - certificate.lower_bound <= 1e-9 * certificate.idle


def dense(b, G):
    """S = [[b I, G], [G^H, b I]] for each frequency, frequency first."""
    G = np.moveaxis(G, -1, 0)
    identity = np.asarray(b)[:, None, None] * np.eye(G.shape[1])
    return np.block([[identity, G], [G.conj().swapaxes(1, 2), identity]])


@given(st.integers(1, 4), st.integers(0, 999))
def test_what_a_slack_says_is_what_dense_matrices_say(q, seed):
    rng = np.random.default_rng(seed)
    G, D, Z = rng.standard_normal((3, q, q, 5)) + 1j * rng.standard_normal((3, q, q, 5))
    b = np.linalg.norm(G, 2, axis=(0, 1)) * rng.uniform(1.1, 2, 5)
    d, steps = rng.standard_normal(5), rng.uniform(0, 0.3, 3)
    slack, S, dS = interior_point.Slack(G, b), dense(b, G), dense(d, D)
    X = np.linalg.inv(S)
    np.testing.assert_allclose(np.moveaxis(slack.X, -1, 0), X, atol=1e-9 * np.abs(X).max())
    Y = dense(b, Z)
    product = Y @ dS @ X
    expected = (product + product.conj().swapaxes(1, 2)) / 2
    found = np.moveaxis(slack.sandwich(np.moveaxis(Y, 0, -1), d, D), -1, 0)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    along = slack.along(d, D)
    for a in steps:  # a Schur complement of S + a dS
        moved = np.moveaxis(G + a * D, -1, 0)
        complement = (b + a * d)[:, None, None] ** 2 * np.eye(q)
        complement = complement - moved.conj().swapaxes(1, 2) @ moved
        polynomial = np.moveaxis(along[0] + a * along[1] + a**2 * along[2], -1, 0)
        np.testing.assert_allclose(polynomial, complement, atol=1e-12 * np.abs(complement).max())
    limit = interior_point.longest_step(along, 1.0, 1e-6)
    inside, outside = (np.linalg.eigvalsh(S + a * dS).min() for a in (limit, limit * (1 + 2e-6)))
    assert inside > 0 and (limit == 1.0 or outside < 1e-9 * b.max())


@given(st.integers(1, 4), st.integers(0, 999))
def test_factors_of_small_matrices(q, seed):
    rng = np.random.default_rng(seed)
    C = rng.standard_normal((7, q, q)) + 1j * rng.standard_normal((7, q, q))
    A = C @ C.conj().swapaxes(1, 2) + 0.1 * np.eye(q)
    RH, inverse = (
        np.moveaxis(X, -1, 0) for X in interior_point.cholesky(np.moveaxis(A, 0, -1), 0.0)
    )
    np.testing.assert_allclose(RH.conj().swapaxes(1, 2) @ RH, A, atol=1e-10)
    np.testing.assert_allclose(
        inverse @ RH.conj().swapaxes(1, 2), np.tile(np.eye(q), (7, 1, 1)), atol=1e-8
    )
    shifted = A - rng.uniform(0, 2, 7)[:, None, None] * np.eye(q)
    positive = interior_point.positive_definite(np.moveaxis(shifted, 0, -1).copy())
    np.testing.assert_array_equal(positive, np.linalg.eigvalsh(shifted)[:, 0] > 0)


@pytest.mark.parametrize("objective", ["sum", "peak"])
@pytest.mark.parametrize(("m", "structure"), [(1, "full"), (2, "diagonal"), (3, "full")])
def test_the_gap_is_the_complementarity_where_the_multipliers_are_stationary(
    m, structure, objective
):
    P, Q, omega = random_plant(m, m)
    numbers = {"order": 3, "M_max": 0.97, "L_max": 20.0, "band": (0.01, 0.3)}
    problem = pose(P, Q, omega, 1.0, structure=structure, objective=objective, **numbers)
    problem = formulate(problem)
    p = interior_point.begin(problem, np.zeros((problem.entries, 3)))
    levels = problem.levels(p.t, p.limits)
    slacks = [interior_point.Slack(*a) for a in zip(p.G, levels, strict=True)]
    total = sum(
        np.einsum("nij,jin->", dense(b, G), Y).real
        for b, G, Y in zip(levels, p.G, p.Y, strict=True)
    )
    total += ((p.limits[0] - p.t) * p.eta).sum()
    found = interior_point.complementarity(problem, p)
    assert found == pytest.approx(total, rel=1e-12)
    d = interior_point.newton(problem, p, slacks, total, False)(0.0)
    q = p.moved(d, 1.0, 1.0)  # after a whole step, all equations that are linear hold
    assert np.abs(interior_point.stationarity(problem, q.Y)).max() < 1e-9 * np.abs(q.Y[0]).max()
    weights = interior_point.collect(problem, interior_point.trace(q.Y[0]))
    np.testing.assert_allclose(weights - q.eta, 1, atol=1e-9)
    for G, moved in zip(problem.matrices(q.x), q.G, strict=True):
        np.testing.assert_allclose(moved, G, atol=1e-9)
    gap = q.t.sum() - interior_point.dual_value(problem, q)
    assert gap == pytest.approx(interior_point.complementarity(problem, q), abs=1e-9 * total)


@pytest.mark.parametrize("objective", ["sum", "peak"])
@pytest.mark.parametrize(("m", "structure"), [(1, "full"), (2, "diagonal"), (3, "full")])
def test_both_ways_of_solving_the_newton_system_agree(m, structure, objective):
    P, Q, omega = random_plant(m, m)
    numbers = {"order": 3, "M_max": 0.97, "L_max": 20.0, "band": (0.01, 0.3)}
    problem = pose(P, Q, omega, 1.0, structure=structure, objective=objective, **numbers)
    problem = formulate(problem)
    p = interior_point.begin(problem, np.zeros((problem.entries, 3)))
    for root in (False, True):
        for _ in range(4):  # some way along the central path
            slacks = [
                interior_point.Slack(*a)
                for a in zip(p.G, problem.levels(p.t, p.limits), strict=True)
            ]
            total = interior_point.complementarity(problem, p)
            directions = [
                interior_point.newton(problem, p, slacks, total, root)(0.0)
                for root in (False, True)
            ]
            for name in ("x", "t", "eta"):
                one, other = (getattr(d, name) for d in directions)
                np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9 * np.abs(one).max())
            d = interior_point.step(problem, p, slacks, total, root)
            primal, dual = interior_point.step_lengths(problem, p, d, slacks, 0.1)
            p = p.moved(d, 0.9 * primal, 0.9 * dual)


def test_two_solves_give_the_same_bits(loop, Q, omega):
    first, second = (synthesise(loop, Q, omega[::5], 1.0, band=(1e-4, 0.01)) for _ in range(2))
    np.testing.assert_array_equal(first.filter.coefficients, second.filter.coefficients)
