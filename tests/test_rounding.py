import ast
import os
import subprocess
import sys

import numpy as np
import rounding

from rodlib import paper_loop
from rodlib.paper.repository import ROOT


def test_numbers_move_by_a_few_units_pairs_and_symmetric_matrices_remain_such():
    result = np.random.default_rng(0).standard_normal((50, 50)) * (1 + 2j)
    moved = rounding.move(result, 1)
    assert 0.8 < np.mean(moved != result) < 1  # one of nine factors is one
    np.testing.assert_allclose(moved, result, rtol=(rounding.ULPS + 1) * 2**-52)
    np.testing.assert_array_equal(moved, rounding.move(result.copy(), 1))
    np.testing.assert_array_equal(moved.conj(), rounding.move(result.conj(), 1))
    np.testing.assert_array_equal(-8 * moved.T, rounding.move(-8 * result.T, 1))
    assert np.mean(moved != rounding.move(result, 2)) > 0.8
    part, first_row = result[:5], result[:1]  # in an operand, and thus exact
    np.testing.assert_array_equal(rounding.move(part, 1, [first_row])[:1], first_row)
    assert rounding.move("text", 1) == "text" and rounding.move(7, 1) == 7


def test_a_varied_process_moves_the_last_digits():
    """The paper's N, from a realisation and a Riccati equation, moves in its last digits.

    That a seed repeats itself, and another moves N otherwise, follows from :func:`rounding.move`.
    """
    show = "import rounding; rounding.vary(99); from rodlib import paper_loop; "
    run = subprocess.run(
        [sys.executable, "-c", show + "print(paper_loop().N.tolist())"],
        cwd=ROOT / "tools",
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        check=True,
    )
    moved, N = np.array(ast.literal_eval(run.stdout.decode())), paper_loop().N
    assert np.any(moved != N)
    np.testing.assert_allclose(moved, N, rtol=1e-9)
