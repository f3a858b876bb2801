"""The README of the toolbox: short, and its example runs as it stands."""

import re
from pathlib import Path

import matplotlib.pyplot as plt

from ilctools import rms

TEXT = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def test_the_example_learns_and_leaves_a_picture(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(re.search(r"```python\n(.*?)```", TEXT, re.DOTALL)[1], names)
    plt.close("all")
    assert str(names["design"]) in capsys.readouterr().out
    assert names["design"].certificate.failures == []
    error = rms(names["trials"].e)
    assert error[-1] < 1e-3 * error[0]
    assert (tmp_path / "axis.png").stat().st_size > 5000


def test_it_is_short():
    assert len(TEXT.splitlines()) <= 60
