"""The article: its numbers are those of the ledger, and a ledger that has changed is noticed."""

import io
import json
import re
import shutil

import numpy as np
import pytest
import typst
from books import ROWS, text
from PIL import Image

from rodlib.paper import ROOT, article

FOLDER = ROOT / "article"
QUOTES, ARTICLE = text("article/numbers.json"), text("article/article.typ")


def test_what_is_tracked_is_made_of_the_tracked_ledger_and_figures():
    """Otherwise: make article."""
    pdf, quotes = article.compiled()
    assert quotes == QUOTES
    assert (FOLDER / "article.pdf").read_bytes() == pdf


def test_each_row_that_differs_is_explained_in_the_text():
    failed = ROWS.key[(ROWS.verdict == "differs") & (ROWS.kind != "coefficient")]
    assert {*failed} <= {quote["key"] for quote in json.loads(QUOTES)}


def test_numbers_that_are_typed_are_in_the_readme_or_in_the_ledger():
    """Such as 0.013, for which the ledger has no row of its own."""
    prose = [
        re.sub(r"#(?:in-words|note|computed|printed)\([^)]*\)", "", line)
        for line in ARTICLE.splitlines()
        if not re.match(
            r"\s*(?:#(?:set|show|let|import|text|v\()|//|columns|align|inset|table)", line
        )
    ]
    typed = {*re.findall(r"(?<![\w.])\d+(?:[.,]\d+)+", "\n".join(prose))}
    known = text("README.md") + ROWS.to_csv()
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
    for name in re.findall(r'#shown\("([^"]+)"', ARTICLE):
        shutil.copy(ROOT / "figures" / f"{name}.png", tmp_path / "figures")
    return tmp_path


def change(clone, key, **entries):
    """Change a row of the ledger of a clone; without entries the row goes."""
    rows = ROWS.set_index("key")
    if entries:
        rows.loc[key, [*entries]] = [*entries.values()]
    else:
        rows = rows.drop(key)
    rows.to_csv(clone / "figures" / "ledger.csv")


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
    source = str(FOLDER / "article.typ")
    pages = typst.compile(source, root=str(ROOT), ignore_system_fonts=True, format="png", ppi=50.0)
    assert 6 <= len(pages) <= 12
    for page in pages:
        dark = np.asarray(Image.open(io.BytesIO(page)).convert("L")) < 200
        height, width = dark.shape
        margin = int(width * 15 / 210)  # 15 of 210 mm: the least margin is 17 mm
        assert not dark[:, :margin].any() and not dark[:, -margin:].any()
        assert dark[height // 2 :].any() or page is pages[-1]
