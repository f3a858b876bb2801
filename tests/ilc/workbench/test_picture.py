"""The picture: its lines are the design's, whatever was drawn before, and everything fits."""

from dataclasses import replace

import numpy as np
import plants
import pytest

from rodlib import Rod, current_trial_loop
from rodlib.ilc.workbench import Outcome, Picture, Plant, Settings, try_out
from rodlib.paper.knobs import plant_of_rod


@pytest.fixture(scope="module")
def paper():
    return try_out(Settings.of(plant_of_rod(Rod())))


@pytest.fixture(scope="module")
def full(paper):
    return try_out(replace(paper.settings, structure="full", L_max=100.0))


@pytest.fixture(scope="module")
def tanks():
    loop = current_trial_loop(plants.tanks(), ["pump A", "pump B", "pump C"])
    return try_out(Settings.of(Plant("", loop), structure="full"))


@pytest.fixture(scope="module")
def message():
    return Outcome(
        None, message="there is no filter, and this is why: " + 30 * "much to say "
    )


def test_names_from_outside_are_no_formulas(tanks):
    name = r"no such file: '$\frac{$.csv'"
    picture = Picture().show(Outcome(None, message=name))
    assert picture.png() and picture._message.get_text() == name
    plant = tanks.settings.plant
    units = dict.fromkeys(plant.loop.units, r"$\frac{$")
    loop = replace(plant.loop)
    object.__setattr__(loop, "units", units)  # which would be refused
    plant = replace(plant, response=loop)
    picture = Picture().show(
        replace(tanks, settings=replace(tanks.settings, plant=plant))
    )
    assert picture.png()
    assert r"$\frac{$" in picture.axes[0, 1].get_title(loc="left")


def test_the_lines_are_the_designs(paper, full):
    (rate, trials), (gain, lags) = Picture().show(full, paper).axes
    P = paper.settings.plant.loop.frequency_response(paper.settings.omega)
    q = paper.settings.Q.frequency_response(paper.settings.omega)[:, None, None]
    for number, outcome in enumerate((paper, full)):  # the one before is below
        L = outcome.design.filter.frequency_response(outcome.settings.omega)
        mean = 2 * [outcome.design.certificate.mean_M]
        assert list(rate.lines[2 * number + 1].get_ydata()) == mean
        for axes, matrices in ((rate, q * (np.eye(2) - P @ L)), (gain, L)):
            sigma = np.linalg.svd(matrices, compute_uv=False)[:, 0]
            line = axes.lines[2 * number if axes is rate else number]
            np.testing.assert_allclose(line.get_ydata(), sigma, rtol=1e-9, atol=1e-12)
            np.testing.assert_array_equal(line.get_xdata(), outcome.settings.omega)
        assert tuple(trials.lines[number].get_ydata()) == outcome.rms
    assert [rate.lines[4].get_ydata()[0], gain.lines[2].get_ydata()[0]] == [0.9, 100.0]
    shown = [line.get_ydata() for line in lags.lines]
    c, before = full.design.filter.coefficients, paper.design.filter.coefficients
    expected = [before[0, 0], before[1, 1], c[0, 0], c[1, 1], c[0, 1], c[1, 0]]
    np.testing.assert_array_equal(shown, expected)
    assert [line.get_color() for line in lags.lines[:2]] == ["0.75", "0.75"]


def test_the_bytes_do_not_depend_on_what_was_drawn_before(paper, full, tanks, message):
    fresh = {
        name: Picture().show(*outcomes).png()
        for name, outcomes in {
            "full": (full, paper),
            "tanks": (tanks,),
            "why": (message,),
        }.items()
    }
    assert len(set(fresh.values())) == 3
    used = Picture().show(paper)
    used.png()
    assert used.show(full, paper).png() == fresh["full"]
    assert used.show(message, paper).png() == fresh["why"]
    assert (
        used.show(tanks, full).png() == fresh["tanks"]
    )  # of another plant: not in gray
    assert used.show(full, paper).png() == fresh["full"]


@pytest.mark.parametrize("name", ["full", "tanks", "message"])
def test_everything_fits(name, request):
    picture = Picture().show(
        request.getfixturevalue(name), request.getfixturevalue("paper")
    )
    figure = picture.figure
    figure.draw_without_rendering()
    inside = figure.bbox.padded(1)
    boxes = []
    for axes in picture.axes.flat:
        if axes.get_visible():
            boxes += [axes.title, axes._left_title, axes.xaxis.label, axes.get_legend()]
            for axis in (axes.xaxis, axes.yaxis):
                low, high = axis.get_view_interval()
                boxes += [
                    t.label1
                    for t in axis.get_major_ticks()
                    if low <= t.get_loc() <= high
                ]
            low, high = axes.get_ylim()
            for line in axes.lines:
                assert np.all((line.get_ydata() >= low) & (line.get_ydata() <= high))
    boxes = [
        box.get_window_extent() for box in [*boxes, *figure.texts] if box is not None
    ]
    boxes = [
        box
        for box in boxes
        if box.width * box.height > 0 and np.isfinite(box.bounds).all()
    ]
    for k, box in enumerate(boxes):
        assert inside.contains(box.x0, box.y0) and inside.contains(box.x1, box.y1)
        for other in boxes[:k]:
            x = min(box.x1, other.x1) - max(box.x0, other.x0)
            y = min(box.y1, other.y1) - max(box.y0, other.y0)
            assert min(x, y) < 3, (box, other)


def test_a_message_stands_where_the_curves_were(paper, message):
    picture = Picture().show(message, paper)
    assert not any(axes.get_visible() or axes.lines for axes in picture.axes.flat)
    (said,) = [text.get_text() for text in picture.figure.texts if text.get_text()]
    assert said.split() == message.message.split()
