import hashlib
from base64 import b64decode
from io import BytesIO

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest
from matplotlib.figure import Figure

from rodlib import Rod
from rodlib.paper import figures
from rodlib.paper.drawings import draw_block_diagram, draw_rod


@pytest.fixture(autouse=True)
def style():
    with plt.style.context("rodlib.paper.style"):
        yield


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("RODLIB_RESULTS", str(tmp_path))
    return tmp_path / "figures"


def draw():
    figure, axes = plt.subplots(1, 2)
    draw_rod(axes[0], Rod())
    draw_block_diagram(axes[1])
    return figure


def digests(folder):
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.iterdir()
    }


def test_saved_figures_are_the_same_bytes_every_time(folder):
    figures.save(draw(), "fig02-test", "A rod.")
    first = digests(folder)
    figures.save(draw(), "fig02-test", "A rod.")
    assert sorted(first) == ["fig02-test.pdf", "fig02-test.png"]
    assert digests(folder) == first


def test_a_figure_is_laid_out_as_matplotlib_would_and_drawn_once_for_each_file(
    folder, monkeypatch
):
    def curves():
        figure, axes = plt.subplots(2, 1, sharex=True)
        axes[0].loglog([1e-4, 3.0], [1.0, 1e-3], label="a curve")
        axes[0].set(ylabel="gain (K/W)", title="A title")
        axes[1].set(xlabel="frequency (rad/s)")
        axes[0].legend(loc="center left", bbox_to_anchor=(1, 0.5))
        return figure

    def places(figure):
        return [axes.get_position().bounds for axes in figure.axes]

    whole, draw, drawn = curves(), Figure.draw, []
    whole.savefig(BytesIO(), format="png")
    monkeypatch.setattr(
        Figure, "draw", lambda self, to: (draw(self, to), drawn.append(places(self)))
    )
    figure = curves()
    before = places(figure)
    figures.save(figure, "fig02-test", "A curve.")
    assert drawn == [places(whole), places(whole)]
    assert drawn[0] != before
    assert mpl.rcParams["figure.constrained_layout.use"]


def test_a_notebook_shows_the_saved_file_and_its_caption_and_draws_nothing_itself(
    folder, monkeypatch
):
    figure, _ = plt.subplots(figsize=(7.2, 2.0))
    saved = figures.save(figure, "fig02-test", "A rod.")
    assert not plt.fignum_exists(figure.number)
    shown = []
    monkeypatch.setattr(
        "IPython.display.display", lambda *a, **k: shown.append((*a, k))
    )
    saved._ipython_display_()
    (picture, how), (caption, _) = shown
    assert b64decode(picture["image/png"]) == (folder / "fig02-test.png").read_bytes()
    assert picture["text/plain"] == "figures/fig02-test.png"
    assert how["metadata"]["image/png"] == {"width": 720, "alt": "A rod."}
    assert caption.data == "*A rod.*"
    assert plt.imread(folder / "fig02-test.png").shape[:2] == (400, 1440)


@pytest.mark.parametrize(
    "rod", [Rod(), Rod(sections=6, length=1.0, sensors=(0.1, 0.5, 0.9))]
)
def test_the_drawing_shows_what_the_rod_has(rod):
    figure, axes = plt.subplots()
    draw_rod(axes, rod)
    texts = " ".join(text.get_text() for text in axes.texts)
    for i, z in enumerate(rod.sensors):
        assert f"$y_{i + 1}$ at {z * 1e3:g} mm" in texts
    assert f"Peltier {rod.sections}" in texts
    assert len(axes.patches) >= rod.sections + 1
    plt.close(figure)
