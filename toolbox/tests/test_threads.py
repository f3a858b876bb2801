"""The synthesis runs on one thread of BLAS, whatever the user has."""

from concurrent.futures import ThreadPoolExecutor
from threading import Event, Thread

import numpy as np
import pytest
from plants import lag
from threadpoolctl import threadpool_info, threadpool_limits

from ilctools import synthesise
from ilctools.filters import ZeroPhaseButterworth
from ilctools.threads import on_one_thread


def threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def set_threads(number):
    """In a thread of its own that ends: threadpoolctl obeys the one that has set a limit last."""
    setting = Thread(target=threadpool_limits, args=(number, "blas"))
    setting.start()
    setting.join()


@pytest.fixture
def two_threads():
    before = max(threads())
    set_threads(2)
    if threads() != {2}:
        pytest.skip("this BLAS has one thread")
    yield
    set_threads(before)


def test_while_it_runs_there_is_one_thread_and_afterwards_what_there_was():
    np.ones((3, 3)) @ np.ones((3, 3))
    with threadpool_limits(2, "blas"):
        before = threads()
        assert on_one_thread(threads)() == {1}
        with pytest.raises(ZeroDivisionError):
            on_one_thread(lambda: 1 / 0)()
        assert threads() == before


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_of_calls_that_overlap_the_last_restores(order, two_threads):
    """Each way in which two calls may end; the first one raises."""
    began, may_end = ([Event(), Event()] for _ in range(2))

    @on_one_thread
    def call(k):
        began[k].set()
        assert may_end[k].wait(10)
        return threads() if k else 1 / k

    with ThreadPoolExecutor(2) as pool:
        running = []
        for k in range(2):
            running.append(pool.submit(call, k))
            assert began[k].wait(10)
        for k in order:
            may_end[k].set()
            error = running[k].exception(10)
            assert isinstance(error, ZeroDivisionError) if k == 0 else running[k].result() == {1}
        assert threads() == {2}  # while both threads of the pool live


def test_a_design_runs_on_one_thread():
    during = set()

    class Watching(ZeroPhaseButterworth):
        def frequency_response(self, omega):
            during.update(threads())
            return super().frequency_response(omega)

    Q = Watching(2, 0.1, 1.0)
    during.clear()
    with threadpool_limits(2, "blas"):
        synthesise(lag(), Q)
    assert during == {1}
