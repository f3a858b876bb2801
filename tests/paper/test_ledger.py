import re
import shutil

import matplotlib.image
import numpy as np
import pandas as pd
import pytest
import results
from books import ROWS, cells
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from rodlib.paper import ledger, published
from rodlib.paper.comparison import PIXELS_PER_INCH
from rodlib.paper.ledger import DIFFERS, OTHER, REPRODUCED, UNCHECKED, Ledger, verdict
from rodlib.paper.published import Claim
from rodlib.paper.repository import ROOT


def claim(printed="0.1011", criterion=""):
    return Claim("key", "IV", "a zero", printed, criterion=criterion)


@given(st.floats(-0.49, 0.49), st.floats(0.51, 100) | st.floats(-100, -0.51))
def test_half_a_unit_of_the_last_printed_digit_decides(inside, outside):
    assert verdict(claim(), 0.1011 + inside * 1e-4)[0] == REPRODUCED
    outcome, deviation = verdict(claim(), 0.1011 + outside * 1e-4)
    assert outcome == DIFFERS
    assert deviation == pytest.approx(outside * 1e-4)


@pytest.mark.parametrize(
    ("criterion", "computed", "outcome", "deviation"),
    [
        ("< 0.1", 0.38, DIFFERS, 0.28),
        ("< 1", np.nan, DIFFERS, np.nan),
        ("<= 1", 1.0, REPRODUCED, 0),
        ("> 2", 1.5, DIFFERS, -0.5),
        ("== 12", 10, DIFFERS, -2),
        ("0.58 +- 0.01", 0.585, REPRODUCED, 0.005),
        ("0.58 +- 0.01", 0.6, DIFFERS, 0.02),
    ],
)
def test_statements_are_judged_by_their_criterion(criterion, computed, outcome, deviation):
    assert verdict(claim("in words", criterion), computed) == (
        outcome,
        pytest.approx(deviation, nan_ok=True),
    )


def test_tracked_rows_follow_from_what_they_show():
    """All but which cell made them: of a sentence of ours the number in it, and no verdict."""
    book = Ledger("test")
    for key, shown in zip(ROWS.key, ROWS.computed, strict=True):
        before, _, after = published.claims()[key].criterion.partition("{}")
        number = shown.removeprefix(before.removeprefix(ledger.SENTENCE_PREFIX)).removesuffix(after)
        book.record(key, 3e-15 if number.startswith("below") else number or None)
    columns = ledger.COLUMNS[:-2]
    rows = book.frame()[columns].reset_index(drop=True)
    pd.testing.assert_frame_equal(rows, ROWS[columns], check_dtype=False)


def test_every_claim_has_a_kind_that_is_counted_or_named():
    """What the text prints as a number is neither assumed nor left in words."""
    entries = published.claims().values()
    assert {entry.kind for entry in entries} == {*ledger.KINDS}
    for entry in entries:
        assumed = re.search("assumed|synthetic|virtual", entry.claim + entry.note)
        in_words = entry.criterion.startswith(ledger.SENTENCE_PREFIX)
        assert entry.kind not in ("printed", "derived") or not (assumed or in_words), entry.key
        assert not (in_words and re.match(r"[\d.]+$", entry.printed)), entry.key


@pytest.mark.parametrize(
    ("key", "computed", "shown", "deviation"),
    [
        ("zero_s_1", 0.10115002, "0.1012", "1.0e-04"),
        ("zero_s_1", 0.10115 - 1e-12, "0.1011", ""),
        ("sensor_1", 0.37501, "0.37501", "1.0e-05"),
        ("loop_stable", 0.99994, "0.99994", ""),
        ("ambient_zero", -0.0, "0", ""),
    ],
)
def test_as_many_digits_are_shown_as_are_printed(key, computed, shown, deviation):
    book = Ledger("test")
    book.record(key, computed)
    row = book.rows[key]
    assert (row["computed"], row["deviation"]) == (shown, deviation)


@pytest.mark.parametrize("parameter", [{"M_max": 0.9001}, {"Ts": 0.5}, {"L_max": None}])
def test_other_parameters_get_no_verdict(parameter):
    book = Ledger("test", omega_1=1e-4, **parameter)
    book.record("order", 10)
    book.record("tool_chain")
    assert [*book.frame().verdict] == [OTHER, UNCHECKED]
    assert Ledger("test", M_max=0.9, L_max=50, omega_1=1e-4).papers_parameters


@pytest.fixture
def root(tmp_path, monkeypatch):
    """A repository in whose build/ a complete run lies: all claims, and figures fig01 to 03."""
    monkeypatch.setenv("RODLIB_RESULTS", str(tmp_path / "build"))
    (tmp_path / "README.md").write_text(
        "before\n<!-- ledger -->\nold<!-- end of ledger -->\nafter\n"
    )
    (tmp_path / "figures").mkdir()
    for name in ("figures/ledger.csv", "figures/ledger.md"):
        shutil.copy(ROOT / name, tmp_path / name)
    book = Ledger("01-model")
    for key, entry in published.claims().items():
        computed = 1.0 if entry.criterion else published.value(entry.printed)
        book.record(key, 1e9 if key == "N[1,1]" else computed)
    book.save()
    for name in ("fig01", "fig02", "fig03"):
        draw(tmp_path / "build", name, 100)
    return tmp_path


def draw(root, name, gray):
    folder = root / "figures"
    folder.mkdir(exist_ok=True, parents=True)
    page, metadata = Figure((2 / PIXELS_PER_INCH, 2 / PIXELS_PER_INCH)), {"Title": f"{gray}"}
    page.savefig(folder / f"{name}.pdf", metadata=metadata)
    picture = np.full((2, 2, 3), gray, dtype=np.uint8)
    matplotlib.image.imsave(folder / f"{name}.png", picture)


def publish(root, capsys):
    ledger.publish(root / "build", root)
    return capsys.readouterr().out.splitlines()[-1]


def test_publish_writes_ledger_figures_and_readme(root, capsys):
    draw(root, "other", 0)
    (root / "build/figures/fig02.webp").write_text("moves")
    made = {path.name for path in (root / "build" / "figures").iterdir()}
    assert publish(root, capsys) == "different: " + ", ".join(
        [*(f"figures/{name}" for name in [*sorted(made), "ledger.csv", "ledger.md"]), "README.md"]
    )
    assert {path.name for path in root.glob("figures/fig*")} == made
    rows = pd.read_csv(root / "figures" / "ledger.csv", keep_default_na=False)
    assert list(rows.key) == list(published.claims())
    assert {*rows.cell} == {cells("01-model")[-1].id}
    page = (root / "figures" / "ledger.md").read_text()
    verdicts = re.findall(r"^\|.*\| \[([a-z ,]+)\]", page, re.MULTILINE)
    assert [verdict == DIFFERS for verdict in verdicts] == sorted(rows.verdict == DIFFERS)[::-1]
    assert verdicts.count(DIFFERS) > 1
    rows.loc[0, "verdict"] = OTHER
    assert ledger.summary(rows).endswith(f"{OTHER}, and so not judged: 1\n")
    readme = (root / "README.md").read_text()
    assert re.match(r"before\n<!-- ledger -->\n- \d+ of \d+ printed numbers agree", readme)
    assert readme.endswith("-->\nafter\n") and "`N[1,1]`" in readme


def test_what_is_the_same_stays_as_it_is(root, capsys):
    """A figure whose PNG is another, or whose PDF is cut, is replaced: both show the same data."""

    def said(*names):
        """What both tools say: the one that looks first, the one that publishes last."""
        assert bool(results.main(root / "build", root)) == bool(names)
        expected = "different: " + ", ".join(f"figures/{name}" for name in names)
        return publish(root, capsys) == (expected if names else "all is the same as before")

    publish(root, capsys)
    draw(root / "build", "fig01", 101)
    part = root / "build" / "ledger" / "01-model.csv"
    rows, computed = part.read_text(), "1000000000.0000"
    assert rows.count(computed) == 1
    part.write_text(rows.replace(computed, "1000000000.0001"))  # a unit of the last digit
    draw(root / "build", "fig02", 120)
    assert said("fig02.pdf", "fig02.png")
    paths = root.glob("figures/*.pdf")
    pages = {path.stem: re.search(rb"/Title \((\d+)\)", path.read_bytes())[1] for path in paths}
    assert pages == {"fig01": b"100", "fig02": b"120", "fig03": b"100"}
    assert said()
    cut = root / "figures" / "fig02.pdf"
    cut.write_bytes(cut.read_bytes()[:-300])
    assert said("fig02.pdf", "fig02.png")
    part.write_text(rows.replace(computed, "1000000000.0002"))
    assert results.main(root / "build", root)
    part.write_text(rows)
    (root / "figures" / "ledger.md").write_text("other")
    assert said("ledger.md")


@pytest.mark.parametrize("lack", ["not in index", "overlapping values", "no markers"])
def test_what_is_not_complete_changes_nothing(root, lack):
    """Without a claim, with one twice, or without a place in the README."""
    part, readme = root / "build" / "ledger" / "01-model.csv", root / "README.md"
    rows = part.read_text()
    match lack:
        case "not in index":
            part.write_text(rows.rstrip().rpartition("\n")[0] + "\n")
        case "overlapping values":
            part.with_name("02-other.csv").write_text(rows)
        case "no markers":
            readme.write_text("nothing here")
    before = readme.read_text()
    with pytest.raises((KeyError, ValueError), match=lack):
        ledger.publish(root / "build", root)
    assert not list(root.glob("figures/*.png")) and readme.read_text() == before
