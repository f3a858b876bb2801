"""Time and memory of the synthesis against CVXPY, in the same run.

`make bench` runs this and writes the table to figures/performance.md.
"""

import multiprocessing
import os
import platform
import resource
import timeit
import warnings
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from problems import statement
from runner import publish, table

from ilctools import synthesise, zero_phase_butterworth
from rodlib import paper_choices, paper_loop


def paper_problem(frequencies=1000):
    omega = np.geomspace(1e-4, np.pi, frequencies)
    return paper_loop().frequency_response(omega), zero_phase_butterworth(2, 0.1, 1.0), omega, 1.0


def by_cvxpy(P, Q, omega, Ts, structure):
    """The paper's statement with one matrix inequality per frequency, solved by Clarabel."""
    choices = paper_choices(structure=structure)
    del choices["base"]  # of which (39) knows nothing
    return statement(P, Q.frequency_response(omega), omega, Ts, **choices)


def structured(P, Q, omega, Ts, structure="diagonal", **changes):
    """By the toolbox's solver, with the paper's choices but for changes."""
    return synthesise(P, Q, omega, Ts, **paper_choices(structure=structure, **changes))


def of_the_model(P, Q, omega, Ts, structure):
    """With the plant as a model, so that what holds between the frequencies is proven."""
    return structured(paper_loop(), Q, omega, Ts, structure, everywhere=True)


METHODS = {  # and how often each is called
    "structured": (structured, 9),
    "structured, bounds at every frequency": (of_the_model, 9),
    "CVXPY, batched": (by_cvxpy, 2),
}
TITLES = ["problem (39)", "frequencies", "solver", "time (s)", "ratio", "memory (MB)"]


def added_memory(function, arguments):
    """What a call adds to a process at its peak, MB."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with warnings.catch_warnings(action="ignore"):
        function(*arguments)
    return (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024


def measured(function, arguments, calls):
    """The shortest time of some calls, s, and the memory that one adds to a fresh process, MB."""
    # A spawned process would count the peak of this one as its own.
    context = multiprocessing.get_context("forkserver")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        memory = pool.submit(added_memory, function, arguments).result()
    with warnings.catch_warnings(action="ignore"):
        times = timeit.repeat(lambda: function(*arguments), number=1, repeat=calls)
    return min(times), memory


def compared(structure, frequencies):
    """Rows of the table: a problem by each method."""
    problem, times = paper_problem(frequencies), []
    for label, (function, calls) in METHODS.items():
        time, memory = measured(function, (*problem, structure), calls)
        times.append(time)
        numbers = f"{time:.2f}", f"{time / times[0]:.3g}", f"{memory:.0f}"
        yield [structure, f"{frequencies}", label, *numbers]


def main(sizes=(250, 1000)):
    """The table goes to figures/performance.md."""
    structures = "diagonal", "full"
    rows = [row for n in sizes for structure in structures for row in compared(structure, n)]
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    publish("performance", f"{table(TITLES, rows)}\n\nMeasured on: {machine}.")


if __name__ == "__main__":
    main()
