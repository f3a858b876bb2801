"""The pages: what they link to is there, nothing comes from elsewhere, and a browser agrees."""

import json
import os
import re
import subprocess
import sys
from html import unescape
from urllib.parse import unquote, urlsplit

import pandas as pd
import pytest
from bs4 import BeautifulSoup

from rodlib.paper.pages import TEXTS, as_html, formula, main, page_of
from rodlib.paper.repository import ROOT

CALL = "import pathlib, sys; from rodlib.paper.pages import main; main(pathlib.Path(sys.argv[1]))"
SOURCES = ["pyproject.toml", "README.md", "CONTRIBUTING.md", "LICENSE", "CITATION.cff"]
COPIED = {
    ".py",
    ".csv",
    ".cff",
    ".md",
    ".toml",
    ".lock",
    ".txt",
}  # to be read or downloaded
SOURCES += ["environment.lock", "notebooks", "figures", "data", "rodlib"]


def linked(root):
    """A repository of links to this one, so that what is built does not get into its build/."""
    for name in SOURCES:
        (root / name).symlink_to(ROOT / name)
    return root


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    root = linked(tmp_path_factory.mktemp("repository"))
    call = [sys.executable, "-c", CALL, root]  # apart: pdoc changes what it looks at
    outcome = subprocess.run(call, capture_output=True, text=True)
    assert outcome.returncode == 0 and not outcome.stderr, outcome.stderr
    assert outcome.stdout.endswith(f"open {root / 'build' / 'pages' / 'index.html'}\n")
    assert os.listdir(root / "build") == ["pages"] or "pages.lock" in os.listdir(
        root / "build"
    )
    return root / "build" / "pages"


def parsed(path):
    return BeautifulSoup(path.read_text("utf-8"), "html.parser")


def test_no_link_is_dead_and_nothing_is_fetched_from_elsewhere(pages):
    texts = {
        path: re.sub(
            r"(<script[^>]*>).*?</script>",
            r"\1",
            path.read_text("utf-8"),
            flags=re.DOTALL,
        )
        for path in pages.rglob("*.html")
    }
    names = {str(path.relative_to(pages)) for path in texts}
    assert {
        "index.html",
        "figures/ledger.html",
        "figures.html",
        "rodlib/rod.html",
    } <= names
    assert {
        f"notebooks/{path.stem}.html" for path in (ROOT / "notebooks").glob("*.ipynb")
    } <= names
    anchors = {
        path: {*re.findall(r'<[^<>]* id="([^"]*)"', text)}
        for path, text in texts.items()
    }
    for path, text in texts.items():
        for element, url in re.findall(r'<(\w+) [^<>]*?\b(?:href|src)="([^"]*)"', text):
            target, shown = (
                urlsplit(unescape(url)),
                f"{path.relative_to(pages)}: {url[:100]}",
            )
            if target.scheme == "data":
                continue
            if target.scheme:  # a link to follow, nothing that the page needs
                assert element == "a" and target.scheme in ("https", "mailto"), shown
                continue
            place = (
                (path.parent / unquote(target.path)).resolve() if target.path else path
            )
            assert place.is_file() and place.is_relative_to(pages), shown
            if target.fragment and place in anchors:
                assert unquote(target.fragment) in anchors[place], shown
        assert "<iframe" not in text
        assert not re.search(r"""url\((?!['"]?data:)|@import""", text)
    assert {path.suffix for path in pages.rglob("*.*")} <= {
        ".html",
        ".js",
        ".png",
        *COPIED,
    }


def test_the_texts_have_their_pages(pages):
    for text in TEXTS:
        page = page_of(text)
        written = re.findall(
            r"^#+ (.*)", (ROOT / text).read_text("utf-8"), re.MULTILINE
        )
        headings = [
            e.contents[0] for e in parsed(pages / page).select("main :is(h1, h2, h3)")
        ]
        assert headings and {*headings} <= {*written}, page


def test_formulas_are_drawn_and_pictures_have_words(pages):
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        cells = json.loads(path.read_text("utf-8"))["cells"]
        page = parsed(pages / "notebooks" / f"{path.stem}.html")
        text = "\n\n".join(
            "".join(c["source"]) for c in cells if c["cell_type"] == "markdown"
        )
        text = re.sub(r"```.*?```|`[^`]*`", "", text, flags=re.DOTALL)
        formulas = re.findall(r"\$\$(.+?)\$\$|\$([^$]+?)\$", text, flags=re.DOTALL)
        drawn = [e["aria-label"] for e in page.select("svg.math")]
        assert drawn == [" ".join((a or b).split()) for a, b in formulas]
        pictures = page.select("img")
        assert pictures and all(len(e["alt"]) >= 40 for e in pictures)
        assert page.h1.get_text() and page.title.get_text() in page.h1.get_text()
    assert {e["src"] for e in parsed(pages / "figures.html").select("main img")} == {
        f"figures/{path.name}"
        for path in (ROOT / "figures").glob("*.png")
        if path.stem not in ("performance", "workbench")  # of no notebook
    }


def test_folded_code_is_a_line_that_opens_it(pages):
    seen = set()
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        cells = json.loads(path.read_text("utf-8"))["cells"]
        code = [cell for cell in cells if cell["cell_type"] == "code"]
        shown = parsed(pages / "notebooks" / f"{path.stem}.html").select(".code_cell")
        for cell, element in zip(code, shown, strict=True):
            folded, source = (
                element.select_one(".input > details"),
                "".join(cell["source"]),
            )
            hidden = cell["metadata"].get("jupyter", {}).get("source_hidden", False)
            assert (folded is not None) == hidden
            assert not element.select("details[open], details img")
            assert (folded or element).select_one(
                ".highlight"
            ).get_text().strip() == source.strip()
            seen.add(folded and folded.summary.get_text())
    assert seen == {None, "imports", "code of the picture", "code of the ledger's rows"}


def test_the_ledger_is_all_there(pages):
    rows = pd.read_csv(
        ROOT / "figures" / "ledger.csv", dtype=str, keep_default_na=False
    )
    shown = (
        parsed(pages / "figures" / "ledger.html").select("table")[-1].select("tbody tr")
    )
    for element, (_, *texts) in zip(shown, rows.itertuples(index=False), strict=True):
        assert [cell.get_text() for cell in element.select("td")] == texts
        (link,) = element.select("a")
        assert link["href"] == f"../notebooks/{link.get_text()}.html"


def test_a_formula_sits_on_the_line_and_nonsense_is_refused():
    x, fraction = formula("x"), formula(r"\frac{a}{b}", inline=False)
    heights = [
        float(re.search(r'height="([\d.]+)em"', drawn)[1]) for drawn in (x, fraction)
    ]
    below = [
        -float(re.search(r"vertical-align:(-[\d.]+)em", drawn)[1])
        for drawn in (x, fraction)
    ]
    assert heights[0] < 1 < heights[1] and 0 <= below[0] < 0.2 < below[1] < heights[1]
    assert 'aria-label="\\frac{a}{b}"' in fraction and "currentColor" in fraction
    with pytest.raises(ValueError, match=r"the formula .* cannot be drawn"):
        formula(r"\begin{bmatrix} 1 \nosuchthing")
    assert '<h2 id="was-x-50-a-good-choice">Was <svg' in as_html(
        "## Was $x = 50$ a *good* choice?"
    )
    table = as_html("a [link](x.md) and $\\sigma$\n\n| a |\n|---|\n| 1 |\n\n`$a$`")
    assert "<table>" in table and "<code>$a$</code>" in table and table.count("$") == 2


def test_a_dead_link_or_a_bad_formula_leaves_the_earlier_pages_alone(tmp_path):
    linked(tmp_path)
    (tmp_path / "build" / "pages").mkdir(parents=True)
    (tmp_path / "build" / "pages" / "index.html").write_text("from before")
    (tmp_path / "README.md").unlink()
    for text, message in (
        ("see [that](nowhere.md)", "README.md links to nowhere.md, which is not there"),
        (r"as $\nosuchthing{$", "the formula"),
    ):
        (tmp_path / "README.md").write_text(f"# Title\n\n{text}\n")
        with pytest.raises(SystemExit, match=message):
            main(tmp_path)
        assert (
            tmp_path / "build" / "pages" / "index.html"
        ).read_text() == "from before"
        assert {*os.listdir(tmp_path / "build")} <= {"pages", "pages.lock"}


SEEN = """() => ({
    width: document.documentElement.scrollWidth,
    formulas: [...document.querySelectorAll("svg.math")]
        .filter(e => !e.getBoundingClientRect().height).length,
    pictures: [...document.images].filter(e => e.complete && !e.naturalWidth).length,
    hidden: ["color", "backgroundColor"].map(e => getComputedStyle(document.body)[e])
        .every((e, _, all) => e === all[0]),
})"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_on_a_telephone_nothing_sticks_out_or_is_missing(browser, pages, scheme):
    context = browser.new_context(
        viewport={"width": 400, "height": 800}, color_scheme=scheme
    )
    page, said = context.new_page(), []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on(
        "request",
        lambda request: (
            request.url.startswith(("file:", "data:")) or said.append(request.url)
        ),
    )
    places = [*pages.glob("*.html"), pages / "rodlib" / "rod.html"]
    places += [*pages.glob("notebooks/*.html"), *pages.glob("figures/*.html")]
    places += [*pages.glob("data/*.html")]
    for place in places:
        page.goto(place.as_uri())
        seen = page.evaluate(SEEN)
        name = str(place.relative_to(pages))
        assert seen == {"width": 400, "formulas": 0, "pictures": 0, "hidden": False}, (
            name
        )
        assert said == [], name
    context.close()


@pytest.mark.parametrize("width", [400, 1280])
def test_folded_code_opens_and_its_picture_stays(browser, pages, width):
    page = browser.new_page(viewport={"width": width, "height": 800})
    page.goto((pages / "notebooks" / "01-model.html").as_uri())
    cell = page.locator(
        ".code_cell", has=page.locator("summary", has_text="picture")
    ).first
    code, picture = cell.locator(".highlight"), cell.locator("img")
    assert picture.is_visible() and not code.is_visible()
    cell.locator("summary").click()
    assert picture.is_visible() and code.is_visible()
    assert page.evaluate("() => document.documentElement.scrollWidth") == width
    page.close()


def test_the_ledger_is_searched_and_filtered(browser, pages):
    rows = pd.read_csv(
        ROOT / "figures" / "ledger.csv", dtype=str, keep_default_na=False
    )
    page = browser.new_page()
    page.goto((pages / "figures" / "ledger.html").as_uri())
    shown = page.locator("#ledger tbody tr:visible")
    assert shown.count() == len(rows)
    for verdict in rows.verdict.unique():
        if verdict != "differs":
            page.get_by_label(verdict).uncheck()
    assert shown.count() == (rows.verdict == "differs").sum() > 0
    page.get_by_label("Search").fill("MONOTONICALLY 2500")
    assert shown.count() == 1 and "Lemma 1" in shown.inner_text()
    assert page.locator("#shown").inner_text() == f"1 of {len(rows)} rows"
    page.get_by_label("Search").fill("no such row")
    assert shown.count() == 0
    page.close()
