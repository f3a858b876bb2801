"""Use one thread for linear algebra: matrices here are small, and further threads only wait.

With one thread, sums are also added in one order. All machines then give the same digits.
"""

from collections.abc import Callable
from functools import cache, wraps
from threading import Lock
from typing import TypeVar

from threadpoolctl import ThreadpoolController

from ilctools.progress import watched

pools = cache(ThreadpoolController)  # finding the pools takes milliseconds
OF_A_THREAD = "openmp"  # with this layer, each calling thread has its own number of BLAS threads
Function = TypeVar("Function", bound=Callable)  # with its signature, for editors


class SharedLimit:
    """A limit of one BLAS thread, which lasts as long as any user in this process holds it.

    A user is a call that runs under this limit. Most libraries have one number of threads for the
    whole process. Suppose that each user noted this number and restored it. A user that begins
    while another user is running would then note the limit itself, and leave the limit behind. The
    users are therefore counted: the first user sets the limit, and the last user removes it.
    """

    def __init__(self):
        self._lock = Lock()
        self._users = 0

    def __enter__(self):
        with self._lock:
            if not self._users:
                self._limit = pools().limit(limits=1, user_api="blas")
            self._users += 1  # only now: if the line above raises, __exit__ is not called

    def __exit__(self, *error):
        with self._lock:
            self._users -= 1
            if not self._users:
                self._limit.restore_original_limits()


ONE_THREAD = SharedLimit()


def on_one_thread(function: Function) -> Function:
    """Wrap a function, so that BLAS uses one thread while the function runs.

    If the function takes long, a message shows that it is running. Calls may overlap in several
    threads, or call each other. When the last call has ended or raised, the number of threads is
    the same as before the first call. If a thread of the caller holds a limit of threadpoolctl
    meanwhile, this limit stays.
    """

    @wraps(function)
    def held(*args, **keywords):
        of_this_thread = pools().select(threading_layer=OF_A_THREAD).limit(limits=1)
        # The limit of this thread is set first and removed last. The shared limit therefore finds
        # and leaves one thread there. threadpoolctl obeys no other thread until the thread that has
        # set a limit leaves its context. When this thread has ended, threadpoolctl is free again.
        with of_this_thread, ONE_THREAD, watched(function.__name__):
            return function(*args, **keywords)

    return held
