"""The workbench without a browser: a design and its trials, their picture, and the sliders."""

import re
from contextlib import redirect_stdout
from io import StringIO

import numpy as np
import plants
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ilctools import Law, current_trial_loop, rms, run_trials, synthesise, zero_phase_butterworth
from rodlib import open_workbench, try_out, workbench

STAGE = current_trial_loop(plants.stage(), ["F"], {"x": 1.0, "F": 3.0}, {"x": "mm"})
TANKS = current_trial_loop(plants.tanks(), plants.PUMPS)
BUMP = np.sin(np.pi * np.minimum(np.arange(400) / 350, 1))[:, None] ** 2


@pytest.fixture(scope="module", autouse=True)
def few_frequencies():
    """What is tested does not depend on how many there are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workbench, "DESIGN_FREQUENCIES", 60)
        yield


@pytest.mark.parametrize("loop", [STAGE, TANKS])
def test_the_filter_is_the_synthesis_and_the_trials_are_its_laws(loop):
    r, cutoff = np.repeat(BUMP, len(loop.outputs), axis=1), 0.1 / loop.Ts
    choices = {"order": 4, "structure": "full"}
    design, trials = try_out(loop, r, cutoff=cutoff, **choices)
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    best = synthesise(loop, Q, design.omega, everywhere=True, **choices)
    assert design.value == pytest.approx(best.value, rel=1e-6)
    assert trials.identical(run_trials(loop, Law(Q, design.filter, rest=15), r, None, 10))


def test_noise_bounds_the_error_from_below():
    _, trials = try_out(STAGE, BUMP, cutoff=100.0, noise=0.1)
    assert 0.09 < rms(trials)[-1] < 0.15


@pytest.fixture(scope="module")
def panel():
    pytest.importorskip("ipywidgets")
    return open_workbench(STAGE, BUMP, order=6)


def test_knobs_begin_with_the_choices_or_the_defaults_of_the_synthesis(panel):
    L_max = synthesise(STAGE, panel.result.Q, order=6).problem.L_max
    start = {"M_max": 0.9, "L_max": L_max, "cutoff": 100.0, "order": 6}
    start |= {"noise": 0, "structure": "diagonal"}
    assert panel.kwargs == pytest.approx(start)
    panel.children[3].value = 5  # moved, a slider counts and not the choice
    assert panel.result.filter.order == panel.kwargs["order"] == 5


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
        slider.value = type(slider.value)(value)
        panel.update()
    text = output.getvalue()
    if panel.result is None:
        assert "Image" not in text and re.search("infeasible|must be", text)
    else:
        assert "Image" in text and str(panel.result.certificate) in text
