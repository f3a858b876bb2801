"""One thread for linear algebra: the matrices of a problem are small, and many threads only wait.

On one thread sums are also taken in one order, so that the digits are those of any other machine.
"""

from collections.abc import Callable, Iterable
from contextlib import nullcontext
from functools import cache, wraps
from itertools import repeat
from threading import Lock
from typing import TypeVar

from threadpoolctl import ThreadpoolController

from ilctools.progress import watched

pools = cache(ThreadpoolController)  # to look for them takes milliseconds
lock, inside = Lock(), []  # an entry for each function that runs; the first is what there was


Function = TypeVar("Function", bound=Callable)  # with its signature, for editors


def on_one_thread(function: Function) -> Function:
    """The function, with the threads of BLAS held to one while it runs.

    It shows that it runs, if it takes long. The threads are those of the process: where it runs in
    several at once, the first one in sets the limit, and the last one out restores what there was.
    """

    @wraps(function)
    def held(*args, **keywords):
        with lock:
            first = not inside
            inside.append(exchanged(repeat(1)) if first else None)
        try:
            with watched(function.__name__) if first else nullcontext():
                return function(*args, **keywords)
        finally:
            with lock:
                before = inside.pop()
                if not inside:
                    exchanged(before)

    return held


def exchanged(numbers: Iterable[int]) -> list[int]:
    """Set the number of threads of each BLAS; the numbers before."""
    libraries = [library for library in pools().lib_controllers if library.user_api == "blas"]
    before = [library.num_threads for library in libraries]
    for library, number in zip(libraries, numbers, strict=False):
        # threadpoolctl 3.8 ignores all threads but the first that ever set a limit
        getattr(library, "_real_set_num_threads", library.set_num_threads)(number)
    return before
