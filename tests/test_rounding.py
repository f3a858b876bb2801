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
def test_each_number_moves_by_a_few_units_in_the_last_place_and_some_do(result, key):
    moved = rounding.move(result, key)
    assert moved.dtype == result.dtype
    np.testing.assert_array_equal(moved, rounding.move(result.copy(), key))
    for before, after in ((result.real, moved.real), (result.imag, moved.imag)):
        np.testing.assert_allclose(
            after, before, rtol=(rounding.ULPS + 1) * 2**-52, atol=1e-320
        )
        few = before == np.float32(np.clip(before, -1e9, 1e9))
        np.testing.assert_array_equal(after[few], before[few])


def test_pairs_and_symmetric_matrices_remain_such_and_a_seed_makes_a_difference():
    result = np.random.default_rng(0).standard_normal((50, 50)) * (1 + 2j)
    moved = rounding.move(result, 1)
    assert 0.8 < np.mean(moved != result) < 1  # one of nine factors is one
    np.testing.assert_array_equal(moved.conj(), rounding.move(result.conj(), 1))
    np.testing.assert_array_equal(-8 * moved.T, rounding.move(-8 * result.T, 1))
    assert np.mean(moved != rounding.move(result, 2)) > 0.8
    taken = rounding.move(
        result[:5], 1, [result[:1]]
    )  # the first row stands in an operand
    np.testing.assert_array_equal(taken[0], result[0])
    np.testing.assert_array_equal(taken[1:], moved[1:5])
    pair = np.linalg.eig(np.array([[1.0, 2.0], [-2.0, 1.0]]))
    values, vectors = rounding.move(pair, 3)
    assert type(rounding.move(pair, 3)) is type(pair) and values[0] == values[1].conj()
    np.testing.assert_array_equal(vectors[:, 0], vectors[:, 1].conj())
    assert rounding.move("text", 1) == "text" and rounding.move(7, 1) == 7


def test_products_in_rodlib_are_replaced_and_nothing_else():
    tree = ast.fix_missing_locations(
        rounding._Products().visit(ast.parse("a @ (b * c) @ d"))
    )
    assert ast.unparse(tree) == "__product__(__product__(a, b * c), d)"


def test_a_process_varies_by_the_seed_and_another_does_not():
    """The paper's N, from a realisation and a Riccati equation, moves in its last digits."""
    show = "from rodlib import paper_loop; print(repr(paper_loop().N.tolist()))"
    calls = [
        f"import rounding; rounding.vary({seed}); {show}" for seed in (1, 1, 2)
    ] + [show]
    running = [
        subprocess.Popen(
            [sys.executable, "-c", call],
            cwd=Path(__file__).parent,
            env=os.environ
            | {"PYTHONPATH": str(ROOT)},  # of this process, rounding may be varied
            stdout=subprocess.PIPE,
        )
        for call in calls
    ]
    found = [
        np.array(ast.literal_eval(process.communicate()[0].decode()))
        for process in running
    ]
    np.testing.assert_array_equal(found[0], found[1])
    for one, other in ((0, 2), (0, 3), (2, 3)):
        assert np.any(found[one] != found[other])
        np.testing.assert_allclose(found[one], found[other], rtol=1e-9)
