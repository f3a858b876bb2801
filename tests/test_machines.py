import machines
import matplotlib.image
import numpy as np
import pytest
from machines import ROOT, differences


@pytest.fixture
def checkouts(tmp_path):
    """Two that are the same: the texts, and two figures each."""
    for name in ("here", "there"):
        (tmp_path / name / "figures").mkdir(parents=True)
        for text in machines.TEXTS:
            (tmp_path / name / text).write_text("reproduced\n")
        for figure in ("fig01", "fig02"):
            picture(tmp_path / name / "figures" / f"{figure}.png")
    return tmp_path / "here", tmp_path / "there"


def picture(path, levels=0):
    pixels = np.full((5, 7, 3), 100, dtype=np.uint8)
    pixels[2, 3, 1] += levels
    matplotlib.image.imsave(path, pixels)


def test_the_same_results_are_the_same(checkouts):
    assert differences(*checkouts) == []


def test_every_text_must_agree_to_the_byte(checkouts):
    for text in machines.TEXTS:
        (checkouts[1] / text).write_text("reproduced \n")
    assert differences(*checkouts) == list(machines.TEXTS)


def test_one_pixel_counts_and_a_few_grey_levels_do_not(checkouts):
    figure = checkouts[1] / "figures" / "fig02.png"
    picture(figure, levels=7)
    assert differences(*checkouts) == []
    picture(figure, levels=8)
    assert differences(*checkouts) == ["figures/fig02 different"]


def test_a_figure_that_only_one_run_made_is_named(checkouts):
    picture(checkouts[1] / "figures" / "fig03.png")
    assert differences(*checkouts) == ["figures/fig03 new"]
    assert differences(*checkouts[::-1]) == ["figures/fig03 gone"]


def test_the_copy_is_that_of_the_working_tree(tmp_path):
    machines.copy_checkout(tmp_path)
    for name in ("pyproject.toml", "rodlib/paper/ledger.py", "notebooks/01-model.ipynb"):
        assert (tmp_path / name).read_bytes() == (ROOT / name).read_bytes()
    assert not (tmp_path / "build").exists() and not (tmp_path / ".venv").exists()


def test_what_this_processor_cannot_run_is_left_out_by_name(monkeypatch, capsys, tmp_path):
    said = {
        "Haswell": ("Haswell", ""),
        "Zen": ("Haswell", ""),
        "SkylakeX": ("SkylakeX", "this processor cannot run it"),
        "Nehalem": ("Nehalem", ""),
    }
    monkeypatch.setattr(machines, "LOGS", tmp_path / "logs")
    monkeypatch.setattr(machines, "probe", said.__getitem__)
    monkeypatch.setattr(
        machines, "try_machine", lambda name: ["README.md"] if name == "Nehalem" else []
    )
    assert machines.main(list(said)) == 1
    assert capsys.readouterr().out.splitlines() == [
        "Haswell          passed",
        "Zen              left out: the same code as Haswell",
        "SkylakeX         left out: this processor cannot run it",
        "Nehalem          README.md",
    ]


def test_a_processor_that_nobody_has_heard_of_is_left_out():
    assert machines.probe("Abacus")[1]
