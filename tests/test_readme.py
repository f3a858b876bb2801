"""The README: its snippets run as they stand, and what it says first is what the ledger counts."""

import re

import pandas as pd
import pytest

from rodlib.paper.ledger import COEFFICIENT, DIFFERS, IN_WORDS, KINDS, REPRODUCED
from rodlib.paper.repository import ROOT

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


SNIPPETS = re.findall(r"^```python\n(.*?)^```$", TEXT, flags=re.MULTILINE | re.DOTALL)
# What the design and the estimate of the first snippet are.
SNIPPETS[0] += """
assert not design.certificate.failures and design.filter.channels == 2
assert 0.1 < design.certificate.grid_M < 0.9
assert 0 < P.radius()[P.known].max() < 0.2
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
    """Of what could have differed, each kind apart: how many there are, and how many agree."""
    rows = pd.read_csv(
        ROOT / "figures" / "ledger.csv", dtype=str, keep_default_na=False
    )
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
