import control
import numpy as np
import pytest
from limited import plant
from plants import bump

from ilctools.law.error_bound import ErrorBound
from ilctools.law.nearest import Norm
from ilctools.law.output_program import Commands, Program
from ilctools.law.output_spread import Plant, Room
from ilctools.models import from_rest
from ilctools.response.scale import Scale


@pytest.mark.parametrize("theta", [0.0, 1.0])
def test_limits_of_each_plant_and_of_commands_are_kept_before_the_rest(theta):
    P, wanted = plant(np.random.default_rng(1), 2, 2), bump(60, [1.0, 0.9])
    bound = ErrorBound(np.zeros(1), np.full(1, 0.02), 60)
    plants = [Plant(model, bound) for model in (P, P * 1.2)]
    room = Room(np.full((60, 2), np.inf), np.full((60, 2), 0.7))
    ends = np.full((2, 60, 2), np.inf) * [[[-1]], [[1]]]
    ends[:, :50] = [[[-9.0]], [[0.3]]]  # none in the rest
    commands = Commands(control.ss([], [], [], 2 * np.eye(2), 1.0), ends)
    program = Program(plants, room, wanted, Norm(0.01), 50, commands)
    spreads = [each.spread(wanted) for each in plants]
    d = program.change(spreads, theta)
    for each, spread in zip(plants, spreads, strict=True):
        assert np.all(from_rest(each.model, d) + theta * spread.radius <= 0.7 + 1e-6)
    assert np.all(2 * (d - wanted)[:50] <= 0.3 + 1e-6)  # from the commands of the law's change
    np.testing.assert_array_equal(d[50:], wanted[50:])
    assert program.cost(wanted) == 0 < program.cost(d)


def test_commands_are_the_same_in_other_units():
    model = control.ss(0.5, [[1.0, 2.0]], [[1.0]], [[0.3, 0.1]], 1.0)
    scale, w = Scale(np.ones(1), np.array([2.0, 0.1])), bump(20, [1.0, -1.0])
    scaled = Commands(model, ()).in_units(scale).model
    np.testing.assert_allclose(from_rest(scaled, w / scale.v), from_rest(model, w))
