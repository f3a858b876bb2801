"""Where a grid is coarse or ends too soon, the learning filter keeps its bounds all the same."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import posed

from ilctools import InfeasibleError, LearningFilter, synthesise, zero_phase_butterworth
from ilctools.evidence.peak import PEAK_TOLERANCE, peak_of_L
from ilctools.problem.grid import on_a_grid
from ilctools.singular_values import largest_singular_values

DENSE = np.linspace(0, np.pi, 4001)


def table(seed, m, n, last):
    """Coarse samples of a coupled stable plant, up to `last`, and their frequencies."""
    rng = np.random.default_rng(seed)
    poles, coupling = rng.uniform(0.3, 0.9, (m, m)), rng.standard_normal((m, m))
    omega = np.geomspace(last / 100, last, n)
    z = np.exp(1j * omega)[:, None, None]
    return (np.eye(m) + 0.2 * coupling) * (1 - poles) / (z - poles), omega


@given(st.integers(1, 3), st.integers(1, 25), st.integers(3, 40), st.integers(0, 999))
def test_no_filter_that_keeps_the_bound_on_the_grid_passes_it_between(m, order, n, seed):
    """Riesz' inequality, tried with filters of which some are nearly as bad as it admits."""
    rng = np.random.default_rng(seed)
    omega = np.sort(rng.uniform(1e-3, np.pi, max(n, order)))
    P = np.tile(np.eye(m), (len(omega), 1, 1))
    choices = {"order": order, "L_max": 7.0, "objective": "peak"}
    Q = zero_phase_butterworth(2, 0.5, 1.0)
    problem, stated = on_a_grid(posed(P, Q, omega, 1.0, **choices))
    np.testing.assert_array_equal(problem.omega[stated], omega)
    peak = np.cos(np.arange(order) * rng.uniform(0, np.pi))
    for taps in (rng.standard_normal((m, m, order)), peak * np.eye(m)[..., None]):
        L = LearningFilter(taps, 1.0)
        share = largest_singular_values(L.frequency_response(problem.omega)).max() / problem.L_max
        highest = peak_of_L(LearningFilter(taps / share, 1.0))[0]
        limit = 7 if problem.L_max < 7 else 7 / np.cos(np.pi / 8)
        assert highest <= limit * (1 + PEAK_TOLERANCE)


@pytest.mark.filterwarnings(
    "ignore:almost nothing is learned",
    "ignore:.*may reach",
    "ignore:.*between the frequencies omega",
)
@settings(max_examples=3)
@given(st.sampled_from([1, 2]), st.sampled_from([8, 20]), st.floats(0.6, 2.8), st.integers(0, 999))
def test_above_a_table_L_and_M_keep_their_bounds(m, n, last, seed):
    P, omega = table(seed, m, n, last)
    Q = zero_phase_butterworth(2, 0.6 * last, 1.0)
    choices = {"L_max": 4.0, "band": (omega[0], last / 4), "structure": "full"}
    design = synthesise(P, Q, omega, 1.0, M_max=0.95, order=6, **choices)
    L = design.filter.frequency_response(DENSE)
    assert largest_singular_values(L).max() <= 4 * (1 + 1e-9)
    assert design.sigma_M.shape == design.omega.shape == (n,)
    above, beyond = last < DENSE, design.certificate.peaks["assumed"]

    def worst_M(omega):
        """The worst P of the size of the last sample turns L against I."""
        gain = largest_singular_values(design.filter.frequency_response(omega))
        return Q.frequency_response(omega) * (1 + np.linalg.norm(P[-1], 2) * gain)

    assert worst_M([beyond.omega])[0] == pytest.approx(beyond.sigma, rel=1e-9)
    assert worst_M(DENSE[above]).max() <= beyond.sigma * (1 + 1e-3)
    assert beyond.sigma <= 0.95 * (1 + 1e-9)


def test_where_Q_passes_too_much_above_the_table_it_is_said():
    P, omega = table(5, 1, 60, 0.5)
    choices = {"order": 3, "band": (0.02, 0.3)}
    Q = zero_phase_butterworth(2, 2.0, 1.0)
    with pytest.warns(match="above 0.5 rad/s, where P is not known, so that no filter"):
        design = synthesise(P, Q, omega, 1.0, **choices)
    assert design.certificate.failures == []
    P, omega = table(5, 1, 60, 1.0)
    Q = zero_phase_butterworth(2, 1.594, 1.0)  # which leaves next to no room
    with pytest.raises(InfeasibleError, match="assumed: above 1 rad/s, where P is not"):
        synthesise(P, Q, omega, 1.0, M_max=0.93, **choices | {"order": 1})
