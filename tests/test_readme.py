"""README and guide: the example runs as it stands, and what they count is so."""

import re

import matplotlib.pyplot as plt
import numpy as np
import pytest
from books import ROWS, code, text
from documented import examples

from rodlib.paper.comparison import same_picture
from rodlib.paper.ledger import COUNTED, DIFFERS, IN_WORDS, REPRODUCED, UNCHECKED
from rodlib.paper.repository import ROOT

README = text("README.md")
(EXAMPLE,), (SNIPPET,) = examples("README.md"), examples("docs/guide.md")


@pytest.mark.filterwarnings("error::UserWarning")
def test_the_example_goes_from_a_frequency_response_to_a_learned_trial(
    tmp_path, monkeypatch, capsys
):
    """The plant was not in the design but for its response, and the picture is the one shown."""
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "__main__"}
    with plt.rc_context():
        plt.rcdefaults()  # whatever style earlier tests had
        exec(EXAMPLE, names)
    plt.close("all")
    assert "for every plant within the radius" in capsys.readouterr().out
    assert not names["design"].certificate.failures
    millimetres = np.abs(names["run"].e.values).max(axis=(1, 2))
    assert 1 < millimetres[0] < 2 and 1e-3 < millimetres[1] < 2e-3  # up to two, and up to two µm
    stale = "docs/axis.png is not what README draws: run its lines, and copy axis.png there"
    assert same_picture(tmp_path / "axis.png", ROOT / "docs" / "axis.png"), stale


def test_notebook_11_runs_the_lines_of_the_guide():
    lines = [line for line in "\n".join(code("11-another-plant")).splitlines() if line]
    after_imports = SNIPPET[SNIPPET.index("class") :].splitlines()
    ours = [line for line in after_imports if line and "savefig" not in line]
    start = lines.index(ours[0])
    assert lines[start : start + len(ours)] == ours


def test_what_it_says_first_is_what_the_ledger_counts():
    """Of what could have differed, each kind apart: how many there are, how many agree; by name."""
    said = README.partition("<!-- ledger -->\n")[2].partition("<!-- end")[0].splitlines()
    names = ["printed", "derived", "coefficient", "statement", "assumed"]
    for name, line in zip(names, said, strict=False):
        verdicts = ROWS.verdict[ROWS.kind == name]
        differ = [*ROWS.key[verdicts.index[verdicts == DIFFERS]]]
        agree = (verdicts == REPRODUCED).sum()
        assert line.startswith(f"- {agree} of {agree + len(differ)} {COUNTED[name]} agree.")
        assert re.findall("`([^`]+)`", line) == (differ if name != "coefficient" else [])
    vague = (ROWS.verdict[ROWS.kind.isin(["statement", "assumed"])] == IN_WORDS).sum()
    unchecked = (ROWS.verdict == UNCHECKED).sum()
    assert said[5].startswith(f"- {vague} statements are too vague")
    assert said[6] == f"- {unchecked} statements cannot be checked."
