"""What one trial with two ends does: operators, norms, and trials of the law."""

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from plants import furnace, lag, sigma_of_M

from ilctools import (
    LearningFilter,
    synthesise,
    trial_map,
    trial_norm,
    trial_operators,
    zero_phase_butterworth,
)
from ilctools.evidence.finite import settled_trial
from ilctools.models import sampled_plant

TAPS = 0.3 * np.random.default_rng(1).standard_normal((2, 2, 10))


@pytest.mark.parametrize("ends", ["zero", "hold", "hold-last"])
def test_operators_are_what_the_trials_apply_and_their_adjoints(loop, ends):
    x = np.random.default_rng(2).standard_normal((60, 2))
    Q = zero_phase_butterworth(2, 0.1, 1.0, ends=ends)
    L = LearningFilter(TAPS, 1.0, ends)
    response = control.forced_response(loop.P, inputs=x.T).outputs.T
    operators = trial_operators(loop.P, Q, L, 60)
    for operator, expected in zip(operators, (response, Q.apply(x), L.apply(x)), strict=True):
        assert_allclose(operator @ x.ravel(), expected.ravel(), atol=1e-10)
        matrix, adjoint = operator @ np.eye(120), operator.H @ np.eye(120)
        assert_allclose(matrix @ x.ravel(), expected.ravel(), atol=1e-10)
        assert_allclose(adjoint, matrix.T, atol=1e-11)


@pytest.mark.parametrize(("samples", "trials", "rest"), [(120, 3, 0), (120, 2, 15), (1, 1, 0)])
def test_lanczos_finds_the_norm_of_the_matrix(loop, Q, samples, trials, rest):
    L = LearningFilter(TAPS, 1.0, "hold")
    size, active = 2 * samples, 2 * (samples - rest)
    matrix = trial_map(loop.P, Q, L, samples) @ np.eye(size)
    matrix[active:] = 0
    matrix[:, active:] = 0
    power = np.linalg.matrix_power(matrix, trials)
    norm, before, after = trial_norm(loop.P, Q, L, samples, trials, rest)
    assert norm == pytest.approx(np.linalg.norm(power, 2), rel=1e-6)
    assert np.linalg.norm(before) == pytest.approx(1)
    assert_allclose(power @ before.ravel(), after.ravel(), atol=1e-11)


LOWPASS, TAP = zero_phase_butterworth(2, 0.5, 1.0), LearningFilter([[[0.5]]], 1.0)


@pytest.mark.parametrize(
    ("plants", "samples"),
    [
        ([lag(0.9)], 50 + 10 * np.log(0.02) / np.log(0.9)),  # settled to 2 % ten times
        ([lag(0.5), lag(0.9)], 50 + 10 * np.log(0.02) / np.log(0.9)),  # the slower
        ([sampled_plant(furnace(400, gain=0.1), "P")], 50 + 2 * 401),  # twice its delay
    ],
)
def test_a_trial_is_ten_times_as_long_as_the_plants_settle(plants, samples):
    found, norm = settled_trial(plants, LOWPASS, TAP)
    assert found == int(samples)
    assert norm == pytest.approx(
        max(trial_norm(P, LOWPASS, TAP, found)[0] for P in plants), rel=1e-7
    )


def delayed(samples):
    """A pure delay."""
    return control.ss(control.tf([1.0], [1.0, *np.zeros(samples)], 1.0))


def test_directions_that_grow_alike_have_a_norm():
    """A trial in which a delay acts on many samples of v not at all.

    Its largest singular values are 1 - 1e-6 and closer: a Lanczos iteration cannot separate them.
    """
    Q, L = zero_phase_butterworth(2, 2.8, 1.0), LearningFilter([[[0.5]]], 1.0, first=90)
    T = trial_map(delayed(90), Q, L, 200) @ np.eye(200)
    norm, before, after = trial_norm(delayed(90), Q, L, 200)
    assert abs(norm - np.linalg.norm(T, 2)) < 1e-12
    assert np.allclose(T @ before, after, rtol=0, atol=1e-12)


def test_a_pure_delay_of_200_samples_is_learned():
    design = synthesise(delayed(200))
    assert design.certificate.settled_trial.norm < 1
    M = sigma_of_M(np.linspace(0.001, np.pi, 4000), delayed(200), design.Q, design.filter)
    assert M.max() <= design.rate * (1 + 1e-6) < 0.01
