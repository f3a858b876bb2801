"""The phase of poles, and grids that are even in it."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ilctools.response.phase import phase, phase_grid

orders, seeds = st.integers(1, 5), st.integers(0, 999)


@given(orders, st.sampled_from([0.5, 1e-3]), seeds)
def test_the_phase_is_that_of_the_all_pass(n, distance, seed):
    rng = np.random.default_rng(seed)
    size, angle = 1 - distance * rng.uniform(size=n), rng.uniform(-np.pi, np.pi, n)
    poles, theta = size * np.exp(1j * angle), np.sort(rng.uniform(0, np.pi, 9))
    z = np.exp(1j * theta)[:, None]
    all_pass = ((z - poles) / (1 - poles.conj() * z)).prod(axis=1)
    turns = phase(poles, theta)
    turned = np.exp(1j * (turns - turns[0]))
    np.testing.assert_allclose(turned, all_pass / all_pass[0], atol=1e-9)
    assert np.all(np.diff(turns) > 0)


@given(st.lists(orders, min_size=1, max_size=3), st.sampled_from([0.5, 1e-3, 1e-6]), seeds)
def test_a_grid_is_even_in_the_phase_of_each_set_of_poles(sizes, distance, seed):
    """More or less: what it is exactly is measured where it counts."""
    rng = np.random.default_rng(seed)
    systems = [
        (1 - distance * rng.uniform(size=n)) * np.exp(1j * rng.uniform(-3, 3, n)) for n in sizes
    ]
    theta = phase_grid(systems, 0.05)
    steps = np.array([np.diff(phase(poles, theta)) for poles in systems])
    assert theta[0] == 0 and theta[-1] == np.pi and np.all(np.diff(theta) > 0)
    assert steps.max() < 0.08 and len(theta) < 3 + sum(sizes) * 2 * np.pi / 0.05
