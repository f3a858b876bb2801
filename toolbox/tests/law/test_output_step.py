import numpy as np
import pytest
from limited import error, plant
from plants import bump

from ilctools.law.error_bound import ErrorBound
from ilctools.law.nearest import NotFound
from ilctools.law.output_step import Done, Plant, Room, Spread, longest_step
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


def test_of_what_keeps_the_limits_the_cheapest_is_taken():
    model = plant(np.random.default_rng(0), 1, 1)
    one = Plant(model, ErrorBound(ANGLES, np.full(300, 0.1), 50))
    wanted, zero = bump(50, [1.0]), np.zeros((50, 1))
    room = Room(np.full((50, 1), np.inf), np.full((50, 1), 0.4))

    def step(program):
        cost = lambda d: np.sum((d - wanted) ** 2)  # noqa: E731
        return longest_step([one], room, wanted, Done(zero, zero), [], 0.0, cost, program)

    def none(spreads, theta):
        raise NotFound

    def later(spreads, theta):  # which the limits let through whole
        return np.where(np.arange(50)[:, None] < 25, 0.9 * step(none).alpha, 0.1) * wanted

    alone = step(none)
    np.testing.assert_allclose(alone.change, alone.alpha * wanted)
    assert 0 < alone.alpha < 1 and alone.output == 0 and alone.room == 0.4
    assert np.max(one.spread(alone.change, Done(zero, zero), [], 0.0).most) == pytest.approx(0.4)
    better = step(lambda spreads, theta: np.minimum(wanted, 1.02 * alone.alpha))
    assert np.sum((better.change - wanted) ** 2) <= np.sum((alone.change - wanted) ** 2)
    np.testing.assert_allclose(step(later).change, alone.change)
