"""The synthesis runs on one thread of BLAS, whatever the user has."""

import numpy as np
import pytest
from paper import paper_choices
from threadpoolctl import threadpool_info, threadpool_limits

from ilctools import synthesise
from ilctools.synthesis import everywhere
from ilctools.threads import on_one_thread


def threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_while_it_runs_there_is_one_thread_and_afterwards_what_there_was():
    np.ones((3, 3)) @ np.ones((3, 3))
    with threadpool_limits(2, "blas"):
        before = threads()
        assert on_one_thread(threads)() == {1}
        with pytest.raises(ZeroDivisionError):
            on_one_thread(lambda: 1 / 0)()
        assert threads() == before


def test_the_digits_are_those_of_one_thread(loop, Q, omega, monkeypatch):
    during, solve = [], everywhere.solve

    def solve_and_look(*arguments):
        during.append(threads())
        return solve(*arguments)

    monkeypatch.setattr(everywhere, "solve", solve_and_look)
    coefficients = []
    for number in (1, 2):
        with threadpool_limits(number, "blas"):
            design_of = synthesise(loop, Q, omega, **paper_choices())
            coefficients.append(design_of.filter.coefficients)
    np.testing.assert_array_equal(*coefficients)
    assert during == [{1}, {1}]
