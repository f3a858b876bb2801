import hashlib
from base64 import b64decode

import matplotlib.pyplot as plt
import pytest

from rodlib import Rod
from rodlib.paper import figures


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("RODLIB_RESULTS", str(tmp_path))
    return tmp_path / "figures"


def draw():
    figure, axes = plt.subplots(1, 2)
    figures.draw_rod(axes[0], Rod())
    figures.draw_block_diagram(axes[1])
    return figure


def digests(folder):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


def test_saved_figures_are_the_same_bytes_every_time(folder):
    figures.save(draw(), "fig02-test", "A rod.")
    first = digests(folder)
    figures.save(draw(), "fig02-test", "A rod.")
    assert sorted(first) == ["fig02-test.pdf", "fig02-test.png"]
    assert digests(folder) == first


def test_a_notebook_shows_the_saved_file_and_its_caption_and_draws_nothing_itself(
    folder, monkeypatch
):
    figure, _ = plt.subplots(figsize=(7.2, 2.0))
    saved = figures.save(figure, "fig02-test", "A rod.")
    assert not plt.fignum_exists(figure.number)
    shown = []
    monkeypatch.setattr("IPython.display.display", lambda *a, **k: shown.append((*a, k)))
    saved._ipython_display_()
    (picture, how), (caption, _) = shown
    assert b64decode(picture["image/png"]) == (folder / "fig02-test.png").read_bytes()
    assert picture["text/plain"] == "figures/fig02-test.png"
    assert how["metadata"]["image/png"] == {"width": 720, "alt": "A rod."}
    assert caption.data == "*A rod.*"
    assert plt.imread(folder / "fig02-test.png").shape[:2] == (400, 1440)


@pytest.mark.parametrize("rod", [Rod(), Rod(sections=6, length=1.0, sensors=(0.1, 0.5, 0.9))])
def test_the_drawing_shows_what_the_rod_has(rod):
    figure, axes = plt.subplots()
    figures.draw_rod(axes, rod)
    texts = " ".join(text.get_text() for text in axes.texts)
    for i, z in enumerate(rod.sensors):
        assert f"$y_{i + 1}$ at {z * 1e3:g} mm" in texts
    assert f"Peltier {rod.sections}" in texts
    assert len(axes.patches) >= rod.sections + 1
    plt.close(figure)
