"""The article: its numbers are those of the ledger, and a ledger that has changed is noticed."""

import json
import re
import shutil

import pytest
import typst
from books import ROWS

from rodlib.paper import ROOT, article

FOLDER = ROOT / "article"
QUOTES = json.loads((FOLDER / "numbers.json").read_text(encoding="utf-8"))


def test_what_is_tracked_is_made_of_the_tracked_ledger_and_figures():
    """Otherwise: make article."""
    pdf, quotes = article.compiled()
    assert (FOLDER / "numbers.json").read_text(encoding="utf-8") == quotes
    assert (FOLDER / "article.pdf").read_bytes() == pdf


def test_the_numbers_are_those_of_the_ledger():
    ledger = ROWS.set_index("key")
    for quote in QUOTES:
        row = ledger.loc[quote["key"]]
        assert row[quote["field"]] == quote["text"] and row.verdict == quote["verdict"]
    failed = ledger[(ledger.verdict == "differs") & (ledger.kind != "coefficient")]
    assert {*failed.index} <= {quote["key"] for quote in QUOTES}  # each is explained in the text


def test_numbers_that_are_typed_are_in_the_readme_or_in_the_ledger():
    """Such as 0.013, for which the ledger has no row of its own."""
    text = (FOLDER / "article.typ").read_text(encoding="utf-8")
    prose = [
        re.sub(r"#(?:in-words|note|computed|printed)\([^)]*\)", "", line)
        for line in text.splitlines()
        if not re.match(
            r"\s*(?:#(?:set|show|let|import|text|v\()|//|columns|align|inset|table)", line
        )
    ]
    typed = {*re.findall(r"(?<![\w.])\d+(?:[.,]\d+)+", "\n".join(prose))}
    known = "\n".join(
        [(ROOT / "README.md").read_text(encoding="utf-8"), *ROWS.to_csv().splitlines()]
    )
    assert "0.013" in typed
    assert not {number for number in typed if number not in known} - {"0.1.0"}  # the version


@pytest.fixture
def clone(tmp_path):
    """A copy of all that the article is made of."""
    for name in ("pyproject.toml", "environment.lock"):
        shutil.copy(ROOT / name, tmp_path)
    shutil.copytree(FOLDER, tmp_path / "article")
    (tmp_path / "figures").mkdir()
    shutil.copy(ROOT / "figures" / "ledger.csv", tmp_path / "figures")
    for name in re.findall(r'#shown\("([^"]+)"', (FOLDER / "article.typ").read_text()):
        shutil.copy(ROOT / "figures" / f"{name}.png", tmp_path / "figures")
    return tmp_path


def change(clone, key, **entries):
    """Change a row of the ledger of a clone; without entries the row goes."""
    rows = ROWS.copy()
    at = rows.key == key
    assert at.sum() == 1
    if entries:
        rows.loc[at, [*entries]] = [*entries.values()]
    else:
        rows = rows[~at]
    rows.to_csv(clone / "figures" / "ledger.csv", index=False)


def test_a_changed_number_changes_the_article(clone):
    change(clone, "diagonal", computed="0.41234")
    article.main(clone)
    assert (clone / "article" / "article.pdf").read_bytes() != (FOLDER / "article.pdf").read_bytes()
    quotes = json.loads((clone / "article" / "numbers.json").read_text())
    assert [q["text"] for q in quotes if q["key"] == "diagonal" and q["field"] == "computed"] == [
        "0.41234"
    ]


@pytest.mark.parametrize(
    ("key", "entries", "said"),
    [
        ("diagonal", {}, "0 rows with the key diagonal"),
        ("diagonal", {"verdict": "reproduced"}, "takes diagonal for differs"),
        ("fast", {"computed": "0.0439 of something else"}, "another wording of fast"),
        ("P11", {"verdict": "perhaps"}, "a verdict, that the article does not count"),
    ],
)
def test_what_the_text_was_not_written_for_stops_the_build(clone, key, entries, said):
    change(clone, key, **entries)
    before = (clone / "article" / "article.pdf").read_bytes()
    with pytest.raises(SystemExit, match=said):
        article.main(clone)
    assert (clone / "article" / "article.pdf").read_bytes() == before


def test_an_article_without_a_clone_says_so(tmp_path):
    with pytest.raises(SystemExit, match="make article writes to a clone"):
        article.main(tmp_path)


def test_each_page_is_filled_and_nothing_leaves_it():
    """White margins on each page, and no page that is nearly empty but the last."""
    import io

    import numpy as np
    from PIL import Image

    source = str(FOLDER / "article.typ")
    pages = typst.compile(source, root=str(ROOT), ignore_system_fonts=True, format="png", ppi=50.0)
    assert 6 <= len(pages) <= 12
    for page in pages:
        dark = np.asarray(Image.open(io.BytesIO(page)).convert("L")) < 200
        width = dark.shape[1]
        margin = int(width * 15 / 210)  # 15 of 210 mm: the least margin is 17 mm
        assert not dark[:, :margin].any() and not dark[:, -margin:].any()
    for page in pages[:-1]:
        dark = np.asarray(Image.open(io.BytesIO(page)).convert("L")) < 200
        assert dark[len(dark) // 2 :].any()
