"""The opponents of notebook 8: each in a case whose answer is known, and one search.

They are taken from its cells.
"""

import ast
from types import SimpleNamespace

import control
import numpy as np
import pytest
from books import code
from hypothesis import given
from hypothesis import strategies as st
from plants import LOOPS, bump, frequencies, lifted

from ilctools import (
    Law,
    LearningFilter,
    NormOptimal,
    convergence,
    frequency_response,
    rms,
    run_trials,
    zero_phase_butterworth,
)
from ilctools.alternatives import gradient, pd_type
from rodlib import Rod, assumed_disturbance, assumed_reference, midr, paper_loop, sampled_response
from rodlib.paper import published

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


@given(st.integers(0, 99))
def test_of_a_minimum_phase_plant_it_undoes_a_trial(seed):
    """Two zeros inside the circle, no delay: of what P makes of an impulse, F alone is left."""
    zeros = np.random.default_rng(seed).uniform(-0.8, 0.8, 2)
    P = control.ss(control.tf(np.poly(zeros), np.poly([0.5, 0.9]), 1.0))
    impulse = np.eye(400)[:, [150]]
    undone = opponents.stable_inversion(P, 1.0, 2.9).apply(lifted(P, 400) @ impulse)
    F = zero_phase_butterworth(2, 2.9, 1.0)
    np.testing.assert_allclose(undone, F.apply(impulse), atol=1e-6)


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


def test_zero_phase_gain_and_reach_of_a_known_zero():
    """P = z^-2 (z - 2): one zero outside, so that L is (2 - z) (1 / 1) q^2 ... and finite."""
    P = control.ss(control.tf([1, -2], [1, 0, 0], 1.0))
    omega, F = frequencies(1.0), zero_phase_butterworth(2, 3.0, 1.0)
    z = np.exp(1j * omega)
    L = opponents.zero_phase_inversion(P, 1.0, 3.0).frequency_response(omega)[:, 0, 0]
    np.testing.assert_allclose(L, F.frequency_response(omega) * z**2 * (1 / z - 2), atol=1e-9)


def test_the_rods_model_has_the_zeros_of_the_paper_in_each_channel(loop):
    for i in range(2):
        zeros = control.zeros(loop.P[i, i])
        np.testing.assert_allclose(zeros[np.abs(zeros) > 1], 1.1065, atol=5e-5)


def test_h_infinity_keeps_its_level(P):
    Q = zero_phase_butterworth(2, 0.1 / P.dt, P.dt)
    omega, corner = np.append(0, frequencies(P.dt, 300)), 0.02 / P.dt
    q, response = Q.frequency_response(omega), frequency_response(P, omega)
    s = 1j * np.tan(omega * P.dt / 2) / np.tan(corner * P.dt / 2)
    for emphasis, W in ((1.0, np.ones(len(s))), (5.0, np.abs((s + 5) / (s + 1)))):
        design = opponents.h_infinity(P, Q, 2.0, 0.01, 6, emphasis, corner)
        L = design.frequency_response(omega)
        M = (W * q)[:, None, None] * (np.eye(P.noutputs) - response @ L)
        stacked = np.concatenate([M, 0.01 * L], axis=1)
        assert np.linalg.norm(stacked, 2, axis=(1, 2)).max() < 2.0


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


def test_on_the_rod_itself_they_are_those_of_a_fine_model(loop, Q):
    """The rod's own response against a model of degree 8, with a disturbance."""
    reference, disturbance = assumed_reference(), assumed_disturbance(trials=3, first=2)
    L = LearningFilter(published.matrix("L_full"), 1.0)
    fine = control.sample_system(midr(Rod(), 8), 1.0, "zoh")
    simulated, alone = (
        run_trials(loop, Law(Q, operator), reference, disturbance, 3, plant=fine).e.values
        for operator in (L, None)
    )
    omega = lines(len(reference), 1.0)
    P = loop.frequency_response(omega, sampled_response(Rod(), omega, 1.0)[:, :, [0, 2]])
    rehearsed = opponents.rehearsed(P, Q, alone, 0, L)
    np.testing.assert_allclose(rehearsed, simulated, atol=1e-4)


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


def test_tune_counts_its_evaluations_and_keeps_the_bound():
    """As many filters as were granted, whole numbers whole, and the chosen one converges."""
    loop, Q, calls = LOOPS["furnace"](), zero_phase_butterworth(2, 0.1, 1.0), []
    errors, _, _ = judge(loop, Q, 600, 2)

    def gamma(L):
        return convergence(loop, Q, L, np.linspace(0, np.pi, 600)).gamma

    def design(gain, ahead):
        calls.append((gain, ahead))
        if ahead > 60:
            raise ValueError("none")
        return pd_type(gain, 0.0, ahead, 1, 1.0)

    box = {"gain": (0.1, 3.0), "ahead": (1, 80)}
    _, parameters, L = opponents.tune(design, box, errors, gamma, 0.95, 20)
    assert len(calls) == 20 and (parameters["gain"], parameters["ahead"]) in calls
    assert gamma(L) <= 0.95 * (1 + 1e-6)
    for gain, ahead in calls:
        assert 0.1 <= gain <= 3.0 + 1e-12 and ahead in range(1, 81)
