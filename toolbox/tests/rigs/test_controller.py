"""The controller of a loop, sample by sample, against the loop as one system."""

import control
import numpy as np
import pytest
from plants import LOOPS

from ilctools import Controller
from ilctools.rigs.controller import rounded


@pytest.mark.parametrize("name", LOOPS)
def test_around_the_plant_it_makes_the_closed_loop(name):
    """Several loops side by side, each with a reference of its own."""
    loop, rng = LOOPS[name](), np.random.default_rng(0)
    plant, m, both = loop.plant[:, loop.controls], len(loop.outputs), Controller(loop)
    w = rng.standard_normal((50, 2, m))
    x, outputs = np.zeros((2, plant.nstates)), []
    for now in w:
        outputs.append(x @ plant.C.T)
        u = both.command(now)
        both.observe(outputs[-1], u)
        x = x @ plant.A.T + u @ plant.B.T
    for k in range(2):
        answer = control.forced_response(loop.P, inputs=w[:, k].T, squeeze=False).outputs.T
        found = np.array(outputs)[:, k]
        np.testing.assert_allclose(found, answer, atol=1e-9 * np.abs(answer).max())


def test_commands_act_as_they_are_rounded():
    loop, w = LOOPS["stage"](), [0.123456]
    (plain,), (coarse,) = (Controller(loop, decimals).step([0.0], w) for decimals in (None, 2))
    assert coarse == round(plain, 2) != plain
    assert rounded(2.675, 2) == 2.67 and rounded(np.array([2.5, 3.14159]), 3)[1] == 3.142
    with pytest.raises(ValueError, match=r"decimals = 0\.5"):
        Controller(loop, 0.5)
