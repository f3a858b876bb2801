"""The widgets, without a browser: what knobs do to settings, and that nothing stale is computed."""

import asyncio
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from ilctools import load_law
from rodlib import Settings, open_workbench, try_out
from rodlib.workbench.picture import png

pytest.importorskip("ipywidgets")
from rodlib.workbench.panel import Panel


@pytest.fixture
def panel(stage):
    return Panel(stage)


def test_knobs_set_the_settings_and_the_picture(panel, stage):
    paper = Settings.of(stage)
    assert panel.settings == paper
    assert panel.knobs["noise"].description == "noise (mm)"
    assert panel.knobs["noise"].max == 1.0  # as large as the reference
    panel.knobs["L_max"].value = 2.000001  # as sliders have it
    panel.knobs["uncertainty"].value = 5.0
    wanted = replace(paper, L_max=2.0, uncertainty=5.0)
    assert panel.settings == wanted
    assert panel.image.value == png(try_out(wanted))
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
    feasible = panel.image.value
    panel.knobs["M_max"].value = 0.06
    assert panel.outcome.design is None and panel.save.disabled
    assert "infeasible" in unescape(panel.certificate.value)  # not in the picture alone
    assert panel.python.value.endswith("></pre>")
    panel.knobs["M_max"].value = 0.9
    assert not panel.save.disabled and panel.image.value == feasible


def test_changes_that_follow_at_once_are_one(panel, monkeypatch):
    monkeypatch.setattr("rodlib.workbench.panel.PAUSE", 0.2)

    async def turn():
        start, first = panel.knobs["M_max"].value, panel.outcome
        for gain in (3.5, 3.0, 2.5, 2.2):
            panel.knobs["L_max"].value = gain
            await asyncio.sleep(0)
        assert panel.outcome is first
        await asyncio.sleep(0.4)
        second = panel.outcome
        assert panel.settings.L_max == 2.2
        for rate in (0.5, start):  # to and fro
            panel.knobs["M_max"].value = rate
        await asyncio.sleep(0.4)
        assert panel.outcome is second

    asyncio.run(turn())


def test_the_law_is_saved(panel, tmp_path):
    panel.target.value = str(tmp_path / "law.json")
    panel.save.click()
    assert panel.saved.value == f"saved: {tmp_path}/law.json"
    law, design = load_law(tmp_path / "law.json"), panel.outcome.design
    assert (law.Q, law.rest) == (panel.settings.Q, 15)
    np.testing.assert_array_equal(law.L.coefficients, design.filter.coefficients)
    panel.target.value = str(tmp_path / "nowhere" / "law.json")
    panel.save.click()
    assert panel.saved.value.startswith("not saved: ")


def test_widgets_are_shown_in_a_notebook_server(stage, monkeypatch, capsys):
    monkeypatch.delenv("JPY_SESSION_NAME", raising=False)
    assert open_workbench(stage) is None
    monkeypatch.setenv("JPY_SESSION_NAME", "notebooks/12-workbench.ipynb")
    assert open_workbench(stage, live=False) is None
    assert open_workbench(stage).settings == Settings.of(stage)
    with pytest.raises(ValueError, match="live = 'yes'"):
        open_workbench(stage, live="yes")
    with pytest.raises(ValueError, match="plant = 3"):
        open_workbench(3)
