"""A design from a measured response, in one step: against its two steps, and against the truth."""

from dataclasses import dataclass

import numpy as np
import pytest
from paper import paper_choices
from plants import LOOPS, complex_normal

from ilctools import InfeasibleError, synthesise, zero_phase_butterworth
from ilctools.problem.pose import pose
from ilctools.problem.problem import convergence_matrix
from ilctools.response.measured import Measured
from ilctools.singular_values import largest_singular_values

CONFIDENCE = 0.99


@dataclass(frozen=True)
class Estimate(Measured):
    """A response, and a radius that is said to contain the truth."""

    P: np.ndarray
    radius: float
    loop = None

    @property
    def omega(self):
        return np.arange(1.0, 1 + len(self.P))

    @property
    def response(self):
        return self.P

    def on(self, omega, confidence, scale=None):
        assert confidence == CONFIDENCE
        S = np.ones(self.P.shape[1]) if scale is None else np.array(scale, float)
        radius = np.full(len(omega), self.radius * S.max() / S.min())
        return self.P * S / S[:, None], radius

    def basis(self, omega, confidence):
        return [f"read off at {len(omega)} frequencies, with confidence {confidence:g}"]


def test_the_bound_holds_for_the_truth_if_it_is_within_the_radius():
    loop, scale, S = LOOPS["tanks"](), [1, 2, 3], np.arange(1.0, 4.0)
    omega = np.geomspace(1e-3, np.pi, 30) / loop.Ts
    P, rng = loop.frequency_response(omega), np.random.default_rng(3)
    error = complex_normal(rng, *P.shape)
    error *= 0.004 / np.linalg.norm(error, 2, axis=(1, 2))[:, None, None]
    Q = zero_phase_butterworth(2, 0.03 / loop.Ts, loop.Ts)
    choices = paper_choices(band=(omega[0], 0.02 / loop.Ts), scale=scale)
    measured = Estimate(P + error, 0.004)
    design = synthesise(measured, Q, omega, loop.Ts, **choices)
    L = design.filter.frequency_response(omega)
    M = convergence_matrix(P, Q.frequency_response(omega), L) * S / S[:, None]
    assert largest_singular_values(M).max() <= 0.9 * (1 + 1e-9)
    radius = measured.on(omega, CONFIDENCE, scale)[1]
    np.testing.assert_array_equal(design.problem.radius, radius)  # in units of scale
    choices["uncertainty"] = radius
    two_steps = synthesise(measured.P, Q, omega, loop.Ts, **choices)
    assert design.value == pytest.approx(two_steps.value, rel=1e-9)
    assert "read off at 30 frequencies, with confidence 0.99" in str(design)
    assert "read off" not in str(two_steps)


def test_where_nothing_can_be_learned_is_named(loop, Q):
    omega = np.geomspace(1e-4, np.pi, 50)
    P = loop.frequency_response(omega)
    smallest = np.linalg.svd(P, compute_uv=False)[:, -1]
    measured = Estimate(P, 0.01)
    design = synthesise(measured, Q, omega, 1.0, **paper_choices())
    lost = omega[smallest <= 0.01]
    assert 0 < len(lost) < 50
    place = f"at {len(lost)} frequencies from {lost[0]:.4g} to {lost[-1]:.4g} rad/s"
    assert f"nothing can be learned {place}" in str(design)
    for factor in (0.5, 2.0):
        many = pose([P, factor * P], Q, omega, 1.0, uncertainty=np.full(50, 0.01))
        np.testing.assert_array_equal(many.unusable, min(factor, 1) * smallest <= 0.01)
    with pytest.raises(InfeasibleError, match="nothing can be learned at") as caught:
        synthesise(Estimate(P, 0.5), Q, omega, 1.0, **paper_choices())
    here = smallest <= 0.5
    assert f"{here.sum()} frequencies from {omega[here][0]:.4g}" in str(caught.value)
    # a singular plant is within the radius: no filter makes M smaller than Q for it
    largest = np.abs(Q.frequency_response(omega))[here].max()
    assert caught.value.smallest_M_max >= largest - 1e-9


def test_what_contradicts_a_measurement_is_refused(loop, Q):
    omega = np.geomspace(1e-4, np.pi, 100)
    measured = Estimate(loop.frequency_response(omega), 0.01)
    with pytest.raises(ValueError, match="uncertainty must be None"):
        synthesise(measured, Q, omega, 1.0, uncertainty=np.full(100, 0.1))
    with pytest.raises(ValueError, match=r"P.0. is a measured response, whose radius"):
        synthesise([measured, loop], Q, omega, 1.0)
