"""Time and memory of the synthesis: against CVXPY in the same run, and as the problem grows.

`make bench` runs these, and a study of many rods, and writes figures/performance.
"""

import multiprocessing
import resource
from concurrent.futures import ProcessPoolExecutor

import cvxpy as cp
import numpy as np
import pytest
from study import SPREADS, study

from ilctools import synthesise, zero_phase_butterworth
from ilctools.problem.pose import pose
from ilctools.synthesis.design import certified
from rodlib import paper_choices, paper_loop
from rodlib.specimens import Spread, draw, responses

FREQUENCIES = (250, 500, 1000, 2000, 4000, 8000, 16000)
ORDERS = (5, 10, 20, 40)
SIZES = (1, 2, 3, 4, 5, 6)
RODS = (100, 300, 1000)


def paper_problem(frequencies=1000):
    omega = np.geomspace(1e-4, np.pi, frequencies)
    return paper_loop().frequency_response(omega), zero_phase_butterworth(2, 0.1, 1.0), omega, 1.0


def chain(m, frequencies=1000):
    """A plant of m coupled lags, for any size."""
    _, Q, omega, Ts = paper_problem(frequencies)
    z = np.exp(1j * omega)[:, None]
    lags = 0.02 / (z - 0.98) * (1 + 0.1 * np.arange(m)) / (1 + 0.05 * m)
    P = np.zeros((frequencies, m, m), dtype=complex)
    P[:, range(m), range(m)] = lags
    P[:, range(m - 1), range(1, m)] = 0.3 * lags[:, 1:] * lags[:, :-1]
    P[:, range(1, m), range(m - 1)] = 0.2 * lags[:, 1:] * lags[:, :-1]
    return P, Q, omega, Ts


def by_cvxpy(P, Q, omega, Ts, structure):
    """The paper's statement with one matrix inequality per frequency, solved by Clarabel."""
    choices = paper_choices(structure=structure)
    return certified(pose(P, Q, omega, Ts, **choices), solver="cvxpy")


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


def structured(P, Q, omega, Ts, start=None, **changes):
    """By the structured solvers, with the paper's choices but for changes."""
    return synthesise(P, Q, omega, Ts, start=start, **paper_choices(**changes))


def of_the_model(P, Q, omega, Ts, structure):
    """With the plant as a model, so that what holds between the frequencies is proven."""
    changes = {"structure": structure, "everywhere": True}
    return structured(paper_loop(), Q, omega, Ts, **changes)


def for_a_thousand_rods():
    """From rods whose material is off by up to 30 % to the certified filter for all of them."""
    P, Q, omega, Ts = paper_problem()
    spread = Spread(density=0.3, heat_capacity=0.3, heat_transfer=0.3, conductivity=0.3)
    plants = responses(paper_loop(), [draw(spread, i) for i in range(1000)], omega)
    return structured([P, *plants], Q, omega, Ts, M_max=0.99)


def judged(rods):
    study(SPREADS["everything"]).run(rods)


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
    "neighbour": (structured, 9),
}


@pytest.mark.parametrize("structure", ["diagonal", "full"])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("frequencies", [250, 1000])
@pytest.mark.filterwarnings("ignore")
def test_against_cvxpy(benchmark, frequencies, method, structure):
    if (method, frequencies) == ("naive", 1000):
        pytest.skip("takes too long")
    problem, options = paper_problem(frequencies), {"structure": structure}
    if method == "neighbour":
        options["start"] = structured(*problem, **options, L_max=45.0)
    group, (function, rounds) = f"{structure}, {frequencies}", METHODS[method]
    measure(benchmark, group, method, function, *problem, rounds=rounds, **options)


@pytest.mark.parametrize("frequencies", FREQUENCIES)
def test_growth_with_frequencies(benchmark, frequencies):
    problem = paper_problem(frequencies)
    measure(benchmark, "frequencies", frequencies, structured, *problem)


@pytest.mark.parametrize("order", ORDERS)
def test_growth_with_order(benchmark, order):
    measure(benchmark, "order", order, structured, *paper_problem(), order=order)


@pytest.mark.parametrize("m", SIZES)
def test_growth_with_size(benchmark, m):
    measure(benchmark, "size", m, structured, *chain(m), structure="full")


@pytest.mark.parametrize("rods", RODS)
def test_growth_with_rods(benchmark, rods):
    measure(benchmark, "rods", rods, judged, rods, rounds=1)


def test_a_thousand_plants(benchmark):
    measure(benchmark, "1000 rods, 1000", "structured", for_a_thousand_rods)
