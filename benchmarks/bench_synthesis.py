"""Time and memory of the synthesis against CVXPY, in the same run.

`make bench` runs this and writes the table to figures/performance.md.
"""

import multiprocessing
import resource
from concurrent.futures import ProcessPoolExecutor

import cvxpy as cp
import numpy as np
import pytest
from problems import statement

from ilctools import synthesise, zero_phase_butterworth
from rodlib import paper_choices, paper_loop
from rodlib.specimens import Spread, draw, responses


def paper_problem(frequencies=1000):
    omega = np.geomspace(1e-4, np.pi, frequencies)
    return paper_loop().frequency_response(omega), zero_phase_butterworth(2, 0.1, 1.0), omega, 1.0


def by_cvxpy(P, Q, omega, Ts, structure):
    """The paper's statement with one matrix inequality per frequency, solved by Clarabel."""
    choices = paper_choices(structure=structure)
    del choices["base"]  # of which (39) knows nothing
    return statement(P, Q.frequency_response(omega), omega, Ts, **choices)


def naive_cvxpy(P, Q, omega, Ts, structure):
    """(39) with one sigma_max atom per frequency, as it stands in the paper.

    In the plain powers of z Clarabel fails, so the taps are those of an orthonormal basis.
    """
    n, m, _ = P.shape
    q = Q.frequency_response(omega)
    z = np.exp(1j * omega * Ts)[:, None] ** np.arange(1, 11)
    R = np.linalg.qr(np.vstack([z.real, z.imag]), mode="r")
    basis = z @ np.linalg.inv(R) * np.sqrt(n)
    taps = [cp.Variable((m, m), diag=structure == "diagonal") for _ in range(10)]
    L = [sum(w * tap for w, tap in zip(row, taps, strict=True)) for row in basis]
    rates = [cp.sigma_max(q[i] * (np.eye(m) - P[i] @ L[i])) for i in range(n)]
    inside = [rate for rate, w in zip(rates, omega, strict=True) if w <= 0.02]
    bounds = [rate <= 0.9 for rate in rates] + [cp.sigma_max(L_i) <= 50 for L_i in L]
    cp.Problem(cp.Minimize(cp.sum(cp.hstack(inside))), bounds).solve(solver=cp.CLARABEL)


def structured(P, Q, omega, Ts, **changes):
    """By the toolbox's solver, with the paper's choices but for changes."""
    return synthesise(P, Q, omega, Ts, **paper_choices(**changes))


def of_the_model(P, Q, omega, Ts, structure):
    """With the plant as a model, so that what holds between the frequencies is proven."""
    changes = {"structure": structure, "everywhere": True}
    return structured(paper_loop(), Q, omega, Ts, **changes)


def for_rods(count=1000, frequencies=1000):
    """From rods whose material is off by up to 30 % to the certified filter for all of them."""
    P, Q, omega, Ts = paper_problem(frequencies)
    spread = Spread(density=0.3, heat_capacity=0.3, heat_transfer=0.3, conductivity=0.3)
    plants = responses(paper_loop(), [draw(spread, i) for i in range(count)], omega)
    return structured([P, *plants], Q, omega, Ts, M_max=0.99)


def _added_memory(function, arguments, keywords):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    function(*arguments, **keywords)
    return (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024


def peak_memory(function, *arguments, **keywords):
    """Memory that a call adds to a fresh process at its peak, MB."""
    # A spawned process would count the peak of this one as its own.
    context = multiprocessing.get_context("forkserver")
    with ProcessPoolExecutor(1, mp_context=context) as executor:
        return executor.submit(_added_memory, function, arguments, keywords).result()


def measure(benchmark, group, x, function, *arguments, rounds=3, **keywords):
    benchmark.group = group
    memory = peak_memory(function, *arguments, **keywords)
    benchmark.extra_info.update(x=x, memory=memory)
    benchmark.pedantic(function, arguments, keywords, rounds=rounds)


METHODS = {
    "naive": (naive_cvxpy, 1),
    "cvxpy": (by_cvxpy, 2),
    "structured": (structured, 9),
    "everywhere": (of_the_model, 9),
}


@pytest.mark.parametrize("structure", ["diagonal", "full"])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("frequencies", [250, 1000])
@pytest.mark.filterwarnings("ignore")
def test_against_cvxpy(benchmark, frequencies, method, structure):
    if (method, frequencies) == ("naive", 1000):
        pytest.skip("takes too long")
    problem, options = paper_problem(frequencies), {"structure": structure}
    group, (function, rounds) = f"{structure}, {frequencies}", METHODS[method]
    measure(benchmark, group, method, function, *problem, rounds=rounds, **options)


def test_a_thousand_plants(benchmark):
    measure(benchmark, "1000 rods, 1000", "structured", for_rods)
