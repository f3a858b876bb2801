"""The opponents of notebook 8: each in a case whose answer is known.

They are taken from its cells.
"""

import ast
from types import SimpleNamespace

import control
import numpy as np
import pytest
from books import code
from plants import LOOPS, as_matrix, bump, frequencies, lifted, random_stable

from ilctools import Law, NormOptimal, frequency_response, rms, run_trials, zero_phase_butterworth
from rodlib import paper_loop

# imports and functions of notebook 8, as they stand there
KEPT = ast.Import | ast.ImportFrom | ast.FunctionDef
BODY = ast.parse("\n".join(code("08-alternatives"))).body
NAMESPACE = {}
module = ast.Module([node for node in BODY if isinstance(node, KEPT)], [])
exec(compile(module, "08-alternatives", "exec"), NAMESPACE)
opponents = SimpleNamespace(**NAMESPACE)
PLANTS = {"rod": paper_loop} | LOOPS


@pytest.fixture(scope="module", params=["rod", "tanks", "furnace"])
def P(request):
    return PLANTS[request.param]().P


def test_the_gradient_is_the_adjoint_of_a_trial():
    model = random_stable(0)
    adjoint = as_matrix(opponents.gradient(model, 0.3).apply, 40, 2)
    np.testing.assert_allclose(adjoint, 0.3 * lifted(model, 40).T, atol=1e-9)


def test_both_inversions_are_what_they_are_called(P):
    """One inverts; the other has zero phase, and unit gain at zero, channel by channel."""
    omega, cutoff = np.append(0, frequencies(P.dt)), 0.2 / P.dt
    F = zero_phase_butterworth(2, cutoff, P.dt).frequency_response(omega)[:, None, None]
    response = frequency_response(P, omega)
    whole = opponents.stable_inversion(P, 0.7, cutoff).frequency_response(omega)
    one = np.eye(P.noutputs)
    np.testing.assert_allclose(response @ whole, 0.7 * F * one, atol=1e-9)
    L = opponents.zero_phase_inversion(P, 1.0, cutoff).frequency_response(omega)
    passed = F[:, 0, 0] > 1e-3  # beyond, what is left out of a finite filter counts
    PL = np.einsum("nii,nii->ni", response, L / F)[passed]
    np.testing.assert_allclose(PL[0], 1, rtol=1e-6)  # thousands of coefficients below 1e-9
    np.testing.assert_allclose(PL.imag, 0, atol=1e-7 * np.abs(PL).max())
    assert PL.real.min() > 0 and not np.any(L * (1 - one))


@pytest.mark.parametrize("preview", [1, 9])
def test_the_least_level_is_that_of_interpolation(preview):
    """P has a zero at 1.3, where K P is zero and z^-preview W is not: no level is below it.

    With one such zero, no delay and no price of K, that is the least level, by the maximum
    principle (G. Zames, Feedback and optimal sensitivity, 1981).
    """
    P = control.ss(control.tf([1, -1.3], [1, -0.6], 1.0))
    Q = zero_phase_butterworth(1, 0.3, 1.0)
    b, a = Q.sections[0, :3], Q.sections[0, 3:]
    W = (np.polyval(b, 1.3) / np.polyval(a, 1.3)) ** 2
    least = W * 1.3**-preview
    opponents.h_infinity(P, Q, 1.001 * least, 1e-7, preview)
    with pytest.raises(ValueError, match=r"level = .* is not reached by any filter"):
        opponents.h_infinity(P, Q, 0.999 * least, 1e-7, preview)


def test_rehearsed_trials_are_the_simulated_ones():
    loop, Q = LOOPS["tanks"](), zero_phase_butterworth(2, 0.3, 2.0)
    noise = 0.01 * np.random.default_rng(0).standard_normal((4, 900, 3))
    task = {"reference": bump(900, [1.0, 2.0, 3.0]), "trials": 4, "noise": noise}
    alone = run_trials(loop, Law(Q, None), **task).e.values
    P = loop.frequency_response(2 * np.pi * np.fft.rfftfreq(1800, loop.Ts))
    for L in (opponents.gradient(loop.P, 0.9), NormOptimal(loop.P, 0.01, 900)):
        errors = opponents.rehearsed(P, Q, alone, 5, L)
        run = run_trials(loop, Law(Q, L, rest=5), **task)
        np.testing.assert_allclose(errors, run.e.values, atol=1e-6)
        np.testing.assert_allclose(opponents.size(errors), rms(run.e).values, atol=1e-6)
