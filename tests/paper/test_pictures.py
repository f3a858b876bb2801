import shutil

import matplotlib.pyplot as plt
import numpy as np
import pytest

from rodlib.paper.pictures import PIXELS_PER_INCH, PRECISION, compared, distance

POINT = 1 / 140  # in data: the axes are 140 points high
PIXEL = POINT * 72 / PIXELS_PER_INCH
USUAL = {
    "raised": 0.0,
    "noise": 0.0,
    "label": "rate 0.905",
    "patch": "0.94",
    "alpha": 0.1,
}
USUAL |= {
    "compression": 6,
    "markers": 5,
    "image": 5.0,
    "dash": "-",
    "left_out": 0,
    "width": 360,
    "left": 0.1,
}


def draw(folder, **changes):
    """Save a figure of many kinds of things, among them a curve that Matplotlib simplifies."""
    how = USUAL | changes
    x = np.linspace(0, 2, 2000)
    y = (
        0.6
        + 0.2 * np.sin(5 * x)
        + 0.02 * np.random.default_rng(0).standard_normal(x.size)
    )
    y = (
        y * (1 + how["noise"] * np.random.default_rng(1).uniform(-1, 1, x.size))
        + how["raised"]
    )
    figure = plt.figure(figsize=(how["width"] / 72, 200 / 72), layout="none")
    axes = figure.add_axes((how["left"], 0.15, 0.8, 0.7))
    axes.imshow(
        [[1.0, how["image"]], [2.0, 9.0]], extent=(1.2, 1.8, 0.1, 0.3), clim=(0, 10)
    )
    axes.add_patch(
        plt.Rectangle((0.1, 0.1), 0.5, 0.2, facecolor=how["patch"], edgecolor="none")
    )
    axes.fill_between(x, 0.2, y / 2, alpha=how["alpha"])
    axes.plot(
        x[how["left_out"] :], y[how["left_out"] :], how["dash"], label=how["label"]
    )
    axes.plot([0.2, 0.5, 0.9, 1.1, 1.7][: how["markers"]], [0.91] * how["markers"], "o")
    axes.set(aspect="auto", xlim=(0, 2), ylim=(0, 1), xlabel="time (s)")
    axes.legend(loc="lower left")
    with plt.rc_context({"pdf.compression": how["compression"]}):
        return save(figure, folder)


def save(figure, folder):
    folder.mkdir()
    figure.savefig(folder / "fig01.png", dpi=PIXELS_PER_INCH)
    figure.savefig(folder / "fig01.pdf", metadata={"CreationDate": None})
    plt.close(figure)
    return folder


def moved(one, other):
    return distance(one / "fig01.png", other / "fig01.png")


@pytest.fixture(scope="module")
def before(tmp_path_factory):
    return draw(tmp_path_factory.mktemp("pictures") / "before")


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"compression": 1},
        *({"noise": noise} for noise in (1e-13, 1e-9)),
        {"raised": 0.25 * PRECISION * POINT},
        {"left": 0.1 + 1e-11},  # more digits, so that lines break elsewhere
    ],
)
def test_what_rounding_moves_is_the_same(before, tmp_path, changes):
    drawn = draw(tmp_path / "drawn", **changes)
    assert moved(before, drawn) <= PRECISION
    assert compared(drawn, before) == {"fig01": "the same"}


@pytest.mark.parametrize(
    "changes",
    [
        {"raised": 0.2 * PIXEL},
        {"raised": 3 * PRECISION * POINT},
        {"label": "rate 0.902"},
        {"patch": "none"},
        {"patch": "0.98"},
        {"alpha": 0.0},
        {"alpha": 0.15},
        {"markers": 4},
        {"image": 5.5},
        {"dash": "--"},
        {"left_out": 20},
        {"width": 361},
    ],
)
def test_what_can_be_seen_is_different(before, tmp_path, changes):
    drawn = draw(tmp_path / "drawn", **changes)
    assert moved(before, drawn) > PRECISION
    assert compared(drawn, before) == {"fig01": "different"}


@pytest.mark.parametrize("points", [0.02, 0.1])
def test_the_distance_is_that_by_which_an_edge_has_moved(tmp_path, points):
    """Sloped, because Matplotlib moves others to the next pixel; 1 / 255 of one is rounding."""
    for name, y in (("one", 0.0), ("other", points)):
        figure = plt.figure(figsize=(100 / 72, 100 / 72), layout="none")
        corners = np.array([(10, 20 + y), (90, 30 + y), (90, 50), (10, 50)]) / 100
        black = {"facecolor": "black", "edgecolor": "none"}
        figure.add_artist(plt.Polygon(corners, transform=figure.transFigure, **black))
        save(figure, tmp_path / name)
    pixels = moved(tmp_path / "one", tmp_path / "other")
    assert pixels == pytest.approx(points, abs=2 * 72 / PIXELS_PER_INCH / 255)


def test_a_file_that_cannot_be_read_is_as_far_as_can_be(before, tmp_path):
    whole, broken = before / "fig01.png", tmp_path / "fig01.png"
    assert distance(whole, broken) == np.inf
    for content in (b"", b"<<<<<<< HEAD\n"):
        broken.write_bytes(content)
        assert distance(whole, broken) == np.inf
    content = whole.read_bytes()
    for k in range(100, len(content), len(content) // 11):
        broken.write_bytes(content[:-k])
        assert distance(whole, broken) == np.inf
        damaged = bytes(byte ^ 0x55 for byte in content[k : k + 9])
        broken.write_bytes(content[:k] + damaged + content[k + 9 :])
        assert distance(broken, whole) == np.inf


def test_a_figure_is_both_its_files_and_figures_that_come_and_go_are_named(
    before, tmp_path
):
    drawn, tracked = tmp_path / "drawn", tmp_path / "tracked"
    for folder in (drawn, tracked):
        shutil.copytree(before, folder)
    for name, folder in (
        ("extra02", drawn),
        ("fig03", tracked),
        ("performance", tracked),
    ):
        shutil.copy(before / "fig01.png", folder / f"{name}.png")
    assert compared(drawn, tracked) == {
        "extra02": "new",
        "fig01": "the same",
        "fig03": "gone",
    }
    shutil.copy(draw(tmp_path / "other", markers=4) / "fig01.png", drawn)
    assert compared(drawn, tracked)["fig01"] == "different"
    (drawn / "fig01.pdf").unlink()
    assert compared(drawn, tracked)["fig01"] == "different"
    assert compared(drawn, tmp_path / "nowhere") == {"extra02": "new", "fig01": "new"}
