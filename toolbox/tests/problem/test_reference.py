"""The spectrum of the first error: against simulated trials, whatever P is known as."""

import control
import numpy as np
import pytest
from plants import LOOPS, axes, bump
from problems import posed
from scipy.integrate import trapezoid

from ilctools import ClosedLoop, rms, run_trials, synthesise, zero_phase_butterworth
from ilctools.law.law import Law


def first_error_of(loop, reference):
    """Of a simulated trial."""
    law = Law(zero_phase_butterworth(1, 1 / loop.Ts, loop.Ts), None)
    return run_trials(loop, law, reference, trials=1).e.values[0]


def power_of(problem, low=0.0, high=np.pi):
    """Sum of the squares of the first error, between two angles, by Parseval."""
    angles, E = problem.objective.first_error
    near = (angles >= low) & (angles <= high)
    return trapezoid((np.abs(E[near]) ** 2).sum(axis=1), angles[near]) / np.pi


@pytest.mark.parametrize("kind", [*LOOPS, "axes"])
def test_weights_are_those_of_a_simulated_trial(kind):
    """Its transform at the frequencies, by Horner; a task that ends away from rest, too."""
    loop = LOOPS[kind]() if kind in LOOPS else ClosedLoop(axes())
    m, Ts = len(loop.outputs), loop.Ts
    Q = zero_phase_butterworth(2, 0.3 / Ts, Ts)
    angles = np.geomspace(3e-3, np.pi, 400)
    back = bump(300, 1.0 + np.arange(m))
    for reference in (back, np.cumsum(back, axis=0) / 100):
        problem = posed(loop, Q, angles / Ts, reference=reference)
        e = first_error_of(loop, reference)
        e = np.pad(e, [(0, 30), (0, 0)], mode="linear_ramp")
        assert power_of(problem) == pytest.approx((e**2).sum(), rel=0.02)
        E = np.polynomial.polynomial.polyval(np.exp(-1j * angles), e)
        middles = (angles[1:] + angles[:-1]) / 2
        widths = np.diff([0, *middles, np.pi])
        amplitude = np.linalg.norm(E, axis=0) * widths
        expected = amplitude / amplitude.sum()
        assert np.abs(problem.objective.weights - expected).sum() < 0.05
        assert problem.objective.weights.sum() == pytest.approx(1)


def test_a_narrow_line_between_the_frequencies_is_not_missed():
    """A sine of a hundred periods, midway between two frequencies: they have most of the weight."""
    loop = ClosedLoop(axes())
    Q, omega = zero_phase_butterworth(2, 5.0, 0.1), np.linspace(0.5, 30, 60)
    sine = np.sin(2.75 * 0.1 * np.arange(2285))[:, None] * [1.0, 0.0]
    problem = posed(loop, Q, omega, reference=sine)
    expected = (first_error_of(loop, sine) ** 2).sum()
    assert power_of(problem, 0.225, 0.325) == pytest.approx(expected, rel=0.1)
    assert problem.objective.weights[4:6].sum() > 0.7


def test_a_table_gives_the_weights_of_its_model():
    loop, Q, omega = (
        ClosedLoop(axes()),
        zero_phase_butterworth(2, 5.0, 0.1),
        np.geomspace(0.02, 31, 200),
    )
    reference = bump(400, [1.0, 3.0])
    of_model, of_table = (
        posed(P, Q, omega, 0.1, reference=reference).objective.first_error[1]
        for P in (loop, loop.frequency_response(omega))
    )
    # splines of 200 lines, which below the first are as there
    assert np.abs(of_table - of_model).max() < 2e-3 * np.abs(of_model).max()


def resonant():
    """A stage with a mode damped by 0.001, narrower than the grid."""
    mode = control.tf([188.5**2], [1, 2 * 1e-3 * 188.5, 188.5**2])
    return control.sample_system(control.ss(mode * control.tf([60.0], [1, 60.0])), 1e-3, "zoh")


# cut-off; length of the move, after it and before it; frequencies. Below the first one P counts as
# constant, a millionth of the first error: from further down, so that it does not show where trials
# leave no more.
MOVES = {
    "stage": (60.0, 300, 300, np.geomspace(6e-3, np.pi / 1e-3, 200)),
    "furnace": (0.1, 300, 300, np.geomspace(1e-5, np.pi, 200)),
    "axes": (10.0, 300, 300, np.geomspace(1e-3, np.pi / 0.1, 200)),
    "resonant": (125.0, 50, 7450, None),  # so fast that it rings
}


@pytest.mark.parametrize("kind", MOVES)
def test_trials_that_begin_and_end_at_rest_do_what_is_predicted(kind):
    """Where Q cuts, a part of the first error stays: it is predicted, too."""
    cutoff, samples, after, omega = MOVES[kind]
    loop = (
        LOOPS[kind]() if kind in LOOPS else ClosedLoop({"axes": axes, "resonant": resonant}[kind]())
    )
    amplitude = 1.0 + np.arange(len(loop.outputs))
    reference = np.pad(bump(samples, amplitude), [(300, after), (0, 0)])
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    # what is equally large does not change what an RMS is
    design = synthesise(loop, Q, omega, reference=reference, scale=2.0 * amplitude)
    simulated = rms(run_trials(loop, design.law(), reference, trials=5).e).values
    predicted = design.certificate.predicted
    trials = [k for k in predicted if k <= 5]
    rtol = 0.02 if kind == "resonant" else 1e-3
    np.testing.assert_allclose(
        [predicted[k] for k in trials], simulated[np.array(trials) - 1], rtol=rtol
    )
    assert len(trials) > 2 and f"{predicted[2]:.3g} in trial 2" in str(design)
