import shutil

import matplotlib.pyplot as plt
import numpy as np
import pytest

from rodlib.paper.pictures import LEVELS, PIXELS_PER_INCH, compared

POINT = 1 / 140  # in data: the axes are 140 points high


def draw(folder, raised=0.0, label="rate 0.905", patch="0.94", width=360):
    """Save a figure with a curve that Matplotlib simplifies, a patch, a legend and markers."""
    x = np.linspace(0, 2, 2000)
    noise = np.random.default_rng(0).standard_normal(x.size)
    y = 0.6 + 0.2 * np.sin(5 * x) + 0.02 * noise + raised
    figure = plt.figure(figsize=(width / 72, 200 / 72), layout="none")
    axes = figure.add_axes((0.1, 0.15, 0.8, 0.7))
    axes.add_patch(plt.Rectangle((0.1, 0.1), 0.5, 0.2, facecolor=patch))
    axes.plot(x, y, label=label)
    axes.plot([0.2, 0.5, 0.9, 1.1, 1.7], [0.91] * 5, "o")
    axes.set(xlim=(0, 2), ylim=(0, 1), xlabel="time (s)")
    axes.legend(loc="lower left")
    folder.mkdir()
    figure.savefig(folder / "fig01.png", dpi=PIXELS_PER_INCH)
    plt.close(figure)
    return folder


@pytest.fixture(scope="module")
def before(tmp_path_factory):
    return draw(tmp_path_factory.mktemp("pictures") / "before")


@pytest.mark.parametrize(
    ("changes", "outcome"),
    [
        ({}, "the same"),
        ({"raised": 0.0025 * POINT}, "the same"),
        ({"raised": 0.03 * POINT}, "different"),
        ({"label": "rate 0.902"}, "different"),
        ({"patch": "0.98"}, "different"),
        ({"width": 361}, "different"),
    ],
)
def test_what_rounding_moves_is_the_same_and_what_is_seen_is_not(
    before, tmp_path, changes, outcome
):
    assert compared(draw(tmp_path / "drawn", **changes), before) == {"fig01": outcome}


@pytest.mark.parametrize(("levels", "outcome"), [(LEVELS, "the same"), (LEVELS + 1, "different")])
def test_one_pixel_decides(tmp_path, levels, outcome):
    gray = np.full((4, 4, 3), 100, np.uint8)
    for folder in (tmp_path / "old", tmp_path / "new"):
        folder.mkdir()
        plt.imsave(folder / "fig01.png", gray)
        gray[2, 3, 1] -= levels
    assert compared(tmp_path / "new", tmp_path / "old") == {"fig01": outcome}


def test_a_file_that_cannot_be_read_is_different(before, tmp_path):
    content = (before / "fig01.png").read_bytes()
    for broken in (b"", b"<<<<<<< HEAD\n", content[:-100], content[:5000]):
        (tmp_path / "fig01.png").write_bytes(broken)
        assert compared(tmp_path, before) == {"fig01": "different"}


def test_figures_that_come_and_go_are_named_and_others_left_alone(before, tmp_path):
    drawn = shutil.copytree(before, tmp_path / "drawn")
    tracked = shutil.copytree(before, tmp_path / "tracked")
    shutil.copy(before / "fig01.png", drawn / "extra02.png")
    for name in ("fig03", "performance"):
        shutil.copy(before / "fig01.png", tracked / f"{name}.png")
    changes = {"extra02": "new", "fig01": "the same", "fig03": "gone"}
    assert compared(drawn, tracked) == changes
