"""P by the robust method, and its radius."""

import numpy as np
from plants import complex_normal

from ilctools.measurement.excited import ExcitedResponse


def test_what_disturbs_one_line_only_is_within_its_radius():
    """As a hum of the mains does: alike in the periods of a realisation, not in the next."""
    rng = np.random.default_rng(0)
    periods = 1 + 1e-3 * complex_normal(rng, 10, 2, 40, 1, 1)
    periods[:, :, 20] += 0.1 * complex_normal(rng, 10, 1, 1, 1)
    P = ExcitedResponse(np.geomspace(0.01, 1, 40), periods, None)
    radius = P.radius(0.99)
    assert (
        abs(P.response[20, 0, 0] - 1) < radius[20]
        and np.delete(radius, 20).max() < 0.05 * radius[20]
    )
