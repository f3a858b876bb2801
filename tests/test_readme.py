"""The README: its snippet runs as it stands, and what it says first is what the ledger counts."""

import re

import pandas as pd

from rodlib.paper.ledger import COEFFICIENT, DIFFERS, EVIDENCE, REPRODUCED
from rodlib.paper.repository import ROOT

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_snippet_designs_a_filter_for_a_table(monkeypatch, capsys):
    (snippet,) = re.findall(r"^```python\n(.*?)^```$", TEXT, flags=re.MULTILINE | re.DOTALL)
    monkeypatch.chdir(ROOT)
    namespace = {}
    exec(snippet, namespace)
    design = namespace["design"]
    assert not design.certificate.failures and design.filter.channels == 1
    assert design.sigma_M.max() < 0.9 and design.sigma_L.max() < 10 * 1.000001
    assert "over all frequencies" in capsys.readouterr().out


def test_what_it_says_first_is_what_the_ledger_counts():
    rows = pd.read_csv(ROOT / "figures" / "ledger.csv", dtype=str, keep_default_na=False)
    rows = rows[(rows.kind == EVIDENCE) & rows.verdict.isin([REPRODUCED, DIFFERS])]
    coefficients = rows[rows.key.str.match(COEFFICIENT)]
    others = rows.drop(coefficients.index)
    agree = [(table.verdict == REPRODUCED).sum() for table in (others, coefficients)]
    said = " ".join(TEXT.split())
    assert f"Of {len(others)} numbers and statements that can be computed, {agree[0]} " in said
    assert f"the {len(coefficients)} coefficients of the learning filters {agree[1]} agree" in said
