import numpy as np
import pytest
from limited import error, plant
from plants import bump

from ilctools.law.error_bound import ErrorBound
from ilctools.law.output_spread import Done, Plant, Room, Spread
from ilctools.models import from_rest

ANGLES = np.linspace(0.01, np.pi, 300)


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("seed", range(4))
def test_the_next_outputs_are_within_the_spread(seed, noise):
    """By trials of a plant that is wrong; those before make it narrower where they are alike."""
    rng, samples = np.random.default_rng(seed), 90
    P, radius = plant(rng, 2, 2), np.full(300, 0.2)
    Delta = error(rng, seed % 2, P, ANGLES, radius)
    within = Plant(P, ErrorBound(ANGLES, radius, samples))
    shapes = [bump(samples, rng.normal(size=2)) for _ in range(3)]
    signals = [rng.normal(size=3) @ np.array(shapes).reshape(3, -1) for _ in range(5)]
    *past, now, after = (
        Done(w, from_rest(P, w) + from_rest(Delta, w) + noise * rng.uniform(-1, 1, w.shape))
        for w in (signal.reshape(samples, 2) for signal in signals)
    )
    d, came = after.w - now.w, after.y - now.y
    n = np.full(2, noise)
    alone, taught = within.spread(d, now, [], n), within.spread(d, now, past, n)
    for spread in (alone, taught):
        assert np.all(spread.least - 2 * noise <= came + 1e-12)
        assert np.all(came <= spread.most + 2 * noise + 1e-12)
    ratio = taught.radius.max() / alone.radius.max()
    assert ratio < (1e-6 if noise == 0 else 0.9)  # three shapes, and three trials before


def test_the_share_is_that_of_the_sample_with_the_least_room():
    spread = Spread(np.array([[-1.0, 0.0], [-2.0, 0.5]]), np.array([[2.0, 0.0], [-1.0, 1.0]]))
    room = Room(np.full((2, 2), 1.0), np.array([[1.0, -5.0], [np.inf, 2.0]]))
    np.testing.assert_array_equal(room.share(spread), [[0.5, 1.0], [0.5, 1.0]])
    nowhere = Room(np.full((2, 2), -1.0), np.full((2, 2), 3.0))
    np.testing.assert_array_equal(nowhere.share(spread)[0], [0.0, 1.0])  # y falls already
