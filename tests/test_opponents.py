"""The opponents of notebook 8: each in a case whose answer is known, and one search.

They are taken from its cells.
"""

import ast
from types import SimpleNamespace

import control
import numpy as np
import pytest
from books import code
from plants import LOOPS, bump, frequencies

from ilctools import Law, NormOptimal, frequency_response, rms, run_trials, zero_phase_butterworth
from ilctools.alternatives import gradient
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
    for design in (opponents.stable_inversion, opponents.zero_phase_inversion):
        with pytest.raises(ValueError, match=r"gain = 1\.5"):
            design(P, 1.5, cutoff)


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


def lines(samples, Ts):
    return 2 * np.pi * np.fft.rfftfreq(2 * samples, Ts)


def judge(loop, Q, samples, trials=4, noise=0.0, rest=0):
    """Rehearsed trials on the model of the design, and the reference and noise for a simulation."""
    m = loop.plant.noutputs
    reference = bump(samples, np.arange(1, m + 1))
    white = noise * np.random.default_rng(0).standard_normal((trials, samples, m))
    alone = run_trials(loop, Law(Q, None), reference, trials=trials, noise=white).e.values
    P = loop.frequency_response(lines(samples, loop.Ts))
    return lambda L: opponents.rehearsed(P, Q, alone, rest, L), reference, white


def test_rehearsed_trials_are_the_simulated_ones():
    loop, Q = LOOPS["tanks"](), zero_phase_butterworth(2, 0.3, 2.0)
    errors, reference, white = judge(loop, Q, 900, noise=0.01, rest=5)
    for L in (gradient(loop.P, 0.9), NormOptimal(loop.P, 0.01, 900)):
        run = run_trials(loop, Law(Q, L, rest=5), reference, trials=4, noise=white)
        np.testing.assert_allclose(errors(L), run.e.values, atol=1e-6)
        np.testing.assert_allclose(opponents.size(errors(L)), rms(run.e).values, atol=1e-6)


def test_tune_finds_a_tuning_that_is_known():
    """Of stable inversion, without noise, the best gain is one."""
    loop, Q = LOOPS["stage"](), zero_phase_butterworth(2, 300.0, 1e-3)
    errors, _, _ = judge(loop, Q, 600)

    def design(gain):
        return opponents.stable_inversion(loop.P, gain, 3000.0)

    found = opponents.tune(design, {"gain": (0.2, 1.5)}, errors, lambda L: 0.5, 0.9, 30)
    value, parameters, L = found
    assert parameters["gain"] == pytest.approx(1, abs=0.02)
    assert value == opponents.size(errors(L))[1:].sum()
