"""One thread for linear algebra: the matrices of a problem are small, and many threads only wait.

On one thread sums are also taken in one order, so that the digits are those of any other machine.
"""

from collections.abc import Callable
from functools import cache, wraps
from typing import TypeVar

from threadpoolctl import ThreadpoolController

from ilctools.progress import watched

pools = cache(ThreadpoolController)  # to look for them takes milliseconds
Function = TypeVar("Function", bound=Callable)  # with its signature, for editors


def on_one_thread(function: Function) -> Function:
    """The function, with the threads of BLAS held to one while it runs.

    It shows that it runs, if it takes long. The threads are those of the process: where it runs in
    several threads at once, the limit is that of the one that comes or goes last.
    """

    @wraps(function)
    def held(*args, **keywords):
        with pools().limit(limits=1, user_api="blas"), watched(function.__name__):
            return function(*args, **keywords)

    return held
