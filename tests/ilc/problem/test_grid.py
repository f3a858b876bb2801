"""Where a grid is coarse or ends too soon, the learning filter keeps its bounds all the same."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rodlib import (
    InfeasibleError,
    LearningFilter,
    paper_loop,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.ilc.evidence.peak import error_model, learning_model, peak_gain
from rodlib.ilc.problem.grid import refined, without_gaps
from rodlib.ilc.problem.pose import pose
from rodlib.ilc.problem.problem import largest_singular_values
from rodlib.ilc.synthesis.result import SolverError
from rodlib.ilc.synthesis.search import largest_cutoff

DENSE = np.linspace(0, np.pi, 4001)
DOUBTS = (
    "the samples are too coarse",
    "the filter leaves",
    ".*may reach",
)
DOUBTS = [f"ignore:{text}" for text in DOUBTS]


def table(seed, m, n, last):
    """A coupled plant, stable, as a function of the angle, and coarse samples of it up to last."""
    rng = np.random.default_rng(seed)
    poles, gains = (
        rng.uniform(0.3, 0.9, (m, m)),
        np.eye(m) + 0.2 * rng.standard_normal((m, m)),
    )

    def P(angles):
        return (
            gains
            * (1 - poles)
            / (np.exp(1j * np.asarray(angles))[:, None, None] - poles)
        )

    return P, np.geomspace(last / 100, last, n)


@pytest.mark.parametrize("n", [250, 300, 1000])
@pytest.mark.parametrize("as_model", [True, False])
def test_on_the_grids_of_the_paper_nothing_is_added(loop, Q, n, as_model):
    omega = np.geomspace(1e-4, np.pi, n)
    problem = pose(loop if as_model else loop.frequency_response(omega), Q, omega, 1.0)
    assert without_gaps(problem) is problem
    assert problem.beyond is None
    np.testing.assert_array_equal(
        problem.weight, np.broadcast_to(np.eye(2) / 50, (n, 2, 2))
    )


@given(st.integers(1, 3), st.integers(1, 25), st.integers(3, 40), st.integers(0, 999))
def test_no_filter_that_keeps_the_bound_at_the_samples_passes_it_between(
    m, order, n, seed
):
    """Riesz' inequality, tried with filters of which some are nearly as bad as it admits."""
    rng = np.random.default_rng(seed)
    omega = np.sort(rng.uniform(1e-3, np.pi, max(n, order)))
    P = np.tile(np.eye(m), (len(omega), 1, 1))
    choices = {"order": order, "L_max": 7.0, "objective": "peak"}
    problem = without_gaps(
        pose(P, zero_phase_butterworth(2, 0.5), omega, 1.0, **choices)
    )
    problem = replace(problem, limit_L=np.full(len(problem.omega_L), np.inf))
    peak = np.cos(np.outer(np.arange(order), [rng.uniform(0, np.pi)]))[:, 0]
    for taps in (rng.standard_normal((m, m, order)), peak * np.eye(m)[..., None]):
        L = LearningFilter(taps, 1.0)
        share = problem.passed_L(L.frequency_response(problem.omega_L))
        highest = peak_gain(learning_model(LearningFilter(taps / share, 1.0)))[0]
        coarse = problem.share_L.min() < 1
        assert highest <= 7 * (1 + 1e-7 if coarse else 1 / np.cos(np.pi / 8))


@pytest.mark.filterwarnings(*DOUBTS)
@settings(max_examples=15)
@given(
    st.sampled_from([1, 2]),
    st.sampled_from([8, 12, 20]),
    st.floats(0.6, 2.8),
    st.integers(0, 999),
)
def test_above_a_table_L_and_M_keep_their_bounds(m, n, last, seed):
    P, omega = table(seed, m, n, last)
    Q = zero_phase_butterworth(2, 0.6 * last)
    choices = {
        "order": 6,
        "L_max": 4.0,
        "band": (omega[0], last / 4),
        "structure": "full",
    }
    design = synthesise(P(omega), Q, omega, 1.0, M_max=0.95, **choices)
    L = design.filter.frequency_response(DENSE)
    assert largest_singular_values(L).max() <= 4 * (1 + 1e-9)
    assert design.sigma_M.shape == design.omega.shape == (n,)
    above, rng = last < DENSE, np.random.default_rng(seed)
    size = np.linalg.norm(P(omega)[-1], 2)
    sigma_M = []
    for _ in range(20):
        shape = (above.sum(), m, m)
        other = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
        other *= size / largest_singular_values(other)[:, None, None]
        M = Q.frequency_response(DENSE[above])[:, None, None] * (
            np.eye(m) - other @ L[above]
        )
        sigma_M.append(largest_singular_values(M).max())
    assert max(sigma_M) <= design.certificate.beyond.sigma * (1 + 1e-3)
    assert design.certificate.beyond.sigma <= 0.95 * (1 + 1e-9)


def test_the_worst_of_the_assumed_size_is_what_the_certificate_says(loop):
    P, omega = table(3, 2, 12, 1.2)
    Q = zero_phase_butterworth(2, 0.8)
    design = synthesise(P(omega), Q, omega, 1.0, order=6, L_max=4.0, band=(0.05, 0.4))
    beyond = design.certificate.beyond
    U, sigma, Vh = np.linalg.svd(design.filter.frequency_response([beyond.omega])[0])
    worst = -np.linalg.norm(P(omega)[-1], 2) * Vh.conj().T @ U.conj().T
    M = Q.frequency_response([beyond.omega])[0] * (
        np.eye(2) - worst @ U @ np.diag(sigma) @ Vh
    )
    assert np.linalg.norm(M, 2) == pytest.approx(beyond.sigma, rel=1e-9)
    text = str(design)
    said = f"sigma_max(M) above 1.2 rad/s, with the size of P assumed there: {beyond.sigma:.4f} at"
    assert said in text
    higher = replace(design.certificate, beyond=replace(beyond, sigma=1.0))
    [failure] = higher.failures
    assert failure.endswith("assumed there, may reach 1: Lemma 1 does not hold")
    assert "assumed: above 1.2 rad/s, where P is not known, sigma_max(P) is" in text
    assert "below 0.012 rad/s" in text and "unknown: above" not in text


def test_where_Q_passes_more_than_M_may_be_above_the_table_it_is_said():
    P, omega = table(5, 1, 60, 0.5)
    Q = zero_phase_butterworth(2, 2.0)
    with pytest.warns(
        match=r"Q is 0.99\d* above 0.5 rad/s, where P is not known: no filter"
    ):
        design = synthesise(P(omega), Q, omega, 1.0, order=3, band=(0.02, 0.3))
    assert design.certificate.failures == []
    widest, design = largest_cutoff(P(omega), Q, omega, 1.0, order=3, band=(0.02, 0.3))
    assert widest.frequency_response([0.5])[0] <= 0.9
    assert design.certificate.beyond.sigma <= 0.9 * (1 + 1e-9)


def test_if_there_is_next_to_no_room_above_the_table_that_is_what_is_said():
    P, omega = table(5, 1, 60, 1.0)
    Q, choices = (
        zero_phase_butterworth(2, 1.594),
        {"order": 3, "M_max": 0.93, "band": (0.02, 0.3)},
    )
    last = Q.frequency_response([1.0])[0]
    assert 0.92 < last < 0.93
    with pytest.raises(
        InfeasibleError, match=r"It is assumed: above 1 rad/s, where P is not kn"
    ):
        synthesise(P(omega), Q, omega, 1.0, **choices)
    samples = Q.frequency_response(omega)
    design = synthesise(P(omega), 0.9 * samples, omega, 1.0, **choices)
    assert f"and |Q| {0.9 * last:.4g}, as at the last sample" in str(design)


@pytest.mark.parametrize(("as_array", "L_max"), [(False, 500.0), (True, None)])
@pytest.mark.filterwarnings(*DOUBTS)
def test_a_cutoff_is_not_larger_than_what_the_models_converge_with(as_array, L_max):
    """Beside samples, nobody looked at the model between them, where M was up to 1.888."""
    loop, omega = paper_loop(), np.geomspace(1e-4, np.pi, 40)
    sampled = loop.frequency_response(omega)
    P = [loop, sampled] if as_array else loop
    choices = {"structure": "full", "L_max": L_max, "band": (1e-4, 0.02), "order": 8}
    on_grid, _ = largest_cutoff(
        sampled, zero_phase_butterworth(), omega, 1.0, **choices
    )
    with pytest.raises(SolverError, match=r"sigma_max\(M\).* reaches .* not in omega"):
        synthesise(P, on_grid, omega, 1.0, **choices)
    Q, design = largest_cutoff(P, zero_phase_butterworth(), omega, 1.0, **choices)
    assert design.certificate.failures == [] and Q.cutoff < on_grid.cutoff * (1 + 1e-3)
    assert peak_gain(error_model(loop.P, design.filter), Q)[0] < 1
    np.testing.assert_array_equal(
        design.omega, omega
    )  # what is added is not the user's
    assert (
        design.certificate.exact.plant == 0
        and bool(design.certificate.estimated) == as_array
    )


def test_what_is_added_for_a_model_asks_nothing_of_samples(loop, Q):
    omega = np.geomspace(1e-4, np.pi, 40)
    first, other = loop.frequency_response(omega), 1.1 * loop.frequency_response(omega)
    radius = np.full(40, 0.01)
    problem = pose([first, loop, other], Q, omega, 1.0, uncertainty=radius)
    more = refined(problem, [0.5, 0.2])
    new = ~np.isin(more.omega, omega)
    np.testing.assert_array_equal(more.omega[new], [0.2, 0.5])
    at = loop.frequency_response([0.2, 0.5])
    for k in range(3):
        np.testing.assert_allclose(more.plants[k][new], at, rtol=1e-12)
        np.testing.assert_array_equal(more.plants[k][~new], problem.plants[k])
    np.testing.assert_allclose(
        more.Q[new], Q.frequency_response([0.2, 0.5]), rtol=1e-12
    )
    assert not more.radius[new].any() and more.in_band.sum() == problem.in_band.sum()
    wide = without_gaps(more)
    np.testing.assert_array_equal(wide.design.omega, omega)
    np.testing.assert_array_equal(wide.omega, more.omega)
    assert len(wide.omega_L) == len(np.unique(wide.omega_L)) > len(more.omega)
