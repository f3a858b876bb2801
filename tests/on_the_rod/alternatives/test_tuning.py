"""Rehearsed trials against simulated ones, and a search that can be followed by hand."""

import control
import numpy as np
import pytest
from plants import LOOPS, bump

from ilctools import (
    Law,
    LearningFilter,
    NormOptimal,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.alternatives import Rehearsal, gradient, lines, p_type, stable_inversion, tune
from ilctools.trials.run import rms
from rodlib import Rod, midr, paper_choices, sampled_response
from rodlib.case import assumed_disturbance, assumed_reference
from rodlib.paper import published


def rehearsal(loop, Q, samples, trials=4, noise=0.0, rest=0):
    """On the model of the design, and the reference and noise for a simulation."""
    m = loop.plant.noutputs
    reference = bump(samples, np.arange(1, m + 1))
    white = noise * np.random.default_rng(0).standard_normal((trials, samples, m))
    alone = run_trials(loop, Law(Q, None), reference, trials=trials, noise=white)
    P = loop.frequency_response(lines(samples, loop.Ts))
    return Rehearsal(P, Q, alone.e.values, rest), reference, white


def test_rehearsed_trials_are_the_simulated_ones():
    loop, Q = LOOPS["tanks"](), zero_phase_butterworth(2, 0.3, 2.0)
    rehearsed, reference, white = rehearsal(loop, Q, 900, noise=0.01, rest=5)
    for L in (gradient(loop.P, 0.9), NormOptimal(loop.P, 0.01, 900)):
        run = run_trials(loop, Law(Q, L, rest=5), reference, trials=4, noise=white)
        np.testing.assert_allclose(rehearsed.errors(L), run.e.values, atol=1e-6)
        np.testing.assert_allclose(rehearsed.rms(L), rms(run.e).values, atol=1e-6)


def test_on_the_rod_itself_they_are_those_of_a_fine_model(loop, Q):
    """The rod's own response against a model of degree 8, with a disturbance."""
    reference, disturbance = assumed_reference(), assumed_disturbance(trials=3, first=2)
    L = LearningFilter(published.matrix("L_full"), 1.0)
    fine = control.sample_system(midr(Rod(), 8), 1.0, "zoh")
    law = (loop, Law(Q, L), reference, disturbance, 3)
    simulated = run_trials(*law, plant=fine).e.values
    alone = run_trials(loop, Law(Q, None), reference, disturbance, 3, plant=fine).e.values
    omega = lines(len(reference), 1.0)
    P = loop.frequency_response(omega, sampled_response(Rod(), omega, 1.0)[:, :, [0, 2]])
    np.testing.assert_allclose(Rehearsal(P, Q, alone).errors(L), simulated, atol=1e-4)


def test_rate_is_that_of_the_certificate(loop, Q, omega):
    rehearsed, _, _ = rehearsal(loop, Q, 2500, 2)
    design = synthesise(loop, Q, omega, 1.0, **paper_choices())
    assert rehearsed.rate(design.filter) == pytest.approx(design.certificate.grid_M, abs=2e-3)
    assert rehearsed.rate(stable_inversion(loop.P, 0.25)) == pytest.approx(0.75, abs=1e-9)


def test_tune_finds_a_tuning_that_is_known():
    """Of stable inversion, without noise, the best gain is one."""
    loop, Q = LOOPS["stage"](), zero_phase_butterworth(2, 300.0, 1e-3)
    rehearsed, _, _ = rehearsal(loop, Q, 600)

    def design(gain):
        return stable_inversion(loop.P, gain, 3000.0)

    tuned = tune(design, {"gain": (0.2, 1.5)}, rehearsed, evaluations=30)
    assert tuned.parameters["gain"] == pytest.approx(1, abs=0.02)
    assert tuned.value == rehearsed.rms(tuned.filter)[1:].sum()
    with pytest.warns(UserWarning, match=r"edge of box\['gain'\] = .* widen"):
        tune(design, {"gain": (0.2, 0.8)}, rehearsed, evaluations=12)
    with pytest.warns(UserWarning, match=r"edge of box\['divisor'\] = .* widen"):
        tune(
            lambda divisor: design(1 / divisor), {"divisor": (1.25, 5.0)}, rehearsed, evaluations=12
        )


def test_tune_counts_its_evaluations_and_keeps_the_bound():
    """As many filters as were granted, whole numbers whole, and the chosen one converges."""
    loop, Q, calls = LOOPS["furnace"](), zero_phase_butterworth(2, 0.1, 1.0), []
    rehearsed, _, _ = rehearsal(loop, Q, 600, 2)

    def design(gain, ahead):
        calls.append((gain, ahead))
        if ahead > 60:
            raise ValueError("none")
        return p_type(gain, ahead, 1, 1.0)

    tuned = tune(design, {"gain": (0.1, 3.0), "ahead": (1, 80)}, rehearsed, 0.95, 20)
    assert len(calls) == 20 and all(isinstance(ahead, int) for _, ahead in calls)
    assert (tuned.parameters["gain"], tuned.parameters["ahead"]) in calls
    assert rehearsed.rate(tuned.filter) <= 0.95 * (1 + 1e-6)
    assert all(0.1 <= gain <= 3.0 + 1e-12 and 1 <= n <= 80 for gain, n in calls)


def test_arguments_of_rehearsal_and_search_are_checked(loop, Q):
    rehearsed, _, _ = rehearsal(loop, Q, 300, 2)
    with pytest.raises(ValueError, match="P has shape"):
        Rehearsal(rehearsed.P[1:], Q, rehearsed.alone)
    with pytest.raises(ValueError, match="L acts on 1 channels"):
        rehearsed.errors(LearningFilter([[[1.0]]], 1.0))

    def design(step):
        return gradient(loop.P, step)

    for bounds in ((0.0, 1.0), (2.0, 1.0)):
        with pytest.raises(ValueError, match=r"box\['step'\]"):
            tune(design, {"step": bounds}, rehearsed)
    with pytest.raises(ValueError, match=r"M_max = 0\.5 nowhere"):
        tune(design, {"step": (0.1, 1.0)}, rehearsed, 0.5, 6)
