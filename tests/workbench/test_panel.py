"""The widgets, without a browser: what knobs do to settings, and that nothing stale is computed."""

import asyncio
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from ilctools import load_law
from rodlib import Rod, Settings, open_workbench, try_out
from rodlib.paper import ROOT, plant_of_rod
from rodlib.workbench.picture import Picture

pytest.importorskip("ipywidgets")
from rodlib.workbench.panel import LOG, Panel


@pytest.fixture
def panel(stage):
    return Panel(
        {"stage": stage, "the rod": plant_of_rod(Rod())}, log=str(ROOT / "data/rig/learning.csv")
    )


def test_knobs_set_the_settings_and_the_picture(panel, stage):
    paper = Settings.of(stage)
    assert panel.settings == paper
    assert panel.knobs["noise"].description == "noise (mm)"
    panel.knobs["L_max"].value = 2.000001  # as sliders have it
    panel.knobs["uncertainty"].value = 5.0
    wanted = replace(paper, L_max=2.0, uncertainty=5.0)
    assert panel.settings == wanted
    before = try_out(replace(paper, L_max=2.0))
    assert panel.image.value == Picture().show(try_out(wanted), before).png()
    assert str(panel.outcome.design.certificate) in unescape(panel.certificate.value)


def test_a_new_picture_comes_with_its_lines(panel):
    """Widgets change one after the other, also in a browser: the picture is the last."""
    read = []
    panel.image.observe(
        lambda change: read.append((panel.python.value, panel.certificate.value)), "value"
    )
    for M_max in (0.95, 0.05, 0.93):
        panel.knobs["M_max"].value = M_max
        assert read[-1] == (panel.python.value, panel.certificate.value)
    assert len(read) == len(set(read)) == 3


def test_infeasible_and_back(panel):
    panel.knobs["order"].value = 3
    panel.knobs["M_max"].value = 0.06
    assert panel.outcome.design is None and panel.save.disabled
    assert "infeasible" in unescape(panel.certificate.value)  # not in the picture alone
    assert panel.remedy.layout.display == ""
    smallest = panel.outcome.M_max
    assert panel.remedy.description == f"set M_max to {smallest:.3f}"
    panel.remedy.click()
    assert panel.settings.M_max == panel.knobs["M_max"].value == smallest
    assert panel.outcome.design is not None and panel.remedy.layout.display == "none"
    assert panel.before.settings.M_max == 0.9  # the last one with a filter, in gray


def test_another_plant_brings_its_own_knobs(panel):
    panel.choice.value = "the rod"
    assert panel.settings == Settings.of(panel.plants["the rod"])
    assert panel.knobs["noise"].description == "noise (K)"
    assert panel.knobs["noise"].max == 10.0  # as large as the reference
    panel.choice.value = LOG
    assert panel.outcome.design is not None and "load_log" in panel.settings.python


def test_fields_out_of_range_are_answered_by_a_message(panel):
    panel.knobs["low"].value = 1e9
    assert "band = (1000000000.0, 100.0)" in panel.outcome.message
    panel.choice.value, panel.file.value = LOG, "nowhere.csv"
    assert panel.settings is None and "nowhere.csv" in panel.outcome.message
    assert panel.outcome.message in unescape(panel.certificate.value)
    panel.choice.value = "stage"
    assert panel.outcome.design is not None


def test_changes_that_follow_at_once_are_one(panel, monkeypatch):
    monkeypatch.setattr("rodlib.workbench.panel.PAUSE", 0.2)

    async def turn():
        start, first = panel.knobs["M_max"].value, panel.outcome
        for gain in (3.5, 3.0, 2.5, 2.2):
            panel.knobs["L_max"].value = gain
            await asyncio.sleep(0)
        assert panel.outcome is first
        await asyncio.sleep(0.4)
        assert panel.before is first and panel.settings.L_max == 2.2
        for rate in (0.5, start):  # to and fro
            panel.knobs["M_max"].value = rate
        await asyncio.sleep(0.4)
        assert panel.before is first

    asyncio.run(turn())


def test_the_law_is_saved(panel, tmp_path, monkeypatch):
    panel.target.value = str(tmp_path / "law.json")
    panel.save.click()
    assert "law.json" in panel.saved.value
    law, design = load_law(tmp_path / "law.json"), panel.outcome.design
    assert (law.Q, law.rest) == (panel.settings.Q, 15)
    np.testing.assert_array_equal(law.L.coefficients, design.filter.coefficients)
    monkeypatch.setenv("HOME", str(tmp_path))
    panel.target.value = " ~/at home.json"  # as a path that is read
    panel.save.click()
    assert panel.saved.value == f"saved: {tmp_path}/at home.json"
    assert load_law("~/at home.json").rest == 15
    panel.target.value = str(tmp_path / "nowhere" / "law.json")
    panel.save.click()
    assert panel.saved.value.startswith("not saved: ")


def test_widgets_are_shown_in_a_notebook_server(stage, monkeypatch, capsys):
    monkeypatch.delenv("JPY_SESSION_NAME", raising=False)
    assert open_workbench() is None and open_workbench(live=False) is None
    monkeypatch.setenv("JPY_SESSION_NAME", "notebooks/12-workbench.ipynb")
    assert open_workbench(live=False) is None
    panel = open_workbench({"stage": stage})
    assert panel.choice.options == ("stage", LOG)
    with pytest.raises(ValueError, match="live = 'yes'"):
        open_workbench(live="yes")
    with pytest.raises(ValueError, match=r"plants\['x'\] = 3"):
        open_workbench({"x": 3})
