import shutil
from base64 import b64decode

import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image

from rodlib.paper import figures, save


@pytest.fixture(autouse=True)
def style():
    with plt.style.context("rodlib.paper.style"):
        yield


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("RODLIB_RESULTS", str(tmp_path))
    return tmp_path / "figures"


def curves():
    figure, axes = plt.subplots(figsize=(3.0, 1.5))
    axes.semilogy([0, 3], [1.0, 1e-1], label="a curve")
    axes.set(ylabel="gain (K/W)", title="A title")
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


def test_figures_are_the_same_bytes_and_have_a_pdf_where_they_are_not_as_tracked(
    folder, monkeypatch
):
    monkeypatch.setattr(figures, "ROOT", folder.parent / "tracked")
    tracked = folder.parent / "tracked" / "figures"
    save(curves(), "fig02-test", "A curve.")
    folder.rename(shutil.copytree(folder, tracked).with_name("first"))
    save(curves(), "fig02-test", "A curve.")
    (picture,) = folder.iterdir()
    assert picture.read_bytes() == (tracked / picture.name).read_bytes()
    (tracked / picture.name).unlink()
    save(curves(), "fig02-test", "A curve.")
    pdf = picture.with_suffix(".pdf")
    assert pdf.read_bytes() == (tracked / pdf.name).read_bytes()


def test_an_animation_goes_through_all_of_its_time(folder, monkeypatch):
    """From a level to the next, and its picture is taken in between."""
    monkeypatch.setattr(figures, "FRAMES", 3)
    figure, axes = plt.subplots(figsize=(3.0, 1.5))
    axes.set(ylim=(-0.5, 1.5))
    (line,) = axes.plot([0, 1], [0.0, 0.0])
    levels = []

    def moves(share):
        levels.append(share)
        line.set_ydata([share, share])

    save(figure, "extra99-test", "A level.", moves)
    assert levels == [figures.STILL, 0, 0.5, 1]
    film = Image.open(folder / "extra99-test.webp")
    heights = []
    for frame in range(film.n_frames):
        film.seek(frame)
        blue = np.array(film.convert("RGB"))[:, 150, 0] < 60  # of the line, above and below axes
        heights.append(np.flatnonzero(blue[20:-20]).mean())
    assert film.n_frames == 3 and np.diff(heights)[0] == pytest.approx(np.diff(heights)[1], abs=1)
    assert heights[0] - heights[1] > 10


def test_a_notebook_shows_the_saved_file_and_its_caption(folder, monkeypatch):
    figure, _ = plt.subplots(figsize=(7.2, 2.0))
    saved = save(figure, "fig02-test", "A rod.")
    assert not plt.fignum_exists(figure.number)
    shown = []

    def display(data, **options):
        shown.append((data, options))

    monkeypatch.setattr("IPython.display.display", display)
    saved._ipython_display_()
    (picture, options), (caption, _) = shown
    assert b64decode(picture["image/png"]) == (folder / "fig02-test.png").read_bytes()
    assert picture["text/plain"] == "figures/fig02-test.png"
    assert options["metadata"]["image/png"] == {"width": 720, "alt": "A rod."}
    assert caption.data == "*A rod.*"
    assert plt.imread(folder / "fig02-test.png").shape[:2] == (400, 1440)
