import re

import matplotlib.image
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rodlib.paper import ledger, published
from rodlib.paper.ledger import (
    DIFFERS,
    IN_WORDS,
    OTHER,
    REPRODUCED,
    UNCHECKED,
    Ledger,
    verdict,
)
from rodlib.paper.published import Claim


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
        ("< 0.1", 0.0327, REPRODUCED, 0),
        ("< 0.1", 0.38, DIFFERS, 0.28),
        ("< 1", np.nan, DIFFERS, np.nan),
        ("<= 1", 1.0, REPRODUCED, 0),
        ("> 50", 2e8, REPRODUCED, 0),
        (">= 2", 1.5, DIFFERS, -0.5),
        ("== 12", 10, DIFFERS, -2),
        ("0.58 +- 0.01", 0.585, REPRODUCED, 0.005),
        ("0.58 +- 0.01", 0.6, DIFFERS, 0.02),
    ],
)
def test_statements_are_judged_by_their_criterion(
    criterion, computed, outcome, deviation
):
    assert verdict(claim("in words", criterion), computed) == (
        outcome,
        pytest.approx(deviation, nan_ok=True),
    )


def test_a_sentence_of_ours_is_no_criterion(monkeypatch):
    partly = claim("are small", "words: holds up to {} rad/s")
    monkeypatch.setattr(published, "claims", lambda: {"key": partly})
    book = Ledger("test")
    book.record("key", 0.0084512)
    row = book.rows["key"]
    assert (row["verdict"], row["computed"]) == (IN_WORDS, "holds up to 0.00845 rad/s")
    assert (row["deviation"], row["note"]) == ("", "")


def test_only_what_could_have_differed_is_counted():
    book = Ledger("test")
    for key, value in (
        ("length", 0.32),
        ("order", 11),
        ("unity", 0.0),
        ("zero_s_1", 0.10114),
    ):
        book.record(key, value)
    summary = ledger.summary(pd.DataFrame(book.rows.values()))
    assert "| **all**    |            1 |         0 |" in summary
    assert "2 taken over, 1 identity; 2 of 3 agree" in summary
    assert "filters: printed “10”, computed 11" in summary


def test_coefficients_of_a_flat_optimum_have_a_row_and_no_line_in_the_readme():
    book = Ledger("03-ilc-synthesis")
    book.record("L_diagonal", published.matrix("L_diagonal") + np.eye(2)[..., None])
    book.record("peak_L_full", 48.9)
    rows = pd.DataFrame(book.rows.values())
    counts, rest = ledger.summary(rows).split("Beside coefficients")
    assert re.search(r"\| 03-ilc-synthesis +\| +0 \| +1 \|", counts)
    assert re.search(
        r"\| coefficients of \(39\), a flat optimum +\| +0 \| +20 \|", counts
    )
    assert "computed 49" in rest and "coefficient of" not in rest
    assert "diagonal: 20 of 20 by at most 1.0e+00" in ledger.markdown(rows)


def test_a_criterion_that_is_not_understood_is_refused():
    with pytest.raises(ValueError, match="criterion 'about 3' of claim 'key'"):
        verdict(claim("in words", "about 3"), 3.0)


@pytest.mark.parametrize(
    ("key", "computed", "shown", "deviation"),
    [
        ("zero_s_1", 0.10114238, "0.1011", ""),
        ("zero_s_1", 0.10115002, "0.1012", "1.0e-04"),
        ("zero_s_1", 0.10115 - 1e-12, "0.1011", ""),
        ("length", 0.32, "0.320", ""),
        ("peak_L_full", 48.926571, "49", "-1.0e+00"),
        ("L_full[7,L12]", -0.00001, "0.0000", "1.2e-02"),
        ("sensor_1", 0.375, "0.375", ""),
        ("sensor_1", 0.3750001, "0.3750001", "1.0e-07"),
        ("omega_N", np.pi, "3.14159265359", ""),
        ("damping", 0.37960851, "0.37961", "2.8e-01"),
        ("loop_stable", 0.99999999, "0.99999999", ""),
        ("lemma_1", np.nan, "nan", ""),
        ("dc_gain", 3e-15, "below 1e-09", ""),
        ("ambient_zero", -0.0, "0", ""),
    ],
)
def test_as_many_digits_are_shown_as_are_printed_or_as_the_verdict_needs(
    key, computed, shown, deviation
):
    book = Ledger("test")
    book.record(key, computed)
    assert (book.rows[key]["computed"], book.rows[key]["deviation"]) == (
        shown,
        deviation,
    )


@given(st.sampled_from(sorted(published.claims())), st.floats(allow_nan=False))
def test_the_verdict_follows_from_what_is_shown(key, computed):
    entry = published.claims()[key]
    book = Ledger("test")
    book.record(key, computed)
    row = book.rows[key]
    if row["verdict"] not in (UNCHECKED, IN_WORDS) and not row["computed"].startswith(
        "below"
    ):
        assert verdict(entry, float(row["computed"]))[0] == row["verdict"]


@given(st.floats(-1e-8, 1e-8))
def test_what_a_flat_optimum_leaves_open_is_not_shown(rounding):
    """The last digits of a coefficient differ between processors; its row does not."""
    rows = []
    for value in (-0.09319381, -0.09319381 + rounding):
        book = Ledger("test")
        book.record("L_full[2,L21]", value)
        rows.append(book.rows)
    assert rows[0] == rows[1]


def test_the_note_names_the_criterion_of_a_statement_in_words():
    book = Ledger("test")
    book.record("between_L", 1.1)
    book.record("loop_stable", 0.5)
    book.record("zero_s_1", 0.1)
    book.record("K_s K_s'[1,1]", 1.0)
    notes = [row["note"] for row in book.rows.values()]
    assert notes[0].startswith("criterion: <= 1.000001; close to the Nyquist frequency")
    assert notes[1:3] == ["criterion: < 1", published.claims()["zero_s_1"].note]
    assert notes[3].startswith("independent of the state coordinates")


def test_a_verdict_that_nobody_gave_counts_zero():
    book = Ledger("test")
    book.record("zero_s_1", 0.1011)
    table = ledger.summary(pd.DataFrame(book.rows.values())).split("\n\n")[0]
    assert [cell.strip() for cell in table.splitlines()[-1].split("|")[2:5]] == [
        "1",
        "0",
        "0",
    ]


def test_a_wrong_gain_is_caught():
    book = Ledger("test")
    wrong = published.matrix("N").copy()
    wrong[1, 0] += 1e-4
    book.record("N", wrong)
    assert [row["verdict"] for row in book.rows.values()] == [REPRODUCED] * 2 + [
        DIFFERS,
        REPRODUCED,
    ]


def test_matrices_keep_their_order():
    book = Ledger("test")
    for name in published.MATRICES:
        book.record(name, published.matrix(name))
    assert {row["verdict"] for row in book.rows.values()} == {REPRODUCED}
    assert {row["deviation"] for row in book.rows.values()} == {""}


def test_other_parameters_get_no_verdict():
    book = Ledger("test", M_max=0.8, L_max=50.0)
    book.record("order", 10)
    book.record("tool_chain")
    assert [row["verdict"] for row in book.rows.values()] == [OTHER, UNCHECKED]
    assert Ledger("test", M_max=0.9, L_max=50, omega_1=1e-4).papers_parameters


@pytest.mark.parametrize(
    "parameters",
    [
        {"M_max": 0.85},
        {"M_max": 0.9001},
        {"Ts": 0.5},
        {"L_max": 49.9},
        {"n_Q": 2.4},
        {"L_max": None},
    ],
)
def test_parameters_are_the_papers_exactly_or_not_at_all(parameters):
    """A bound of 0.85 is no 0.9 that was rounded."""
    book = Ledger("test", **parameters)
    book.record("order", 10)
    assert book.rows["order"]["verdict"] == OTHER


def test_unknown_claims_and_wrong_shapes_are_refused():
    book = Ledger("test")
    with pytest.raises(KeyError, match="no such claim"):
        book.record("no such claim", 1.0)
    with pytest.raises(
        ValueError, match=r"N has shape \(3, 2\), but the paper's has \(2, 2\)"
    ):
        book.record("N", np.ones((3, 2)))


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A complete run in an empty repository: all claims, one figure, a README."""
    monkeypatch.setenv("RODLIB_RESULTS", str(tmp_path / "build"))
    (tmp_path / "pyproject.toml").write_text('name = "rodlib"\n')
    book = Ledger("01-model")
    for key, entry in published.claims().items():
        book.record(key, 1e9 if key == "N[1,1]" else _meets(entry))
    book.save()
    figures = tmp_path / "build" / "figures"
    figures.mkdir()
    (figures / "fig01.png").write_bytes(b"picture")
    (tmp_path / "README.md").write_text(
        "before\n<!-- ledger -->\nold<!-- end of ledger -->\nafter\n"
    )
    return tmp_path


def _meets(entry):
    if not entry.criterion:
        return published.number(entry.printed)
    if entry.criterion == UNCHECKED:
        return None
    if entry.criterion.startswith(ledger.WORDS):
        return 1.0
    first, second, *_ = entry.criterion.split()
    if second == "+-":
        return float(first)
    return float(second) + {"<": -1, ">": 1}.get(first, 0)


def test_publish_writes_ledger_figures_and_readme(run):
    (run / "figures").mkdir()
    for name in ("fig99-stale.png", "extra99-stale.pdf", "performance.png"):
        (run / "figures" / name).write_bytes(b"old")
    ledger.publish(run / "build", run)
    assert sorted(path.name for path in (run / "figures").iterdir()) == [
        "fig01.png",
        "ledger.csv",
        "ledger.md",
        "performance.png",
    ]
    rows = pd.read_csv(run / "figures" / "ledger.csv", keep_default_na=False)
    assert list(rows.key) == list(published.claims())
    assert (rows.verdict == DIFFERS).sum() == 1
    readme = (run / "README.md").read_text()
    assert readme.startswith("before\n<!-- ledger -->\n| ") and readme.endswith(
        "-->\nafter\n"
    )
    assert "1 of 4 by at most 1.0e+09" in readme


def save(folder, name, moved, gray):
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.pdf").write_text(f"{20 + moved} 30 m\n")
    matplotlib.image.imsave(
        folder / f"{name}.png", np.full((2, 2, 3), gray, dtype=np.uint8)
    )


def test_what_is_the_same_stays_as_it_is_and_the_last_line_names_the_rest(run, capsys):
    """A figure whose PNG is another is replaced with its PDF, so that they show the same data."""

    def told():
        ledger.publish(run / "build", run)
        return capsys.readouterr().out.splitlines()[-1]

    def state():
        paths = [*before.iterdir(), run / "README.md"]
        return {
            path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in paths
        }

    drawn, before = run / "build" / "figures", run / "figures"
    for name in ("fig01", "fig02", "fig03", "fig04"):
        save(before, name, 0.0, 100)
    for name, moved, gray in (
        ("fig01", 0.004, 101),
        ("fig02", 0.004, 120),
        ("fig03", 0.004, 100),
    ):
        (drawn / f"{name}.png").unlink(missing_ok=True)
        save(drawn, name, moved, gray)
    save(drawn, "extra05", 0.0, 100)
    first = state()
    assert told() == (
        "2 of 5 figures are the same as before; "
        "different: fig02, figures/ledger.csv, figures/ledger.md, README.md; "
        "new: extra05; gone: fig04"
    )
    second = state()
    same = {name for name in first if first[name] == second.get(name)}
    assert same == {
        f"{name}.{end}" for name in ("fig01", "fig03") for end in ("pdf", "png")
    }
    for name in ("extra05", "fig02"):
        for end in ("pdf", "png"):
            assert second[f"{name}.{end}"][0] == (drawn / f"{name}.{end}").read_bytes()
    assert told() == "all 4 figures, the ledger and the README are the same as before"
    assert state() == second
    (run / "figures" / "ledger.md").write_text("other")
    assert (
        told() == "4 of 4 figures are the same as before; different: figures/ledger.md"
    )


def test_an_incomplete_run_changes_nothing(run):
    part = run / "build" / "ledger" / "01-model.csv"
    part.write_text("\n".join(part.read_text().splitlines()[:-1]) + "\n")
    before = (run / "README.md").read_text()
    with pytest.raises(ValueError, match="claims without evidence"):
        ledger.publish(run / "build", run)
    assert not (run / "figures").exists()
    assert (run / "README.md").read_text() == before


def test_a_readme_without_a_place_for_the_ledger_changes_nothing(run):
    (run / "README.md").write_text("no markers")
    with pytest.raises(ValueError, match="no markers"):
        ledger.publish(run / "build", run)
    assert not (run / "figures").exists()


def test_nothing_is_published_outside_a_clone(run):
    (run / "pyproject.toml").unlink()
    with pytest.raises(RuntimeError, match="writes to a clone of the repository"):
        ledger.publish(run / "build", run)
    assert not (run / "figures").exists()


def test_a_claim_with_two_rows_is_refused(run):
    part = run / "build" / "ledger" / "01-model.csv"
    (part.parent / "02-other.csv").write_text(part.read_text())
    with pytest.raises(ValueError, match="claims with two rows"):
        ledger.join(part.parent)


def test_markers_must_be_there():
    with pytest.raises(ValueError, match="no markers"):
        ledger.splice("nothing here", "ledger", "x")
