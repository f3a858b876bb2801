import numpy as np
import pytest
from limited import plant
from plants import bump

from ilctools.law.error_bound import ErrorBound
from ilctools.law.nearest import Norm
from ilctools.law.output_program import Program
from ilctools.law.output_spread import Done, Plant, Room
from ilctools.law.output_step import longest_step, regained

WANTED, ZERO = bump(50, [1.0]), np.zeros((50, 1))
REST = Done(ZERO, ZERO)


def program_of(radius, wanted=WANTED, up=ZERO + 0.4):
    """Of a plant with this radius, whose output may rise so far."""
    bound = ErrorBound(np.zeros(1), np.full(1, radius), 50)
    one = Plant(plant(np.random.default_rng(0), 1, 1), bound)
    return Program([one], Room(ZERO + np.inf, up), wanted, Norm(0.01), 50, None)


def test_of_what_keeps_the_limits_the_cheapest_is_taken():
    """A limit that the law's change passes: shortened, it costs more than what a program finds."""
    program = program_of(0.1)
    [one], step = program.plants, longest_step(program, REST, [], np.zeros(1))
    share = np.min(program.room.share(one.spread(WANTED)))
    assert step.alpha == pytest.approx(share) and 0.2 < step.alpha < 0.6
    assert one.spread(step.change).most.max() <= 0.4 * (1 + 1e-9)
    assert program.cost(step.change) < 0.9 * program.cost(step.alpha * WANTED)
    assert step.output == 0 and step.room == 0.4 and step.error > 0
    free = longest_step(program_of(0.1, up=ZERO + np.inf), REST, [], np.zeros(1))
    np.testing.assert_array_equal(free.change, WANTED)
    assert free.alpha == 1


def test_a_trial_that_contradicts_the_radius_does_not_count():
    """Its w is that of the law's change, so that with it everything would seem to be known."""
    program = program_of(1.0)
    y = program.plants[0].output(WANTED)
    alone, taught, misled = (
        longest_step(program, REST, past, np.zeros(1))
        for past in ([], [Done(WANTED, 0.9 * y)], [Done(WANTED, -9 * y)])
    )
    np.testing.assert_array_equal(misled.change, alone.change)
    assert alone.alpha < 0.8 * taught.alpha


def test_after_a_trial_beyond_a_limit_all_hold_for_sure_or_none_is_found():
    up = 1.0 - bump(50, [1.1])  # 0.1 beyond, at its top
    program = program_of(0.1, -0.2 * WANTED, up)
    assert np.all(program.plants[0].spread(regained(program)).most <= up)
    assert regained(program_of(1.5, -0.2 * WANTED, up)) is None
