"""The widgets, without a browser: what knobs do to settings, and that nothing stale is computed."""

import asyncio
import os
import re
import selectors
from dataclasses import replace

import numpy as np
import plants
import pytest

from rodlib import Law, current_trial_loop, load_law, run_trials, save_law, save_log
from rodlib.ilc.law.io import with_law
from rodlib.ilc.workbench import Picture, Plant, Settings, try_out, workbench

pytest.importorskip("ipywidgets")
from rodlib.ilc.workbench.panel import FILE, Panel
from rodlib.paper.knobs import rods
from rodlib.paper.repository import ROOT

ROD = "the rod"


@pytest.fixture(scope="module")
def stage():
    sizes, units = {"x": 1.0, "F": 3.0}, {"x": "mm"}
    return Plant("", current_trial_loop(plants.stage(), ["F"], sizes, units))


@pytest.fixture(scope="module")
def panel(stage):
    """One for all tests, each of which begins with the stage."""
    return Panel(
        {ROD: rods(), "stage": stage, "another": stage}, log="data/rig/learning.csv"
    )


@pytest.fixture
def knobs(panel):
    panel.choice.value = "another"  # whose design is a matter of a moment
    panel.choice.value = "stage"
    return panel.knobs


def test_knobs_make_settings_and_settings_the_picture(panel, knobs, stage):
    paper = Settings.of(stage)
    assert panel.settings == paper
    knobs["L_max"].value = 2.000001  # as sliders have it
    knobs["uncertainty"].value = 5.0
    wanted = replace(paper, L_max=2.0, uncertainty=5.0)
    assert panel.settings == wanted
    before = try_out(replace(paper, L_max=2.0))
    assert panel.image.value == Picture().show(try_out(wanted), before).png()
    assert panel.outcome.line in panel.line.value.replace("&gt;", ">")
    assert knobs["noise"].description == "noise (mm)"


def test_who_sees_a_new_picture_reads_what_belongs_to_it(panel, knobs):
    """Widgets change one after the other, also in a browser: the picture is the last."""
    read = []
    panel.image.observe(
        lambda change: read.append((panel.python.value, panel.line.value)), "value"
    )
    for M_max in (0.95, 0.001, 0.93):
        knobs["M_max"].value = M_max
        assert read[-1] == (panel.python.value, panel.line.value)
    assert len(read) == len(set(read)) == 3


def test_infeasible_and_back(panel, knobs):
    knobs["M_max"].value = 0.06
    assert panel.outcome.design is None and panel.save.disabled
    assert panel.remedy.layout.display == ""
    smallest = panel.outcome.M_max
    assert panel.remedy.description == f"set M_max to {smallest:.3f}"
    panel.remedy.click()
    assert panel.settings.M_max == knobs["M_max"].value == smallest
    assert panel.outcome.design is not None and panel.remedy.layout.display == "none"
    assert panel.before.settings.M_max == 0.9  # the last one with a filter, in gray


def test_a_field_that_makes_no_sense_says_so(panel, knobs):
    knobs["low"].value = 1e9
    assert "band = (1000000000.0, 20.0) must be" in panel.outcome.message
    panel.choice.value = ROD
    panel.parameters[ROD]["density"].value = -1.0
    assert panel.settings is None and "density = -1.0" in panel.outcome.message
    panel.parameters[ROD]["density"].value = 7800.0
    assert panel.outcome.design is not None
    panel.choice.value = FILE
    panel.file.value = "nowhere.csv"
    assert panel.settings is None and "nowhere.csv" in panel.outcome.message
    panel.file.value = ""
    assert (
        panel.settings is None and "must be the path of a file" in panel.outcome.message
    )


def test_a_table_of_others_comes_in_by_the_same_field(panel, tmp_path):
    """Its columns are told as to read_table; what is not understood is said, and nothing is run."""
    board = str(ROOT / "data" / "tclab" / "board-1s.csv")
    panel.choice.value, panel.file.value = FILE, board
    for columns, message in (
        ("", "rodlib.read_table reads other tables"),
        ('time="Time"', "columns = .* missing 1 required .*'outputs'"),
        ('time="Time", outputs={"T1": "Tempratur 1"}', "the titles are"),
        ('time="Time", outputs={"T1": "Temperature 1"', "cannot be understood"),
        ("outputs=open('law.json')", "each must be a text, a number or a dict"),
        ('"Time", outputs={"T1": 3}', "write time="),
        ('tine="Time", outputs={"T1": 3}', "unexpected keyword argument 'tine'"),
    ):
        panel.columns.value = columns
        assert panel.settings is None and re.search(message, panel.outcome.message), (
            columns
        )
    panel.columns.value = ""


class Clock(selectors.DefaultSelector):
    """Makes an event loop that never waits: time goes on when there is nothing else to do."""

    now = 0.0

    def select(self, timeout=None):
        self.now += timeout or 0
        return super().select(0)


def run(coroutine):
    clock = Clock()
    loop = asyncio.SelectorEventLoop(clock)
    loop.time = lambda: clock.now
    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        return runner.run(coroutine)


def test_what_follows_at_once_is_one_change(panel, knobs):
    async def turned():
        count = panel.designs
        for gain in (3.5, 3.0, 2.5, 2.2):
            knobs["L_max"].value = gain
            await asyncio.sleep(0)
        assert panel.designs == count
        await asyncio.sleep(0.1)
        return panel.designs - count

    assert run(turned()) == 1
    assert panel.settings.L_max == 2.2


def test_to_and_fro_is_no_change(panel, knobs):
    async def turned():
        count, kept = panel.designs, knobs["M_max"].value
        for rate in (0.5, kept):
            knobs["M_max"].value = rate
        await asyncio.sleep(0.1)
        return panel.designs - count

    assert run(turned()) == 0


def test_what_is_shown_is_saved(panel, knobs, tmp_path):
    panel.target.value = str(tmp_path / "law.json")
    panel.save.click()
    law = load_law(tmp_path / "law.json")
    assert panel.settings.Q == law.Q and "law.json" in panel.saved.value
    np.testing.assert_array_equal(
        law.L.coefficients, panel.outcome.design.filter.coefficients
    )
    panel.target.value = ""
    panel.save.click()
    assert panel.saved.value.startswith("not saved: ")
    (tmp_path / "device").symlink_to(os.devnull)
    panel.target.value = str(tmp_path / "device")
    panel.save.click()
    assert panel.saved.value.startswith("not saved: ")
    assert panel.saved.value.endswith("device is no regular file: choose another name")


def test_what_is_said_to_be_saved_is_read_again(panel, knobs, tmp_path, monkeypatch):
    def save_another(path, law, note):
        L = replace(law.L, coefficients=law.L.coefficients * (1 + 1e-15))
        save_law(path, replace(law, L=L), note)

    monkeypatch.setattr("rodlib.ilc.workbench.panel.save_law", save_another)
    panel.target.value = str(tmp_path / "law.json")
    panel.save.click()
    assert panel.saved.value.endswith(
        "law.json holds another law than was written to it: try again"
    )


def test_a_log_that_cannot_be_used_says_which_and_why(panel, tmp_path, stage):
    """Its name is no formula."""
    path = tmp_path / r"$\frac{$.csv"
    Q = Settings.of(stage).Q
    run = run_trials(stage.loop, Law(Q, None), np.zeros((9, 1)), None, 1)
    save_log(with_law(run, Law(Q, None, loop=stage.loop)), path)
    panel.choice.value = ROD
    panel.file.value = str(path)
    panel.choice.value = FILE
    assert panel.outcome.design is not None
    text = path.read_text()
    assert '"KL": [[' in text
    path.write_text(text.replace('"KL": [[', '"KL": [["a", ', 1))
    panel.choice.value = ROD
    panel.choice.value = FILE
    assert panel.settings is None
    assert str(path) in panel.outcome.message
    assert "KL must be an array of numbers" in panel.outcome.message


def test_widgets_are_shown_to_those_who_can_use_them(stage, monkeypatch, capsys):
    monkeypatch.delenv("JPY_SESSION_NAME", raising=False)
    assert workbench() is None and workbench(live=False) is None
    monkeypatch.setenv("JPY_SESSION_NAME", "notebooks/12-workbench.ipynb")
    assert workbench(live=False) is None
    panel = workbench({ROD: rods(), "stage": stage})
    assert panel.choice.options == (ROD, "stage", FILE)
    with pytest.raises(ValueError, match="live = 'yes' must be True or False"):
        workbench(live="yes")
    with pytest.raises(ValueError, match=r"plants\['x'\] = 3 must be a Plant"):
        workbench({"x": 3})
