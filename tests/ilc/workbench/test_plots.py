"""The pictures of a design and of trials: what is in them, and in which units."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import same_color

from rodlib import Law, plot, run_trials, synthesise


@pytest.fixture(scope="module")
def trials():
    from rodlib import LearningFilter, paper_loop, zero_phase_butterworth

    move = np.sin(np.linspace(0, np.pi, 60))[:, None] ** 2 * [1, 2]
    L = LearningFilter(0.3 * np.eye(2)[:, :, None], 1.0)
    return run_trials(paper_loop(), Law(zero_phase_butterworth(), L), move, None, 3)


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def lines_of(ax):
    return {line.get_label(): line for line in ax.lines}


def test_a_design_is_drawn_with_its_bounds_and_its_band(loop, Q):
    design = synthesise(loop, Q, np.geomspace(1e-4, np.pi, 100))
    figure = plot(design)
    for ax, sigma, bound in zip(
        figure.axes, (design.sigma_M, design.sigma_L), (0.9, 50), strict=True
    ):
        drawn, limit = ax.lines
        assert np.array_equal(
            drawn.get_xydata(), np.stack([design.omega, sigma], axis=1)
        )
        assert [*limit.get_ydata()] == [
            bound,
            bound,
        ] and f"= {bound:g}" in limit.get_label()
        assert ax.get_xlabel() == "frequency (rad/s)" and ax.get_xscale() == "log"
        (band,) = ax.patches
        assert np.allclose(
            [band.get_x(), band.get_x() + band.get_width()], (1e-4, 0.02)
        )


def test_what_is_not_bounded_has_no_bound(loop, Q):
    peak = synthesise(
        loop, Q, np.geomspace(1e-4, np.pi, 100), objective="peak", L_max=None
    )
    assert [(len(ax.lines), len(ax.patches)) for ax in plot(peak).axes] == [
        (1, 0),
        (1, 0),
    ]


def test_trials_are_drawn_with_their_units(trials):
    rms, y, v, u = plot(trials).axes
    assert [ax.get_ylabel() for ax in (rms, y, v, u)] == [
        "RMS (K)", "y in trial 3 (K)", "v in trial 3 (K)", "u in trial 3 (W)"
    ]  # fmt: skip
    assert [ax.get_xlabel() for ax in (rms, y)] == ["trial", "time (s)"]
    (line,) = rms.lines
    power = (trials.e**2).sum("channel").mean("time")
    assert np.allclose(line.get_xydata(), np.stack([[1, 2, 3], np.sqrt(power)], axis=1))
    first, its, _, _ = y.lines
    assert np.array_equal(first.get_ydata(), trials.y[-1, :, 0])
    assert np.array_equal(its.get_ydata(), trials.reference[-1, :, 0])
    assert same_color(first.get_color(), its.get_color())
    assert np.array_equal(lines_of(u)["u: Q1"].get_ydata(), trials.u[-1, :, 0])


def test_other_units_stand_in_other_axes_and_what_is_unknown_in_none(trials):
    mixed = trials.drop_vars("u").assign_coords(output_unit=("channel", ["K", "mm"]))
    labels = [ax.get_ylabel() for ax in plot(mixed).axes]
    assert labels[:2] == ["RMS of y1 (K)", "RMS of y2 (mm)"]
    assert labels[2:4] == ["y in trial 3 (K)", "y in trial 3 (mm)"] and len(labels) == 6
    turned = trials.transpose("channel", "source", "time", "trial")
    assert np.array_equal(plot(turned).axes[1].lines[0].get_ydata(), trials.y[-1, :, 0])


def test_names_from_outside_are_no_formulas(trials):
    named = trials.assign_coords(output=("channel", ["$", r"$\frac{$"]))
    figure = plot(named)
    figure.draw_without_rendering()
    assert r"y: \$" in lines_of(figure.axes[1])


def test_the_style_of_others_is_left_alone_and_a_stranger_refused(trials):
    before = plt.rcParams.copy()
    plot(trials)
    assert plt.rcParams == before
    with pytest.raises(
        ValueError, match=r"shown = .* must be a Synthesis or a Dataset of trials"
    ):
        plot(3)
    with pytest.raises(ValueError, match="trials lack"):
        plot(xr.Dataset())
