"""JupyterLab and the pages in a Chromium or $CHROMIUM; without a browser, they skip."""

import os
import re
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import matplotlib
import nbformat
import pytest

import rodlib
from ilctools import InfeasibleError
from rodlib.paper import ROOT

SCREENSHOT = ROOT / "build" / "browser" / "workbench.png"
PATIENCE = 300  # s, for what takes a few on a machine that is not busy: a last resort
NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")
SHOWN = """text => document.querySelector(".widget-interact .jp-OutputArea")
    ?.innerText.replace(/\\s+/g, "") === text.replace(/\\s+/g, "")"""
LOADED = """async () => { await (window.MathJax && MathJax.startup.promise);
    return [document.documentElement.scrollWidth, document.querySelectorAll("mjx-container").length,
        document.querySelectorAll("[data-mjx-error]").length,
        [...document.images].filter(e => e.complete && !e.naturalWidth).length,
        [...document.querySelectorAll("main table.cards, main pre")].filter(e =>
            e.clientWidth && (e.tagName === "TABLE" ? e.offsetWidth > e.parentElement.clientWidth
                : innerWidth > 700 && e.scrollWidth > e.clientWidth)).length]; }"""
# Entries of more than a few words that stand in a column of a few letters.
SQUEEZED = """() => [...document.querySelectorAll("main td")].filter(
    e => e.clientWidth && e.clientWidth < 100 && e.innerText.length > 30).length"""
VISIBLE = ":is(.search-button__button, input[type=search]):visible"
GENERATED = ("genindex", "py-modindex", "search")  # by Sphinx
PARTS = ["Start", "Use", "The paper", "Beyond it", "Reference"]


@pytest.fixture(scope="module")
def browser():
    """$CHROMIUM, a Chromium or Chrome on the path, or the one that playwright has installed."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with sync_api.sync_playwright() as playwright:
        paths = [os.environ.get("CHROMIUM"), *map(shutil.which, NAMES)]
        path = next(filter(None, paths), playwright.chromium.executable_path)
        if not Path(path).exists():
            pytest.skip("no browser: install chromium or Chrome, or name one in $CHROMIUM")
        # Pages of this test only: the sandbox is not missed, and root could not have one.
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def page(browser):
    """A page that raises no error."""
    page, errors = browser.new_page(), []
    page.set_default_timeout(1000 * PATIENCE)
    page.on("pageerror", lambda error: errors.append(error.stack))
    yield page
    page.close()
    assert not errors


@pytest.fixture
def lab(tmp_path):
    """Address of a JupyterLab as `make lab` starts it, with the cell of the workbench alone."""
    book = nbformat.read(ROOT / "notebooks" / "12-workbench.ipynb", 4)
    book.cells = [cell for cell in book.cells if "panel = open_workbench(" in cell.source]
    settings = shutil.copytree(
        ROOT / "notebooks" / ".jupyterlab", tmp_path / "notebooks/.jupyterlab"
    )
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")
    options = re.search(r"jupyter lab \$\(LAB\) (.*?) #", makefile)[1].split()
    opened = re.search(r"default_url=/lab/tree/(\S+)", makefile)[1]
    nbformat.write(book, settings.with_name(opened))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"http://127.0.0.1:{free.getsockname()[1]}"
    options += ["--no-browser", "--allow-root", f"--port={address.rpartition(':')[2]}"]
    surroundings = {k: v for k, v in os.environ.items() if not k.startswith(("JUPYTER", "JPY"))}
    surroundings |= {"HOME": str(tmp_path), "MPLCONFIGDIR": matplotlib.get_cachedir()}
    surroundings |= {"JUPYTER_PREFER_ENV_PATH": "1", "JUPYTER_TOKEN": "a-test"}
    call = [sys.executable, "-m", "jupyterlab", *options]
    with open(tmp_path / "log", "w") as log:
        server = subprocess.Popen(call, cwd=tmp_path, env=surroundings, stdout=log, stderr=log)
    try:
        end = time.monotonic() + PATIENCE
        while not answers(f"{address}/api"):
            assert time.monotonic() < end and server.poll() is None, (tmp_path / "log").read_text()
            time.sleep(0.2)
        yield f"{address}/?token=a-test"
    finally:
        server.terminate()
        server.wait(PATIENCE)


def answers(address):
    try:
        urllib.request.urlopen(address, timeout=5).close()
    except OSError:
        return False
    return True


def certificate(**choices):
    """Of the rod's design with these choices, made here."""
    choices = {"cutoff": 0.1} | rodlib.paper_choices(**choices)
    design, _ = rodlib.try_out(rodlib.paper_loop(), rodlib.assumed_reference(), **choices)
    return str(design.certificate)


def test_a_slider_changes_the_picture_and_the_certificate(page, lab):
    """From the keyboard, and to what is infeasible by a number that is typed."""
    page.set_viewport_size({"width": 1280, "height": 1150})
    page.goto(lab)
    page.get_by_text("| Idle").wait_for()  # the kernel; before, cells are not run
    page.locator(".jp-CodeCell .cm-content").click()
    page.keyboard.press("Shift+Enter")
    slider = page.locator(".widget-slider", has_text=re.compile("^M_max"))

    def pictures(text):
        """Those above the text, once it is shown."""
        page.wait_for_function(SHOWN, arg=text)
        images = page.locator(".widget-interact .jp-OutputArea img").all()
        return [image.get_attribute("src") for image in images]

    (first,) = pictures(certificate())
    slider.locator(".noUi-handle").press("ArrowRight")
    (second,) = pictures(certificate(M_max=0.901))
    assert first.startswith("data:image/png;base64,") and first != second
    page.locator(".widget-interact").screenshot(path=SCREENSHOT)
    slider.locator(".widget-readout").fill("0.3")
    page.keyboard.press("Enter")
    with pytest.raises(InfeasibleError) as refusal:
        certificate(M_max=0.3)
    assert pictures(str(refusal.value)) == []


def test_pages_show_all_there_is_without_a_network(page, tmp_path):
    """A dead link, or markup that is not valid, is a warning of Sphinx."""
    pytest.importorskip("sphinx_book_theme")
    call = [sys.executable, "-m", "sphinx", "-q", "-c", "docs", ".", tmp_path]
    outcome = subprocess.run(call, cwd=ROOT, capture_output=True, text=True)
    assert (outcome.returncode, outcome.stderr) == (0, "")
    requests = []
    page.on("request", lambda request: requests.append(request.url))
    (tmp_path / "index.html").unlink()  # which leads to README.html
    paths = [*tmp_path.glob("*.html"), *tmp_path.glob("[!_]*/*.html")]
    assert len(paths) > 35
    for path in paths:
        page.goto(path.as_uri())
        for width in (360, 768, 1280):
            page.set_viewport_size({"width": width, "height": 800})
            wide, formulas, misprinted, lost, cut = page.evaluate(LOADED)
            assert (wide, misprinted, lost, cut) == (width, 0, 0, 0), path
        assert formulas or path.parent.name != "notebooks"
    page.goto((tmp_path / "notebooks/05-experiment-replay.html").as_uri())
    slider, shown = page.locator("#trial"), page.locator("a:has(+ .trials) img")
    whole = shown.get_attribute("src")
    for wide, key, ends in ((400, "End", "trial-10.png"), (1280, "ArrowLeft", "trial-9.png")):
        page.set_viewport_size({"width": wide, "height": 900})
        slider.press(key)
        assert shown.get_attribute("src").endswith(ends) and page.evaluate(LOADED)[0] == wide
        page.wait_for_function("e => e.naturalWidth", arg=shown.element_handle())
    slider.press("Home")
    assert shown.get_attribute("src") == whole
    slider.click()  # by the mouse, in its middle
    assert page.url.endswith("replay.html") and shown.get_attribute("src").endswith("trial-5.png")
    page.set_viewport_size({"width": 360, "height": 800})
    for name, tallest in (("docs/guide", 20_000), ("figures/ledger", 100_000)):
        page.goto((tmp_path / f"{name}.html").as_uri())
        assert page.evaluate(SQUEEZED) == 0
        assert page.evaluate("document.documentElement.scrollHeight") < tallest
    start = tmp_path / "README.html"
    page.goto(start.as_uri())
    assert page.locator(VISIBLE).count() == 1
    page.locator("button.primary-toggle").click()  # the guide is two clicks away
    page.locator("nav.bd-links").get_by_role("link", name="Guide").click()
    assert page.url.endswith("docs/guide.html")
    page.set_viewport_size({"width": 1280, "height": 800})
    page.goto(start.as_uri())
    assert page.locator(VISIBLE).count() == 1
    assert page.locator("nav.bd-links .caption").all_inner_texts() == PARTS
    links = page.locator("nav.bd-links a").evaluate_all("all => all.map(a => a.href)")
    texts = [path for path in paths if path.stem not in GENERATED and path != start]
    assert sorted(links) == sorted(path.as_uri() for path in texts)
    assert all(url.startswith(("file:", "data:")) for url in requests)
    ledger = (tmp_path / "figures" / "ledger.html").read_text("utf-8")
    cells = {*re.findall(r'href="\.\./(notebooks/\S+\.html)#(cell-id=[^"]+)"', ledger)}
    readme = (tmp_path / "README.html").read_text("utf-8")
    keys = re.findall(r'href="figures/ledger.html#([^"]+)"', readme)
    assert len(keys) > 5 and all(f'id="{key}"' in ledger for key in keys)
    assert len(cells) > 10
    texts = {target: (tmp_path / target).read_text("utf-8") for target, _ in cells}
    assert all(texts[target].count(f'id="{cell}"') == 1 for target, cell in cells)
