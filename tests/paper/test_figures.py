import shutil
from base64 import b64decode

import matplotlib.pyplot as plt
import pytest

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
    pdf = tracked / picture.with_suffix(".pdf").name
    whole = pdf.read_bytes()
    pdf.write_bytes(whole[:-100])
    save(curves(), "fig02-test", "A curve.")
    assert picture.with_suffix(".pdf").read_bytes() == whole
    pdf.write_bytes(whole)
    picture.with_suffix(".pdf").unlink()
    (tracked / picture.name).unlink()
    save(curves(), "fig02-test", "A curve.")
    pdf = picture.with_suffix(".pdf")
    assert pdf.read_bytes() == (tracked / pdf.name).read_bytes()


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
