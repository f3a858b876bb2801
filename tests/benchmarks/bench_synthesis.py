"""Time and memory of the synthesis: against CVXPY in the same run, and as the problem grows.

`make bench` runs these and writes figures/performance.
"""

import multiprocessing
import os
import resource
from concurrent.futures import ProcessPoolExecutor

import cvxpy as cp
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from rodlib import paper_loop, synthesise, zero_phase_butterworth
from rodlib.ilc.problem.pose import pose
from rodlib.ilc.synthesis import statement
from rodlib.ilc.synthesis.design import certified
from rodlib.ilc.synthesis.formulate import formulate
from rodlib.ilc.synthesis.solver import interior_point
from rodlib.specimens import Spread, draw, responses

FREQUENCIES = (250, 500, 1000, 2000, 4000, 8000, 16000)
ORDERS = (5, 10, 20, 40)
SIZES = (1, 2, 3, 4, 5, 6)


def paper_problem(frequencies=1000):
    omega = np.geomspace(1e-4, np.pi, frequencies)
    return paper_loop().frequency_response(omega), zero_phase_butterworth(), omega, 1.0


def chain(m, frequencies=1000):
    """A plant of m coupled lags, for any size."""
    omega = np.geomspace(1e-4, np.pi, frequencies)
    z = np.exp(1j * omega)[:, None]
    lags = 0.02 / (z - 0.98) * (1 + 0.1 * np.arange(m))[None, :] / (1 + 0.05 * m)
    P = np.zeros((frequencies, m, m), dtype=complex)
    P[:, range(m), range(m)] = lags
    P[:, range(m - 1), range(1, m)] = 0.3 * lags[:, 1:] * lags[:, :-1]
    P[:, range(1, m), range(m - 1)] = 0.2 * lags[:, 1:] * lags[:, :-1]
    return P, zero_phase_butterworth(), omega, 1.0


def by_cvxpy(P, Q, omega, Ts, structure):
    """The paper's statement with one matrix inequality per frequency, solved by Clarabel."""
    return certified(pose(P, Q, omega, Ts, structure=structure), solver="cvxpy")


def naive_cvxpy(P, Q, omega, Ts, structure):
    """(39) with one sigma_max atom per frequency, as it stands in the paper.

    In the plain powers of z Clarabel fails, so the taps are those of an orthonormal basis.
    """
    n, m, _ = P.shape
    q = Q.frequency_response(omega)
    z = np.exp(1j * omega * Ts)[:, None] ** np.arange(1, 11)
    basis = (
        z
        @ np.linalg.inv(np.linalg.qr(np.vstack([z.real, z.imag]), mode="r"))
        * np.sqrt(n)
    )
    taps = [cp.Variable((m, m), diag=structure == "diagonal") for _ in range(10)]
    L = [sum(w * tap for w, tap in zip(row, taps, strict=True)) for row in basis]
    rates = [cp.sigma_max(q[i] * (np.eye(m) - P[i] @ L[i])) for i in range(n)]
    inside = [rate for rate, w in zip(rates, omega, strict=True) if w <= 0.02]
    bounds = [rate <= 0.9 for rate in rates] + [cp.sigma_max(L_i) <= 50 for L_i in L]
    cp.Problem(cp.Minimize(cp.sum(cp.hstack(inside))), bounds).solve(solver=cp.CLARABEL)


def from_a_neighbour(start, *problem, **keywords):
    return synthesise(*problem, start=start, **keywords)


def of_the_model(*problem, **keywords):
    """With the plant as a model, so that what holds between the frequencies is proven."""
    return synthesise(paper_loop(), *problem, **keywords)


def as_users_have_it(*problem, **keywords):
    """With as many threads of BLAS as there are cores, unless the synthesis holds them back."""
    with threadpool_limits(os.cpu_count(), "blas"):
        return synthesise(*problem, **keywords)


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


@pytest.mark.parametrize("structure", ["diagonal", "full"])
@pytest.mark.parametrize(
    ("frequencies", "method"),
    [
        *((250, method) for method in ("naive", "cvxpy", "structured")),
        *(
            (1000, name)
            for name in ("cvxpy", "structured", "everywhere", "threads", "neighbour")
        ),
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_against_cvxpy(benchmark, frequencies, method, structure):
    problem = paper_problem(frequencies)
    group = f"{structure}, {frequencies}"
    if method == "naive":
        measure(benchmark, group, method, naive_cvxpy, *problem, structure, rounds=1)
    elif method == "neighbour":
        start = synthesise(*problem, structure=structure, L_max=45.0)
        keywords = {"structure": structure, "rounds": 9}
        measure(benchmark, group, method, from_a_neighbour, start, *problem, **keywords)
    elif method == "everywhere":
        keywords = {"structure": structure, "everywhere": True, "rounds": 9}
        measure(benchmark, group, method, of_the_model, *problem[1:], **keywords)
    elif method == "threads":
        keywords = {"structure": structure, "rounds": 9}
        measure(benchmark, group, method, as_users_have_it, *problem, **keywords)
    elif method == "structured":
        keywords = {"structure": structure, "rounds": 9}
        measure(benchmark, group, method, synthesise, *problem, **keywords)
    else:
        keywords = {"structure": structure, "rounds": 2}
        measure(benchmark, group, method, by_cvxpy, *problem, **keywords)


@pytest.mark.parametrize("frequencies", FREQUENCIES)
def test_growth_with_frequencies(benchmark, frequencies):
    measure(
        benchmark, "frequencies", frequencies, synthesise, *paper_problem(frequencies)
    )


@pytest.mark.parametrize("order", ORDERS)
def test_growth_with_order(benchmark, order):
    measure(benchmark, "order", order, synthesise, *paper_problem(), order=order)


@pytest.mark.parametrize("m", SIZES)
def test_growth_with_size(benchmark, m):
    measure(benchmark, "size", m, synthesise, *chain(m), structure="full")


def rods(count, frequencies):
    """Rods whose material is off by up to 30 %, and the arguments of the paper's problem."""
    P, Q, omega, Ts = paper_problem(frequencies)
    spread = Spread(density=0.3, heat_capacity=0.3, heat_transfer=0.3, conductivity=0.3)
    plants = responses(paper_loop(), [draw(spread, i) for i in range(count)], omega)
    return [P, *plants], Q, omega, Ts


def for_many(count, frequencies):
    """From the parameters of the rods to the certified filter for all of them."""
    return synthesise(*rods(count, frequencies), M_max=0.99)


def all_at_once(count, frequencies, solve):
    """The same with all bounds in one program."""
    problem = pose(*rods(count, frequencies), M_max=0.99)
    plant, frequency = np.indices((count, frequencies)).reshape(2, -1)
    return solve(formulate(problem, plant + 1, frequency))


@pytest.mark.parametrize("method", ["structured", "all", "cvxpy"])
def test_many_plants(benchmark, method):
    arguments = (10, 125)
    if method == "structured":
        return measure(benchmark, "10 rods, 125", method, for_many, *arguments)
    solve = {"all": interior_point.solve, "cvxpy": statement.solve}[method]
    measure(benchmark, "10 rods, 125", method, all_at_once, *arguments, solve, rounds=1)


def test_a_thousand_plants(benchmark):
    measure(benchmark, "1000 rods, 1000", "structured", for_many, 1000, 1000)
