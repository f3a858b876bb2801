"""The README: its snippet runs as it stands, and what it says first is what the ledger counts."""

import re

import matplotlib.pyplot as plt
import nbformat
import pandas as pd
import pytest

from ilctools.logs.replay import rms_by_trial
from rodlib.paper.ledger import COEFFICIENT, DIFFERS, IN_WORDS, KINDS, REPRODUCED
from rodlib.paper.repository import ROOT

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
(SNIPPET,) = re.findall(r"^```python\n(.*?)^```$", TEXT, flags=re.MULTILINE | re.DOTALL)


@pytest.mark.filterwarnings("error::UserWarning")
def test_the_snippet_goes_from_a_rig_to_a_learned_trial(tmp_path, monkeypatch, capsys):
    """In a namespace of its own and an empty folder; trials end at the noise of the sensor."""
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "__main__"}
    exec(SNIPPET, names)
    plt.close("all")
    said, certificate = capsys.readouterr().out, names["design"].certificate
    assert not certificate.failures and certificate.grid_M < 0.9
    assert "chosen: L_max" in said and "P measured at" in said
    assert re.search("converged, by about trial [23]", said)
    size = rms_by_trial(names["run"].e).to_numpy().ravel()
    assert size[-1] < 1.2 * 0.002 < 0.01 * size[0]
    assert f"{size[-1]:.3g} mm of {size[0]:.3g}" in " ".join(TEXT.split())
    assert (tmp_path / "axis.png").stat().st_size > 5000


def test_it_is_short_and_notebook_11_runs_its_lines():
    assert len(TEXT.splitlines()) <= 150
    path = ROOT / "notebooks" / "11-another-plant.ipynb"
    code = [c.source for c in nbformat.read(path, 4).cells if c.cell_type == "code"]
    lines = [line for line in "\n".join(code).splitlines() if line]
    after_imports = SNIPPET[SNIPPET.index("class") :].splitlines()
    ours = [line for line in after_imports if line and "savefig" not in line]
    start = lines.index(ours[0])
    assert lines[start : start + len(ours)] == ours


def test_what_it_says_first_is_what_the_ledger_counts():
    """Of what could have differed, each kind apart: how many there are, and how many agree."""
    rows = pd.read_csv(ROOT / "figures" / "ledger.csv", dtype=str, keep_default_na=False)
    kind = rows.kind.mask(rows.key.str.match(COEFFICIENT), "coefficient")
    said = " ".join(TEXT.split())
    for name, sentence in {
        "number": "Of {} printed numbers that could have differed {} come out as printed",
        "coefficient": "of the {} coefficients of the learning filters {}",
        "statement": "Of {} statements that model and design decide {} hold",
        "assumed": "of {} that only signals or rigs of ours can test {} do there",
    }.items():
        verdicts = rows.verdict[kind == name]
        agree = (verdicts == REPRODUCED).sum()
        total = agree + (verdicts == DIFFERS).sum()
        assert sentence.format(total, agree) in said
    vague = (rows.verdict[kind.isin(KINDS)] == IN_WORDS).sum()
    assert f"{vague} more are too vague for a criterion" in said
