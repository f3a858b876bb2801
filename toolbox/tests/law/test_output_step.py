import numpy as np
import pytest
from limited import plant
from plants import bump

from ilctools.law.error_bound import ErrorBound
from ilctools.law.nearest import Norm
from ilctools.law.output_program import Program
from ilctools.law.output_spread import Done, Plant, Room
from ilctools.law.output_step import longest_step, regained


def test_of_what_keeps_the_limits_the_cheapest_is_taken():
    """A limit that the law's change passes: shortened, it costs more than what a program finds."""
    model = plant(np.random.default_rng(0), 1, 1)
    one = Plant(model, ErrorBound(np.zeros(1), np.full(1, 0.1), 50))
    wanted, zero = bump(50, [1.0]), np.zeros((50, 1))
    room = Room(np.full((50, 1), np.inf), np.full((50, 1), 0.4))
    program, rest = Program([one], room, wanted, Norm(0.01), 50, None), Done(zero, zero)
    step = longest_step(program, rest, [], np.zeros(1))
    spread = one.spread(wanted, rest, [], 0.0)
    assert step.alpha == pytest.approx(np.min(room.share(spread))) and 0.2 < step.alpha < 0.6
    assert one.spread(step.change, rest, [], 0.0).most.max() <= 0.4 * (1 + 1e-9)
    assert program.cost(step.change) < 0.9 * program.cost(step.alpha * wanted)
    assert step.output == 0 and step.room == 0.4 and step.error > 0
    free = longest_step(Program([one], Room(*2 * [room.down]), *program_rest(program)), rest, [], 0)
    np.testing.assert_array_equal(free.change, wanted)
    assert free.alpha == 1


def test_a_trial_that_contradicts_the_radius_does_not_count():
    """Its w is that of the law's change, so that with it everything would seem to be known."""
    one = Plant(plant(np.random.default_rng(0), 1, 1), ErrorBound(np.zeros(1), np.ones(1), 50))
    wanted, zero = bump(50, [1.0]), np.zeros((50, 1))
    room = Room(np.full((50, 1), np.inf), np.full((50, 1), 0.4))
    program, rest = Program([one], room, wanted, Norm(0.01), 50, None), Done(zero, zero)
    alike, other = Done(wanted, 0.9 * one.output(wanted)), Done(wanted, -9 * one.output(wanted))
    alone, taught, misled = (
        longest_step(program, rest, past, np.zeros(1)) for past in ([], [alike], [other])
    )
    np.testing.assert_array_equal(misled.change, alone.change)
    assert alone.alpha < 0.8 * taught.alpha


def program_rest(program):
    return program.wanted, program.norm, program.active, program.commands


def test_after_a_trial_beyond_a_limit_all_hold_for_sure_or_none_is_found():
    model = plant(np.random.default_rng(0), 1, 1)
    wanted, zero = -0.2 * bump(50, [1.0]), np.zeros((50, 1))
    up = np.full((50, 1), 1.0) - bump(50, [1.1])  # 0.1 beyond, at its top
    for radius, found in ((0.1, True), (1.5, False)):
        one = Plant(model, ErrorBound(np.zeros(1), np.full(1, radius), 50))
        program = Program([one], Room(1 + 0 * up, up), wanted, Norm(0.01), 50, None)
        change = regained(program, Done(zero, zero), np.zeros(1))
        assert (change is not None) == found
        if found:
            assert np.all(one.spread(change, Done(zero, zero), [], 0.0).most <= up)
