"""A design from a measured response, in one step: against its two steps, and against the truth."""

import control
import numpy as np
import pytest
from paper import paper_choices
from plants import LOOPS, complex_normal
from problems import posed

from ilctools import InfeasibleError, measured_response, synthesise, zero_phase_butterworth
from ilctools.problem.problem import convergence_matrix

CONFIDENCE = 0.99


def table(P, radius, omega, Ts=1.0):
    """Samples that are said to be within a radius of the truth."""
    data = control.frd(np.moveaxis(P, 0, -1), omega, Ts)
    return measured_response(data, uncertainty=np.full(len(omega), radius))


def test_the_bound_holds_for_the_truth_if_it_is_within_the_radius():
    loop, scale, S = LOOPS["tanks"](), [1, 2, 3], np.arange(1.0, 4.0)
    omega = np.geomspace(1e-3, np.pi, 30) / loop.Ts
    P, rng = loop.frequency_response(omega), np.random.default_rng(3)
    error = complex_normal(rng, *P.shape)
    error *= 0.004 / np.linalg.norm(error, 2, axis=(1, 2))[:, None, None]
    Q = zero_phase_butterworth(2, 0.03 / loop.Ts, loop.Ts)
    choices = paper_choices(band=(omega[0], 0.02 / loop.Ts), scale=scale, order=4)
    measured = table(P + error, 0.004, omega, loop.Ts)
    design = synthesise(measured, Q, omega, **choices)
    M = convergence_matrix(P, Q.frequency_response(omega), design.filter.frequency_response(omega))
    assert np.linalg.norm(M * S / S[:, None], 2, axis=(1, 2)).max() <= 0.9 * (1 + 1e-9)
    radius = measured.on(omega, CONFIDENCE, scale)[1]
    np.testing.assert_array_equal(design.problem.radius, radius)  # in units of scale
    choices["uncertainty"] = radius
    two_steps = synthesise(measured.response, Q, omega, loop.Ts, **choices)
    assert design.value == pytest.approx(two_steps.value, rel=1e-9)


def test_where_nothing_can_be_learned_is_named(loop, Q):
    omega = np.geomspace(1e-4, np.pi, 30)
    P = loop.frequency_response(omega)
    smallest = np.linalg.svd(P, compute_uv=False)[:, -1]
    choices = paper_choices(order=8)
    design = synthesise(table(P, 0.01, omega), Q, omega, **choices)
    lost = omega[smallest <= 0.01]
    assert 0 < len(lost) < 30
    assert f"nothing can be learned at {len(lost)} frequencies from {lost[0]:.4g}" in str(design)
    many = posed([P, 0.5 * P], Q, omega, 1.0, uncertainty=np.full(30, 0.01))
    np.testing.assert_array_equal(many.singular_within_radius, 0.5 * smallest <= 0.01)
    with pytest.raises(ValueError, match="uncertainty must be None"):
        synthesise(table(P, 0.01, omega), Q, omega, uncertainty=np.full(30, 0.1))
    with pytest.raises(ValueError, match=r"P.0. is a measured response, whose radius"):
        synthesise([table(P, 0.01, omega), loop], Q, omega)
    with pytest.raises(InfeasibleError, match="nothing can be learned at") as caught:
        synthesise(table(P, 0.5, omega), Q, omega, **choices)
    # a singular plant is within the radius: no filter makes M smaller than Q for it
    largest = np.abs(Q.frequency_response(omega))[smallest <= 0.5].max()
    assert caught.value.smallest_M_max >= largest - 1e-9
