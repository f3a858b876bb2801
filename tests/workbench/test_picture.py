"""The picture: its lines are the design's, and everything fits."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from ilctools import synthesise
from rodlib import Rod, Settings, paper_choices, plot, try_out
from rodlib.paper import plant_of_rod
from rodlib.workbench.outcome import Outcome
from rodlib.workbench.picture import png


@pytest.fixture(scope="module")
def full():
    return try_out(Settings.of(plant_of_rod(Rod()), structure="full", L_max=100.0))


@pytest.fixture(scope="module")
def other(stage):
    return try_out(Settings.of(stage))


@pytest.fixture(scope="module")
def message():
    return Outcome(None, message=r"no file '$\frac{$.csv': " + 30 * "much to say ")


def test_the_lines_are_the_designs(full):
    rate, trials, gain, lags = plot(full).axes
    omega, L = full.settings.omega, full.design.filter
    P = full.settings.plant.loop.frequency_response(omega)
    q = full.settings.Q.frequency_response(omega)[:, None, None]
    M = q * (np.eye(2) - P @ L.frequency_response(omega))
    for line, matrices in ((rate.lines[0], M), (gain.lines[0], L.frequency_response(omega))):
        sigma = np.linalg.svd(matrices, compute_uv=False)[:, 0]
        np.testing.assert_allclose(line.get_ydata(), sigma, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(line.get_xdata(), omega)
    assert list(rate.lines[1].get_ydata()) == 2 * [full.design.certificate.mean_M]
    assert tuple(trials.lines[0].get_ydata()) == full.rms
    assert [rate.lines[2].get_ydata()[0], gain.lines[1].get_ydata()[0]] == [0.9, 100.0]
    c = L.coefficients
    expected = [c[0, 0], c[1, 1], c[0, 1], c[1, 0]]
    np.testing.assert_array_equal([line.get_ydata() for line in lags.lines], expected)
    names = [text.get_text() for text in lags.get_legend().get_texts()]
    assert names == ["$L_{11}$", "$L_{22}$", "$L_{12}$", "$L_{21}$"]


def test_a_design_without_bounds_or_trials_is_drawn_without_them(loop, Q):
    omega = np.geomspace(1e-4, np.pi, 100)
    choices = paper_choices(objective="peak", L_max=None)
    peak = synthesise(loop, Q, omega, **choices)
    rate, trials, gain, lags = plot(peak).axes
    assert [len(axes.lines) for axes in (rate, gain, lags)] == [1, 1, 2]
    assert trials.get_title(loc="left") == "not simulated"


def test_the_bytes_do_not_depend_on_a_notebooks_style(full):
    before, first = plt.rcParams.copy(), png(full)
    with plt.rc_context({"figure.constrained_layout.use": True, "savefig.dpi": 50}):
        assert png(full) == first
    assert plt.rcParams == before


@pytest.mark.parametrize("name", ["full", "other", "message"])
def test_everything_fits(name, request):
    figure = plot(request.getfixturevalue(name))
    figure.draw_without_rendering()
    inside = figure.bbox.padded(1)
    artists = [*figure.texts]
    for axes in figure.axes:
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


def test_a_message_stands_where_the_curves_were(message):
    figure = plot(message)
    (text,) = figure.texts
    assert not figure.axes and text.get_text().split() == message.message.split()


def test_other_items_are_refused():
    with pytest.raises(ValueError, match="design = 3"):
        plot(3)
