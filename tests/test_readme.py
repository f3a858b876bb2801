"""The README: its snippets run as they stand, and what it says first is what the ledger counts."""

import re

import pandas as pd
import pytest

from rodlib.paper.ledger import COEFFICIENT, DIFFERS, EVIDENCE, REPRODUCED
from rodlib.paper.repository import ROOT

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


SNIPPETS = re.findall(r"^```python\n(.*?)^```$", TEXT, flags=re.MULTILINE | re.DOTALL)
# What the design and the estimate of the first snippet are.
SNIPPETS[0] += """
assert not design.certificate.failures and design.filter.channels == 2
assert 0.1 < design.certificate.grid_M < 0.9
assert 0 < P.radius()[P.known].max() < 0.4
assert "chosen: L_max" in str(design)
assert "P estimated from one trial" in str(design)
"""


@pytest.mark.parametrize("snippet", SNIPPETS, ids=range(len(SNIPPETS)))
@pytest.mark.filterwarnings("error::UserWarning")
def test_each_snippet_runs_by_itself(snippet, tmp_path, monkeypatch, capsys):
    """In a namespace of its own and a folder with nothing but the data."""
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    exec(snippet, {"__name__": "__main__"})
    assert capsys.readouterr().out


def test_what_it_says_first_is_what_the_ledger_counts():
    rows = pd.read_csv(
        ROOT / "figures" / "ledger.csv", dtype=str, keep_default_na=False
    )
    rows = rows[(rows.kind == EVIDENCE) & rows.verdict.isin([REPRODUCED, DIFFERS])]
    coefficients = rows[rows.key.str.match(COEFFICIENT)]
    others = rows.drop(coefficients.index)
    agree = [(table.verdict == REPRODUCED).sum() for table in (others, coefficients)]
    said = " ".join(TEXT.split())
    computed, filters = "that can be computed", "of the learning filters"
    assert f"Of {len(others)} numbers and statements {computed}, {agree[0]} " in said
    assert f"the {len(coefficients)} coefficients {filters} {agree[1]} agree" in said
