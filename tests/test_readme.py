"""The README: its snippets run as they stand, and what it says first is what the ledger counts."""

import os
import re
import subprocess
import sys

import pandas as pd
import pytest

from rodlib.paper.ledger import COEFFICIENT, DIFFERS, EVIDENCE, REPRODUCED
from rodlib.paper.repository import ROOT

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


SNIPPETS = re.findall(r"^```python\n(.*?)^```$", TEXT, flags=re.MULTILINE | re.DOTALL)


# What the design and the estimate of the first snippet are.
FIRST = """
assert not design.certificate.failures and design.filter.channels == 2
assert 0.1 < design.certificate.grid_M < 0.9
assert 0 < P.radius()[P.known].max() < 0.2
assert "chosen: L_max" in str(design)
assert "P estimated from one trial" in str(design)
"""
CODES = [SNIPPETS[0] + FIRST, *SNIPPETS[1:]]


@pytest.mark.parametrize("number", range(len(CODES)))
def test_each_snippet_runs_by_itself_in_an_empty_folder(number, tmp_path):
    (tmp_path / "data").symlink_to(ROOT / "data")  # all that it needs of the repository
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    run = subprocess.run(
        [sys.executable, "-W", "error::UserWarning", "-c", CODES[number]],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert run.stdout


def test_what_it_says_first_is_what_the_ledger_counts():
    rows = pd.read_csv(
        ROOT / "figures" / "ledger.csv", dtype=str, keep_default_na=False
    )
    rows = rows[(rows.kind == EVIDENCE) & rows.verdict.isin([REPRODUCED, DIFFERS])]
    coefficients = rows[rows.key.str.match(COEFFICIENT)]
    others = rows.drop(coefficients.index)
    agree = [(table.verdict == REPRODUCED).sum() for table in (others, coefficients)]
    said = " ".join(TEXT.split())
    assert (
        f"Of {len(others)} numbers and statements that can be computed, {agree[0]} "
        in said
    )
    assert (
        f"the {len(coefficients)} coefficients of the learning filters {agree[1]} agree"
        in said
    )
