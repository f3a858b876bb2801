"""Rehearsed trials against simulated ones, and a search that can be followed by hand."""

import control
import numpy as np
import pytest
from plants import furnace, stage, tanks

from rodlib import (
    Law,
    LearningFilter,
    Rod,
    current_trial_loop,
    midr,
    run_trials,
    sampled_response,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.case import assumed_disturbance, assumed_reference
from rodlib.ilc import NormOptimal
from rodlib.ilc.alternatives import Rehearsal, gradient, lines, stable_inversion, tune
from rodlib.ilc.trials.run import rms
from rodlib.paper import published


def rehearsal(loop, Q, samples, trials=4, noise=0.0, rest=0):
    """On the model of the design, and the reference and noise for a simulation."""
    m = loop.plant.noutputs
    reference = np.outer(
        np.sin(np.pi * np.arange(samples) / samples) ** 4, np.arange(1, m + 1)
    )
    white = noise * np.random.default_rng(0).standard_normal((trials, samples, m))
    alone = run_trials(
        loop, Law(Q, None), reference, trials=trials, noise=white
    ).e.values
    P = loop.frequency_response(lines(samples, loop.Ts))
    return Rehearsal(P, Q, alone, rest), reference, white


PLANTS = {
    "stage": lambda: (
        current_trial_loop(stage(), ["F"], {"x": 5.0, "F": 20.0}),
        300.0,
        600,
    ),
    "tanks": lambda: (
        current_trial_loop(tanks(), ["pump A", "pump B", "pump C"]),
        0.3,
        900,
    ),
    "furnace": lambda: (current_trial_loop(furnace()), 0.1, 600),
}


@pytest.mark.parametrize("name", PLANTS)
def test_rehearsed_trials_are_the_simulated_ones(name):
    loop, cutoff, samples = PLANTS[name]()
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    rehearsed, reference, white = rehearsal(loop, Q, samples, noise=0.01, rest=5)
    for L in (gradient(loop.P, 0.9), NormOptimal(loop.P, 0.01, samples)):
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
    alone = run_trials(
        loop, Law(Q, None), reference, disturbance, 3, plant=fine
    ).e.values
    omega = lines(len(reference), 1.0)
    P = loop.frequency_response(
        omega, sampled_response(Rod(), omega, 1.0)[:, :, [0, 2]]
    )
    np.testing.assert_allclose(Rehearsal(P, Q, alone).errors(L), simulated, atol=1e-4)


def test_rate_is_that_of_the_certificate(loop, Q, omega):
    rehearsed, _, _ = rehearsal(loop, Q, 2500, 2)
    design = synthesise(loop, Q, omega, 1.0)
    assert rehearsed.rate(design.filter) == pytest.approx(
        design.certificate.grid_M, abs=2e-3
    )
    assert rehearsed.rate(stable_inversion(loop.P, 0.25)) == pytest.approx(
        0.75, abs=1e-9
    )


def test_tune_finds_a_tuning_that_is_known():
    """Of stable inversion, without noise, the best gain is one."""
    loop, cutoff, samples = PLANTS["stage"]()
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    rehearsed, _, _ = rehearsal(loop, Q, samples)
    found = tune(
        lambda gain: stable_inversion(loop.P, gain, 3000.0), {"gain": (0.2, 1.0)}, rehearsed,
        evaluations=30,
    )  # fmt: skip
    assert found.parameters["gain"] == pytest.approx(1, abs=0.02)
    assert found.value == rehearsed.rms(found.filter)[1:].sum()


def test_tune_counts_its_evaluations_and_keeps_the_bound():
    """As many filters as were granted, whole numbers whole, and the chosen one converges."""
    loop, cutoff, samples = PLANTS["furnace"]()
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    rehearsed, _, _ = rehearsal(loop, Q, samples, 2)
    asked = []

    def design(share, ahead):
        asked.append((share, ahead))
        if ahead > 60:
            raise ValueError("none")
        coefficients = np.zeros((1, 1, ahead))
        coefficients[0, 0, -1] = share
        return LearningFilter(coefficients, 1.0)

    found = tune(design, {"share": (0.1, 3.0), "ahead": (1, 80)}, rehearsed, 0.95, 20)
    assert len(asked) == 20 and all(isinstance(ahead, int) for _, ahead in asked)
    assert (found.parameters["share"], found.parameters["ahead"]) in asked
    assert rehearsed.rate(found.filter) <= 0.95 * (1 + 1e-6)
    assert all(
        0.1 <= share <= 3.0 + 1e-12 and 1 <= ahead <= 80 for share, ahead in asked
    )


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
