"""One thread for linear algebra: the matrices of a problem are small, and many threads only wait.

On one thread sums are also taken in one order, so that the digits are those of any other machine.
"""

from collections.abc import Callable
from functools import cache, wraps
from threading import Lock
from typing import TypeVar

from threadpoolctl import ThreadpoolController

from ilctools.progress import watched

pools = cache(ThreadpoolController)  # to look for them takes milliseconds
OF_A_THREAD = "openmp"  # the layer of a BLAS whose number of threads each calling thread has
Function = TypeVar("Function", bound=Callable)  # with its signature, for editors


class SharedLimit:
    """One thread of BLAS for as long as anybody in this process uses it.

    Most libraries have one number of threads for the whole process. If each user noted the number
    and set it back, one that begins while another is running would note the limit itself, and leave
    it behind. So the users are counted: the first one sets the limit, the last one takes it back.
    """

    def __init__(self):
        self._lock = Lock()
        self._users = 0

    def __enter__(self):
        with self._lock:
            if not self._users:
                self._limit = pools().limit(limits=1, user_api="blas")
            self._users += 1  # only now: where something raises above, nothing will exit

    def __exit__(self, *error):
        with self._lock:
            self._users -= 1
            if not self._users:
                self._limit.restore_original_limits()


ONE_THREAD = SharedLimit()


def on_one_thread(function: Function) -> Function:
    """The function, with the threads of BLAS held to one while it runs.

    It shows that it runs, if it takes long. Calls may overlap in several threads, or call each
    other: when the last of them has ended or raised, the threads are as many as before the first.
    Where a thread of the caller's holds a limit of threadpoolctl meanwhile, that limit stays.
    """

    @wraps(function)
    def held(*args, **keywords):
        of_this_thread = pools().select(threading_layer=OF_A_THREAD).limit(limits=1)
        # The limit of this thread is set first and taken back last. So the shared limit finds and
        # leaves one thread there, and threadpoolctl, which obeys no other thread until the one that
        # has set a limit leaves a context, is free again when this one has ended.
        with of_this_thread, ONE_THREAD, watched(function.__name__):
            return function(*args, **keywords)

    return held
