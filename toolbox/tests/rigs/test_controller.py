"""The controller of a loop, sample by sample."""

import numpy as np
import pytest
from plants import LOOPS

from ilctools import Controller
from ilctools.rigs.controller import rounded


def test_several_loops_side_by_side_are_the_loops_one_by_one():
    loop = LOOPS["tanks"]()
    y, w = np.random.default_rng(0).standard_normal((2, 20, 2, 3))
    both, one, other = (Controller(loop) for _ in range(3))
    for y_now, w_now in zip(y, w, strict=True):
        u = both.command(w_now)
        both.observe(y_now, u)
        apart = one.step(y_now[0], w_now[0]), other.step(y_now[1], w_now[1])
        np.testing.assert_allclose(u, apart, rtol=1e-12)


def test_commands_act_as_they_are_rounded():
    loop, w = LOOPS["stage"](), [0.123456]
    (plain,), (coarse,) = (Controller(loop, decimals).step([0.0], w) for decimals in (None, 2))
    assert coarse == round(plain, 2) != plain
    assert rounded(2.675, 2) == 2.67 and rounded(np.array([2.5, 3.14159]), 3)[1] == 3.142
    with pytest.raises(ValueError, match=r"decimals = 0\.5"):
        Controller(loop, 0.5)
