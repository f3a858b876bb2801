import shutil

import matplotlib.pyplot as plt
import nbformat
import numpy as np
import pytest
from nbformat import v4
from nbval.plugin import IPyNbFile

from rodlib.paper.comparison import PIXELS_PER_INCH, different_figures, same_picture, same_text

PIXEL = 72 / 200 / 140  # in data: the axes are 140 points high
TEXT = """rate at most 0.8833, proven at all frequencies; largest near 0.042 rad/s
gain -0.5, below 1e-09 in 4 of 12 trials, 2500 samples, peak 1.2e+08
<td>0.10</td><td>-0.0</td><td>reproduced</td>
"""


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("-0.0", "0.0"), ("2500", "2502"), ("12 ", "12   "), ("0.10", "0.099"),
    ],
)  # fmt: skip
def test_a_last_digit_and_alignment_are_not_seen(before, after):
    assert same_text(TEXT, TEXT.replace(before, after))


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("0.8833", "-0.8833"), ("0.8833", "0.883"), ("-0.5", "0.5"), ("1e-09", "1e-08"),
        ("4 of", "5 of"), ("4 of", "4 or"), ("2500", "2510"), ("+08", "+09"),
        ("reproduced", "differs"), ("<td>-0.0</td>", ""), ("0.8833", "nan"),
        (TEXT[TEXT.index("<td>") :], ""), ("\n", ""), ("near 0.042", "near"),
    ],
)  # fmt: skip
def test_what_a_reader_sees_in_a_text_is_found(before, after):
    assert before in TEXT and not same_text(TEXT, TEXT.replace(before, after, 1))


def draw(folder, raised=0.0, label="rate 0.905", patch="0.94", width=360):
    """A figure with a curve that Matplotlib simplifies, a patch and a legend; its PNG is saved."""
    x = np.linspace(0, 2, 2000)
    noise = np.random.default_rng(0).standard_normal(x.size)
    y = 0.6 + 0.2 * np.sin(5 * x) + 0.02 * noise + raised
    figure = plt.figure(figsize=(width / 72, 200 / 72), layout="none")
    axes = figure.add_axes((0.1, 0.15, 0.8, 0.7))
    axes.add_patch(plt.Rectangle((0.1, 0.1), 0.5, 0.2, facecolor=patch))
    axes.plot(x, y, label=label, linewidth=0.8)
    axes.set(xlim=(0, 2), ylim=(0, 1), xlabel="time (s)")
    axes.legend(loc="lower left")
    figure.savefig(folder / "fig01.png", dpi=PIXELS_PER_INCH)
    plt.close(figure)
    return figure


@pytest.fixture(scope="module")
def before(tmp_path_factory):
    folder = tmp_path_factory.mktemp("before")
    draw(folder).savefig(folder / "fig01.pdf")
    return folder


@pytest.mark.parametrize(
    ("changes", "names"),
    [
        ({"raised": 0.5 * PIXEL}, []),
        ({"raised": 2 * PIXEL}, ["fig01"]),
        ({"label": "rate 0.902"}, ["fig01"]),
        ({"patch": "0.85"}, ["fig01"]),
        ({"width": 361}, ["fig01"]),
    ],
)
def test_half_a_pixel_is_the_same_and_what_is_seen_is_not(before, tmp_path, changes, names):
    draw(tmp_path, **changes)
    assert different_figures(tmp_path, before) == names


@pytest.mark.parametrize(
    ("pixels", "levels", "same"), [(1, 30, True), (1, 90, False), (30, 30, False)]
)
def test_a_speck_is_the_same_and_a_dot_is_not(before, tmp_path, pixels, levels, same):
    picture = plt.imread(before / "fig01.png").copy()
    picture[100, 200 : 200 + pixels, :3] -= levels / 255
    plt.imsave(tmp_path / "fig01.png", picture)
    assert same_picture(tmp_path / "fig01.png", before / "fig01.png") == same


def test_a_pdf_that_is_cut_or_missing_is_named(before, tmp_path):
    tracked = shutil.copytree(before, tmp_path / "tracked")
    path = tracked / "fig01.pdf"
    whole = path.read_bytes()
    for kept in range(0, len(whole), 97):
        path.write_bytes(whole[:kept])
        assert different_figures(before, tracked) == ["fig01"], kept
    path.write_bytes(whole)
    assert different_figures(before, tracked) == []
    path.unlink()
    assert different_figures(before, tracked) == ["fig01"]


def test_figures_that_come_or_cannot_be_read_are_named(before, tmp_path):
    drawn = shutil.copytree(before, tmp_path / "drawn")
    shutil.copy(before / "fig01.png", drawn / "extra02.png")
    assert different_figures(drawn, before) == ["extra02"]
    content = (before / "fig01.png").read_bytes()
    for broken in (b"", b"<<<<<<< HEAD\n", content[:-100]):
        (drawn / "fig01.png").write_bytes(broken)
        assert "fig01" in different_figures(drawn, before)


def test_nbval_lets_a_last_digit_pass_and_finds_a_word(request, tmp_path):
    """As nbval compares the outputs of a cell, with what conftest.py makes of it."""
    book = v4.new_notebook(cells=[v4.new_code_cell()])
    nbformat.write(book, tmp_path / "book.ipynb")
    (cell,) = IPyNbFile.from_parent(request.session, path=tmp_path / "book.ipynb").collect()
    request.config.hook.pytest_itemcollected(item=cell)
    for now, same in (("0.8834 K", True), ("0.8835 K", False), ("0.8833 s", False)):
        outputs = [[v4.new_output("stream", text=f"{text}\n")] for text in (now, "0.8833 K")]
        assert cell.compare_outputs(*outputs) is same
