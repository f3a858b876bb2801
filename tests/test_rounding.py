import ast
import os
import subprocess
import sys

import numpy as np
import rounding
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from rodlib import paper_loop
from rodlib.paper.repository import ROOT

SIZES = {"max_magnitude": 1e300, "allow_nan": False}
ELEMENTS = {float: st.floats(-1e300, 1e300), complex: st.complex_numbers(**SIZES)}
RESULTS = st.sampled_from([*ELEMENTS]).flatmap(
    lambda kind: arrays.arrays(kind, (3, 4), elements=ELEMENTS[kind])
)


@given(RESULTS, st.integers(0, 9))
def test_each_number_moves_by_a_few_units_in_the_last_place(result, key):
    moved = rounding.move(result, key)
    np.testing.assert_array_equal(moved, rounding.move(result.copy(), key))
    few = (rounding.ULPS + 1) * 2**-52
    for before, after in ((result.real, moved.real), (result.imag, moved.imag)):
        np.testing.assert_allclose(after, before, rtol=few, atol=1e-320)


def test_pairs_and_symmetric_matrices_remain_such_and_a_seed_makes_a_difference():
    result = np.random.default_rng(0).standard_normal((50, 50)) * (1 + 2j)
    moved = rounding.move(result, 1)
    assert 0.8 < np.mean(moved != result) < 1  # one of nine factors is one
    np.testing.assert_array_equal(moved.conj(), rounding.move(result.conj(), 1))
    np.testing.assert_array_equal(-8 * moved.T, rounding.move(-8 * result.T, 1))
    assert np.mean(moved != rounding.move(result, 2)) > 0.8
    part, first_row = result[:5], result[:1]  # in an operand, and thus exact
    np.testing.assert_array_equal(rounding.move(part, 1, [first_row])[:1], first_row)
    assert rounding.move("text", 1) == "text" and rounding.move(7, 1) == 7


def test_products_in_rodlib_are_replaced_and_nothing_else():
    tree = ast.fix_missing_locations(rounding._Products().visit(ast.parse("a @ (b * c) @ d")))
    assert ast.unparse(tree) == "__product__(__product__(a, b * c), d)"


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
