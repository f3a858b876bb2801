"""docs/questions.md: each answer runs, and says what its heading asks."""

import re

import matplotlib.pyplot as plt

from rodlib.paper import ROOT

TEXT = (ROOT / "docs" / "questions.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```$", TEXT, flags=re.MULTILINE | re.DOTALL)


def test_the_lines_run_one_after_the_other(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in BLOCKS:
        exec(block, names)
    plt.close("all")
    said = capsys.readouterr().out
    assert "for every plant within the radius" in said.splitlines()[0]  # of the table in a file
    shown = r"rate ([\d.e-]+),", r"([\d.e-]+) µm in"
    rates, left = ([*map(float, re.findall(what, said))] for what in shown)
    assert len(rates) == 3 and rates == sorted(rates) and rates[-1] < 1
    assert left == sorted(left, reverse=True)  # the fastest, not the one of least peak
    assert re.search(r"^(converges|diverges)", said, re.MULTILINE)
    transferred, from_zero = map(float, re.findall(r"([\d.e-]+) µm, and ([\d.]+)", said)[0])
    assert transferred < 0.2 * from_zero
    assert "commands up to 17.00 mm" in said
    assert float(re.findall(r"trial 10 leaves ([\d.e-]+) mm", said)[0]) < 0.1
    of_one, of_both = re.findall(r"([\d.e-]+) as designed, ([\d.]+) on the softer", said)
    assert float(of_one[0]) < 0.5 and float(of_one[1]) > 1 > float(of_both[1])
    whole, part = map(float, re.findall(r"v has ([\d.]+) µm", said))
    assert part < 0.6 * whole
