import ast
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import rounding
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

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
    tree = ast.fix_missing_locations(
        rounding._Products().visit(ast.parse("a @ (b * c) @ d"))
    )
    assert ast.unparse(tree) == "__product__(__product__(a, b * c), d)"


def test_a_varied_process_moves_the_last_digits_and_repeats_itself():
    """The paper's N, from a realisation and a Riccati equation, moves in its last digits.

    That another seed moves it otherwise, follows from the results of :func:`rounding.move`.
    """
    show = "from rodlib import paper_loop; print(repr(paper_loop().N.tolist()))"
    vary = "import rounding; rounding.vary({}); "
    results = []
    for begin in (vary.format(1), vary.format(1), ""):
        run = subprocess.run(
            [sys.executable, "-c", begin + show],
            cwd=Path(__file__).parent,
            # of this process, rounding may be varied
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            capture_output=True,
            check=True,
        )
        results.append(np.array(ast.literal_eval(run.stdout.decode())))
    one, again, unvaried = results
    np.testing.assert_array_equal(one, again)
    assert np.any(one != unvaried)
    np.testing.assert_allclose(one, unvaried, rtol=1e-9)
