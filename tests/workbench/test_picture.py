"""The picture: its lines are the design's, and everything fits."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

from ilctools import synthesise
from rodlib import Rod, Settings, paper_choices, plot, try_out
from rodlib.paper import plant_of_rod
from rodlib.workbench.outcome import Outcome
from rodlib.workbench.picture import Picture


@pytest.fixture(scope="module")
def paper():
    return try_out(Settings.of(plant_of_rod(Rod())))


@pytest.fixture(scope="module")
def full(paper):
    return try_out(replace(paper.settings, structure="full", L_max=100.0))


@pytest.fixture(scope="module")
def other(stage):
    return try_out(Settings.of(stage))


@pytest.fixture(scope="module")
def message():
    return Outcome(None, message=r"no file '$\frac{$.csv': " + 30 * "much to say ")


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def test_the_lines_are_the_designs(paper, full):
    rate, trials, gain, lags = plot(full, before=paper).axes
    P = paper.settings.plant.loop.frequency_response(paper.settings.omega)
    q = paper.settings.Q.frequency_response(paper.settings.omega)[:, None, None]
    for number, outcome in enumerate((paper, full)):  # the one before is below
        L = outcome.design.filter.frequency_response(outcome.settings.omega)
        mean = 2 * [outcome.design.certificate.mean_M]
        assert list(rate.lines[2 * number + 1].get_ydata()) == mean
        M = q * (np.eye(2) - P @ L)
        for line, matrices in ((rate.lines[2 * number], M), (gain.lines[number], L)):
            sigma = np.linalg.svd(matrices, compute_uv=False)[:, 0]
            np.testing.assert_allclose(line.get_ydata(), sigma, rtol=1e-9, atol=1e-12)
            np.testing.assert_array_equal(line.get_xdata(), outcome.settings.omega)
        assert tuple(trials.lines[number].get_ydata()) == outcome.rms
    assert [rate.lines[4].get_ydata()[0], gain.lines[2].get_ydata()[0]] == [0.9, 100.0]
    c, old = full.design.filter.coefficients, paper.design.filter.coefficients
    expected = [old[0, 0], old[1, 1], c[0, 0], c[1, 1], c[0, 1], c[1, 0]]
    np.testing.assert_array_equal([line.get_ydata() for line in lags.lines], expected)
    assert [line.get_color() for line in lags.lines[:3]] == ["0.75", "0.75", "black"]
    names = [text.get_text() for text in lags.get_legend().get_texts()]
    assert names == ["$L_{11}$", "$L_{22}$", "$L_{12}$", "$L_{21}$"]


def test_a_design_without_bounds_or_trials_is_drawn_without_them(loop, Q):
    omega = np.geomspace(1e-4, np.pi, 100)
    choices = paper_choices(objective="peak", L_max=None)
    peak = synthesise(loop, Q, omega, **choices)
    rate, trials, gain, lags = plot(peak).axes
    assert [len(axes.lines) for axes in (rate, gain, lags)] == [1, 1, 2]
    assert trials.get_title(loc="left") == "not simulated"


def test_the_bytes_do_not_depend_on_what_was_drawn_before(paper, full, other, message):
    first = Picture().show(full, paper).png()
    with plt.rc_context({"figure.constrained_layout.use": True}):  # a notebook's style
        used = Picture().show(other)
        used.png()
    assert used.show(message, paper).png() == Picture().show(message).png()
    # designs for plants with other channels are not compared
    assert used.show(other, full).png() == Picture().show(other).png()
    assert used.show(full, paper).png() == first


@pytest.mark.parametrize("name", ["full", "other", "message"])
def test_everything_fits(name, paper, request):
    picture = Picture().show(request.getfixturevalue(name), paper)
    figure = picture.figure
    figure.draw_without_rendering()
    inside = figure.bbox.padded(1)
    artists = [*figure.texts]
    for axes in picture.axes.flat:
        if not axes.get_visible():
            continue
        artists += [axes._left_title, axes.xaxis.label]
        artists += [axes.get_legend()] if axes.get_legend() else []
        for axis in (axes.xaxis, axes.yaxis):
            low, high = axis.get_view_interval()
            ticks = axis.get_major_ticks()
            artists += [t.label1 for t in ticks if low <= t.get_loc() <= high]
        low, high = axes.get_ylim()
        for line in axes.lines:
            assert low <= min(line.get_ydata()) and max(line.get_ydata()) <= high
    boxes = [artist.get_window_extent() for artist in artists]
    boxes = [box for box in boxes if box.width * box.height > 0]
    for k, box in enumerate(boxes):
        assert inside.contains(box.x0, box.y0) and inside.contains(box.x1, box.y1)
        for other in boxes[:k]:
            x = min(box.x1, other.x1) - max(box.x0, other.x0)
            y = min(box.y1, other.y1) - max(box.y0, other.y0)
            assert min(x, y) < 3, (box, other)


def test_a_message_stands_where_the_curves_were(paper, message):
    picture = Picture().show(message, paper)
    assert not any(axes.get_visible() or axes.lines for axes in picture.axes.flat)
    (text,) = [text.get_text() for text in picture.figure.texts if text.get_text()]
    assert text.split() == message.message.split()


def test_the_style_stays_and_other_items_are_refused(paper):
    before = plt.rcParams.copy()
    plot(paper.design)
    assert plt.rcParams == before
    for wrong, message in (((3,), "design = 3"), ((paper, 3), "before = 3")):
        with pytest.raises(ValueError, match=message):
            plot(*wrong)
