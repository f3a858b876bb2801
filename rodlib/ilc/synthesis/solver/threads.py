"""One thread for linear algebra: the matrices of a problem are small, and many threads only wait.

On one thread sums are also taken in one order, so that the digits are those of any other machine.
"""

from functools import cache, wraps

from threadpoolctl import ThreadpoolController

pools = cache(ThreadpoolController)  # to look for them takes milliseconds


def on_one_thread(function):
    """The function, with the threads of BLAS held to one while it runs."""

    @wraps(function)
    def held(*args, **keywords):
        with pools().limit(limits=1, user_api="blas"):
            return function(*args, **keywords)

    return held
