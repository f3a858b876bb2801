"""The workbench in JupyterLab in a browser, against designs that are made here.

One reader, one workbench: each test begins where the one before has left the knobs.
"""

from dataclasses import replace

import numpy as np
import pytest

from ilctools import load_law
from rodlib import Rod, Settings, try_out
from rodlib.paper import plant_of_rod
from rodlib.workbench.picture import png

OUTLINE = "handle => { handle.focus(); return getComputedStyle(handle).outlineStyle; }"
TEN_KEYS = """handle => { for (let k = 0; k < 10; k++)
    handle.dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowLeft', bubbles: true})); }"""


@pytest.fixture(scope="module")
def paper():
    return Settings.of(plant_of_rod(Rod()))


def drawn(settings):
    """The picture of settings, made here."""
    return png(try_out(settings))


def run(lines):
    """What the lines make, in a namespace of their own."""
    namespace = {}
    exec(lines, namespace)
    return namespace


def test_it_begins_with_the_papers_choice(reader, paper, shots):
    assert reader.picture == drawn(paper)
    assert "mean of sigma_max(M) over the band: 0.2046" in reader.certificate
    for width in (1280, 800):
        reader.show(width, 1500, shots / f"start-{width}.png")
        assert reader.overflow == []


def test_a_slider_is_followed_when_it_is_let_go(reader, paper):
    before = reader.picture
    reader.drag("M_max", 0.985, release=False)
    assert reader.picture == before
    picture = reader.after(reader.page.mouse.up)
    moved = replace(paper, M_max=float(reader.read("M_max")))
    assert moved.M_max > 0.95
    assert picture == drawn(moved)


def test_the_newest_setting_counts(reader, paper):
    """Ten changes within the time of two designs."""
    last, shown = float(reader.read("M_max")), len(reader.times)
    handle = reader.knob("M_max").locator(".noUi-handle")
    assert handle.evaluate(OUTLINE) == "solid"  # whose keys these are
    handle.evaluate(TEN_KEYS)
    wanted = f"{last - 0.01:.3f}"
    reader.until(f"M_max={float(wanted)},")
    assert len(reader.times) - shown < 8
    assert float(reader.read("M_max")) == float(wanted)
    newest = replace(paper, M_max=float(wanted))
    reader.type("M_max", "0.93")
    reader.until_drawn(drawn(replace(newest, M_max=0.93)))


def test_the_lines_run_as_they_were_copied(reader, paper, shots):
    reader.choose("structure", "full")
    reader.show(1280, 1500, shots / "full.png")
    reader.page.locator(
        ".jp-OutputArea-output", has=reader.page.locator(".widget-image")
    ).screenshot(path=shots / "workbench.png")
    reader.after(reader.type, "uncertainty (%)", "2")
    reader.page.locator(".workbench-python").click()
    reader.page.keyboard.press("Control+c")
    copied = reader.page.evaluate("() => navigator.clipboard.readText()")
    assert copied.split() == reader.python.split()
    design = run(copied)["design"]
    M_max = float(reader.read("M_max"))
    wanted = replace(paper, M_max=M_max, structure="full", uncertainty=2.0)
    direct = try_out(wanted).design
    assert np.array_equal(design.filter.coefficients, direct.filter.coefficients)
    assert reader.picture == drawn(wanted)


def test_what_is_saved_is_what_is_shown(reader, tmp_path):
    reader.type("file", str(tmp_path / "law.json"))
    reader.page.get_by_text("save Q and L").click()
    reader.page.get_by_text("saved: ").wait_for()
    namespace = run(reader.python)
    law = load_law(tmp_path / "law.json")
    Q, L = law.Q, law.L
    assert namespace["Q"] == Q
    assert np.array_equal(L.coefficients, namespace["design"].filter.coefficients)
    reader.type("file", str(tmp_path / "nowhere" / "law.json"))
    reader.page.get_by_text("save Q and L").click()
    reader.page.get_by_text("not saved: ").wait_for()


def test_infeasible_and_back(reader, paper, shots):
    reader.after(reader.type, "uncertainty (%)", "0")
    reader.choose("structure", "diagonal")
    reader.after(reader.type, "L_max", "20")
    reader.after(reader.type, "M_max", "0.5")
    infeasible = replace(paper, L_max=20.0, M_max=0.5)
    assert reader.page.locator(".widget-image").is_hidden()  # it would say the same once more
    assert try_out(infeasible).message.split() == reader.certificate.split()
    assert reader.python.strip() == "" and reader.page.get_by_text("save Q and L").is_disabled()
    for width in (1280, 800):
        reader.show(width, 1500, shots / f"infeasible-{width}.png")
        assert reader.overflow == []
    picture = reader.after(reader.type, "M_max", "0.869")
    assert picture == drawn(replace(infeasible, M_max=0.869))


def test_nonsense_in_a_field_does_no_harm(reader, paper):
    kept = reader.read("L_max")
    for nonsense in ("abc", "--", "nan"):
        reader.type("L_max", nonsense)
        reader.page.get_by_text(f"L_max: '{nonsense}' is no number").wait_for()
        assert reader.read("L_max") == kept
    reader.type("order of L", "2.5")
    reader.page.get_by_text("order of L: '2.5' is no whole number").wait_for()
    reader.after(reader.type, "L_max", "27,5")  # a comma is a point
    assert run(reader.python)["design"].problem.L_max == 27.5
    assert reader.page.get_by_text("is no whole").count() == 0
    reader.after(reader.type, "L_max", "1e99")  # as far as it goes
    assert float(reader.read("L_max")) == 1000
    reader.after(reader.type, "band from (rad/s)", "5")
    assert reader.python.strip() == ""
    reader.after(reader.type, "band from (rad/s)", "1e-4")
    assert run(reader.python)["design"].problem.L_max == 1000


def test_the_page_never_complained(reader):
    assert reader.complaints == []
