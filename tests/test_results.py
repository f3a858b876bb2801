import shutil

import pytest
import results

from rodlib.paper import ledger, published
from rodlib.paper.ledger import Ledger, publish
from rodlib.paper.repository import ROOT

FIGURE = "fig02-rod"


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A repository and the folder of a run whose results have been published."""
    root, build = tmp_path / "root", tmp_path / "build"
    (root / "figures").mkdir(parents=True)
    (root / "pyproject.toml").write_text('name = "rodlib"\n')
    (root / "README.md").write_text("<!-- ledger -->\n<!-- end of ledger -->\n")
    (build / "figures").mkdir(parents=True)
    for ending in ("png", "pdf"):
        shutil.copy(ROOT / "figures" / f"{FIGURE}.{ending}", build / "figures")
    monkeypatch.setenv("RODLIB_RESULTS", str(build))
    book = Ledger("01-model")
    for key, claim in published.claims().items():
        book.record(key, None if claim.criterion == ledger.UNCHECKED else 1.0)
    book.save()
    publish(build, root)
    return build, root


def test_what_has_been_published_is_the_same(run, capsys):
    capsys.readouterr()
    assert not results.main(*run)
    told = "all 1 figures, the ledger and the README are the same as before\n"
    assert capsys.readouterr().out == told


def test_another_ledger_or_figure_is_not(run, capsys):
    build, root = run
    for changed in (
        root / "figures" / "ledger.csv",
        build / "figures" / f"{FIGURE}.png",
    ):
        before = changed.read_bytes()
        changed.write_bytes(before[:-30])
        assert results.main(*run)
        name = "figures/ledger.csv" if changed.suffix == ".csv" else FIGURE
        assert capsys.readouterr().out.endswith(f"; different: {name}\n")
        changed.write_bytes(before)
