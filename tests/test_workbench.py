"""The workbench without a browser: a design and its trials, their picture, and the sliders."""

import re
from contextlib import redirect_stdout
from io import StringIO

import control
import numpy as np
import plants
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ilctools import ClosedLoop, Law, current_trial_loop, rms, synthesise, zero_phase_butterworth
from rodlib import open_workbench, plot, try_out, workbench

STAGE = current_trial_loop(plants.stage(), ["F"], {"x": 1.0, "F": 3.0}, {"x": "mm"})
TANKS = current_trial_loop(plants.tanks(), plants.PUMPS)
BUMP = np.sin(np.pi * np.minimum(np.arange(400) / 350, 1))[:, None] ** 2


@pytest.fixture(scope="module", autouse=True)
def few_frequencies():
    """What is tested does not depend on how many there are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workbench, "FREQUENCIES", 60)
        yield


@pytest.mark.parametrize(("loop", "uncertainty"), [(STAGE, 0), (TANKS, 0), (TANKS, 0.01)])
def test_the_filter_is_the_synthesis_and_the_trials_are_its_laws(loop, uncertainty):
    """Three of them by hand, simulated by python-control."""
    r, cutoff = np.repeat(BUMP, len(loop.outputs), axis=1), 0.1 / loop.Ts
    choices = {"order": 4, "structure": "full"}
    design, trials = try_out(loop, r, cutoff=cutoff, uncertainty=uncertainty, **choices)
    Q, P = zero_phase_butterworth(2, cutoff, loop.Ts), loop.frequency_response(design.omega)
    size = np.linalg.svd(P, compute_uv=False)[:, 0]
    bounds = {"uncertainty": uncertainty * size} if uncertainty else {"everywhere": True}
    L, best = design.filter, synthesise(loop, Q, design.omega, **bounds | choices)
    assert design.value == pytest.approx(best.value, rel=1e-6)
    if uncertainty:
        np.testing.assert_allclose(design.problem.radius, best.problem.radius)
    v, errors = np.zeros_like(r), []
    for _ in range(3):
        w = np.hstack([r + v, np.zeros((len(r), len(loop.disturbances)))])
        e = r - np.atleast_2d(control.forced_response(loop.closed, U=w.T).outputs).T
        errors.append(np.sqrt(np.mean(np.sum(e**2, axis=1))))
        v = Law(Q, L, rest=15).next(v, e)
    assert trials.sizes["trial"] == 10
    np.testing.assert_allclose(rms(trials)[:3], errors, rtol=1e-6, atol=1e-9)


def test_the_picture_shows_the_design_and_its_trials():
    reference = np.repeat(BUMP, 3, axis=1)
    design, trials = try_out(TANKS, reference, cutoff=0.1 / TANKS.Ts, order=3, structure="full")
    figure, problem, L = plot(design, trials), design.problem, design.filter
    rate, error, gain, lags = (axes.lines for axes in figure.axes)
    expected = [design.sigma_M, 2 * [problem.M_max], 2 * [design.certificate.mean_M]]
    expected += [rms(trials), design.sigma_L, 2 * [problem.L_max]]
    for line, values in zip([*rate, *error, *gain], expected, strict=True):
        np.testing.assert_array_equal(line.get_ydata(), values)
    drawn = {line.get_label(): [*line.get_ydata()] for line in lags}
    entries = np.ndindex(L.coefficients.shape[:2])
    assert drawn == {f"$L_{{{i + 1}{j + 1}}}$": [*L.coefficients[i, j]] for i, j in entries}
    corners = figure.get_tightbbox().get_points()
    assert (corners >= 0).all() and (corners <= figure.get_size_inches()).all()


def test_noise_bounds_the_error_from_below():
    _, trials = try_out(STAGE, BUMP, cutoff=100.0, noise=0.1)
    assert 0.09 < rms(trials)[-1] < 0.15


@pytest.fixture(scope="module")
def panel():
    pytest.importorskip("ipywidgets")
    return open_workbench(STAGE, BUMP, order=6)


def test_knobs_begin_with_the_choices_or_the_defaults_of_the_synthesis(panel):
    L_max = synthesise(STAGE, panel.result.Q, order=6).problem.L_max
    start = {"M_max": 0.9, "L_max": L_max, "cutoff": 100.0, "Q_order": 2, "order": 6}
    start |= {"uncertainty": 0, "noise": 0, "structure": "diagonal"}
    assert panel.kwargs == pytest.approx(start)
    panel.children[4].value = 5  # moved, a slider counts and not the choice
    assert panel.result.filter.order == panel.kwargs["order"] == 5
    with pytest.raises(ValueError, match="P"):
        open_workbench(ClosedLoop(Ts=1.0, outputs=["y"]), BUMP)


@settings(max_examples=3)
@given(data=st.data())
def test_every_position_of_the_knobs_has_a_picture_or_a_reason(panel, data):
    """ipywidgets logs an exception, which a notebook would show with its traceback."""
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(StringIO()) as output:
        patch.setattr(panel.log, "warning", pytest.fail)
        *sliders, _, _ = panel.children
        for slider in sliders:
            slider.unobserve_all()  # or each is shown twice
        slider = data.draw(st.sampled_from(sliders))
        value = slider.min + data.draw(st.floats(0, 1)) * (slider.max - slider.min)
        slider.value = 10**value if "Log" in type(slider).__name__ else type(slider.value)(value)
        panel.update()
    text = output.getvalue()
    if panel.result is None:
        assert "Image" not in text and re.search("infeasible|must be", text)
    else:
        assert "Image" in text and str(panel.result.certificate) in text
