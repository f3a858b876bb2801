"""The largest cut-off of Q; the least gain is in test_synthesise."""

import numpy as np
import pytest

from rodlib import InfeasibleError, largest_cutoff, synthesise, zero_phase_butterworth
from tests.synthesis.test_interior_point import random_plant

CHOICES = {"order": 3, "L_max": 8.0, "band": (0.01, 0.03), "M_max": 0.6}


@pytest.mark.parametrize("start", [0.05, 3.0])
@pytest.mark.parametrize("share", [None, 0.2])
def test_a_larger_cutoff_is_infeasible_and_it_is_not(start, share):
    P, _, omega = random_plant(2, 2)
    P[:, 0] *= np.exp(-4j * omega)[:, None]  # a delay that the filter does not see across
    choices = CHOICES | {"uncertainty": share and share * np.linalg.norm(P, 2, axis=(1, 2))}
    Q, design = largest_cutoff(P, zero_phase_butterworth(2, start), omega, 1.0, **choices)
    assert design.certificate.failures == []
    with pytest.raises(InfeasibleError):
        wider = zero_phase_butterworth(2, Q.cutoff * 1.001)
        synthesise(P, wider, omega, 1.0, **choices)


def test_where_all_may_pass_it_does():
    """A delay of one sample is learned at once, whatever Q passes."""
    _, _, omega = random_plant(1, 1)
    delay = np.exp(-1j * omega)[:, None, None]
    Q, design = largest_cutoff(delay, zero_phase_butterworth(2, 0.1), omega, 1.0, **CHOICES)
    assert Q.cutoff == pytest.approx(0.999 * np.pi) and Q.order == 2
    assert design.certificate.grid_M < 1e-6


def test_where_nothing_may_pass_it_says_what_is_too_tight():
    """Neither sign of P can be learned, and even with the lowest cut-off Q passes a half."""
    P, _, omega = random_plant(1, 2)
    with pytest.raises(InfeasibleError, match="most in the way") as error:
        largest_cutoff(
            [P, -P], zero_phase_butterworth(2, 0.1), omega, 1.0, **CHOICES | {"M_max": 0.4}
        )
    assert error.value.smallest_M_max == pytest.approx(0.5, rel=1e-6)


def test_Q_must_have_a_cutoff():
    P, Q, omega = random_plant(1, 2)
    with pytest.raises(ValueError, match="Q"):
        largest_cutoff(P, Q, omega, 1.0)
