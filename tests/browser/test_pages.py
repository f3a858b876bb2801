"""`make pages`: nothing is dead, comes from elsewhere or is missing, and a browser agrees."""

import json
import re
import subprocess
import sys

import pytest
from bs4 import BeautifulSoup

from rodlib.paper import ROOT

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    pytest.importorskip("sphinx_book_theme")
    build = tmp_path_factory.mktemp("build")
    outcome = subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-c", "docs", ".", build / "pages"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert outcome.returncode == 0, outcome.stderr
    assert outcome.stderr == ""  # a warning is a dead link or markup that is not valid
    return build / "pages"


def cells(path, kind):
    cells = json.loads(path.read_text("utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == kind]


def formulas(path):
    """LaTeX in the Markdown of a notebook, a list of what stands between dollars."""
    texts = ["".join(cell["source"]) for cell in cells(path, "markdown")]
    text = re.sub(r"```.*?```|`[^`]*`", "", "\n\n".join(texts), flags=re.DOTALL)
    return re.findall(r"\$\$.+?\$\$|\$[^$]+?\$", text, flags=re.DOTALL)


def folded(path):
    code = cells(path, "code")
    return [c["metadata"].get("jupyter", {}).get("source_hidden", False) for c in code]


def test_the_menu_has_titles(pages):
    page = BeautifulSoup((pages / "README.html").read_text("utf-8"), "html.parser")
    links = page.select("nav.bd-links a")
    menu = {link["href"]: link.get_text(strip=True) for link in links}
    for path in NOTEBOOKS:
        title = cells(path, "markdown")[0]["source"][0].strip().removeprefix("# ")
        assert menu[f"notebooks/{path.stem}.html"] == title.replace("'", "’")
    names = ["figures/ledger", "figures/performance", "docs/reference", "data/README"]
    assert {f"{name}.html" for name in names} <= {*menu}


def test_no_id_stands_twice_and_the_ledger_leads_to_cells(pages):
    ids = {}
    for path in pages.rglob("*.html"):
        page = BeautifulSoup(path.read_text("utf-8"), "html.parser")
        found = [thing["id"] for thing in page.select("[id]")]
        assert len({*found}) == len(found), path
        ids[path.resolve()] = {*found}
    ledger = pages / "figures" / "ledger.html"
    links = BeautifulSoup(ledger.read_text("utf-8"), "html.parser").select("a[href]")
    targets = [link["href"].split("#") for link in links if "#cell-id" in link["href"]]
    assert len(targets) > 300
    for page, cell in targets:
        assert cell in ids[(ledger.parent / page).resolve()]


@pytest.mark.parametrize("width", [400, 800])
def test_the_menus_open_where_they_are_folded(browser, pages, width):
    page = browser.new_page(viewport={"width": width, "height": 800})
    page.goto((pages / "docs" / "reference.html").as_uri())
    for side in ("primary", "secondary"):
        page.locator(f"button.{side}-toggle:visible").click()
        page.locator(f"#pst-{side}-sidebar-modal a").first.wait_for()
        page.keyboard.press("Escape")
        page.locator(f"#pst-{side}-sidebar-modal").wait_for(state="hidden")
    page.close()


SEEN = """() => ({
    width: document.documentElement.scrollWidth,
    formulas: document.querySelectorAll("mjx-container").length,
    nonsense: document.querySelectorAll("[data-mjx-error]").length,
    lost: [...document.images].filter(e => e.complete && !e.naturalWidth).length,
    folded: [...document.querySelectorAll(".cell")].filter(e => e.querySelector(".cell_input"))
        .map(e => e.querySelector("details") !== null),
})"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_on_a_telephone_without_a_network_all_is_there(browser, pages, scheme):
    telephone = {"width": 400, "height": 800}
    context = browser.new_context(viewport=telephone, color_scheme=scheme)
    page, errors, requests = context.new_page(), [], []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    sources = {f"notebooks/{path.stem}": path for path in NOTEBOOKS}
    texts = ["README", "CONTRIBUTING", "figures/ledger"]
    for name in [*texts, *sources]:
        page.goto((pages / f"{name}.html").as_uri())
        page.evaluate("() => window.MathJax && MathJax.startup.promise")
        seen = page.evaluate(SEEN)
        assert (seen["width"], seen["nonsense"], seen["lost"]) == (400, 0, 0), name
        if name in sources:
            # outputs may show some, too
            assert seen["formulas"] >= len(formulas(sources[name])), name
            assert seen["folded"] == folded(sources[name]), name
    elsewhere = [url for url in requests if not url.startswith(("file:", "data:"))]
    assert errors == elsewhere == []
    context.close()


def test_the_search_finds_a_notebook_by_its_words(browser, pages):
    page = browser.new_page()
    page.goto((pages / "search.html").as_uri() + "?q=Butterworth")
    page.locator("#search-results li a").first.wait_for()
    hits = page.locator("#search-results").inner_text()
    assert "Synthesis of the learning filter" in hits
    page.close()
