"""Designs whose optimum is known, and what is said where there is none."""

import numpy as np
import pytest
from plants import lags, random_response

from ilctools import InfeasibleError, synthesise
from ilctools.models import frequency_response


@pytest.mark.parametrize(
    ("changes", "remedy"),
    [
        ({"order": 11, "structure": "diagonal"}, "a longer filter, or a full one, lower"),
        ({"M_max": 0.6, "L_max": 0.2}, "M_max is 0.79.* Raise M_max or L_max"),
        ({"L_max": None}, r"M_max is 0.5(00001)?; .* Raise M_max, take"),  # rounded up
    ],
)
def test_what_cannot_help_is_not_advised(changes, remedy):
    """Delay and zero of (1 - 2 / z) / z^11: on equal steps the mean of M is one up to order 11.

    Its inverse is -(z^12 / 2 + z^13 / 4 + ...), of which the first term leaves one half.
    """
    omega = (np.arange(200) + 0.5) * np.pi / 200
    z = np.exp(1j * omega)[:, None, None]
    arguments = {"order": 12, "M_max": 0.3, "L_max": 30.0, "band": (0.1, 1)} | changes
    with pytest.raises(InfeasibleError, match=remedy):
        synthesise((1 - 2 / z) / z**11, np.ones(200), omega, 1.0, **arguments)


def test_what_is_not_learned_at_one_frequency_is_learned_at_others():
    omega = np.linspace(0.05, 3, 50)
    P, Q = frequency_response(lags(), omega), 1 / (1 + omega**4)
    Q[3] = 0
    design = synthesise(P, Q, omega, 1.0, order=3, band=(0.05, 1), structure="full")
    assert design.sigma_M[3] == 0 and design.certificate.gap < 1e-8


def test_what_stands_in_the_way_is_named():
    """A plant of the wrong sign cannot be learned together with the nominal one."""
    P, Q, omega = random_response(1, 2)
    with pytest.raises(InfeasibleError, match="the main obstacle is plant 2 at") as error:
        synthesise([P, 1.1 * P, -P], Q, omega, 1.0, order=3, L_max=8.0, band=(0.01, 0.3))
    assert error.value.plant == 2 and error.value.omega in omega
    assert error.value.smallest_M_max >= Q.max() * (1 - 1e-6)
