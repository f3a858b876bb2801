"""The compendium as pages to read without installing anything: what ``make pages`` runs.

The committed notebooks, the ledger, the figures, the README and the reference of the module become
HTML in build/pages, which needs no network, and no script but to search and to filter.
"""

import json
import posixpath
import re
import shutil
import sys
import tempfile
from pathlib import Path, PurePosixPath
from pkgutil import walk_packages

import pandas as pd
from jinja2 import Environment, FileSystemLoader
from pygments.formatters import HtmlFormatter

from rodlib.ilc.files import alone, folder
from rodlib.paper.pages.text import as_html
from rodlib.paper.repository import ROOT, checkout

HERE = Path(__file__).parent
DOCUMENTS = {  # of the repository, and the page that each becomes
    "README.md": "index.html",
    "CONTRIBUTING.md": "contributing.html",
    "data/README.md": "data.html",
}
PLACES = DOCUMENTS | {  # what links may lead to beside notebooks, modules and files
    "figures": "figures.html",
    "figures/ledger.md": "ledger.html",
    "rodlib": "reference/rodlib.html",
    "data": "data.html",
    "notebooks": "index.html",
}


def place_of(path: str) -> str:
    """Where the pages hold what the repository has at a path."""
    found = PurePosixPath(path)
    if path in PLACES:
        return PLACES[path]
    if found.suffix == ".ipynb":
        return str(found.with_suffix(".html"))
    if found.suffix == ".py" and found.parts[0] == "rodlib":
        return f"reference/{found.with_suffix('.html')}"
    return path


class Pages:
    """The pages as they are written to a folder.

    Parameters
    ----------
    root : Path
        The repository.
    target : Path
        An empty folder.
    """

    def __init__(self, root: Path, target: Path):
        self.root, self.target = root, target
        self.template = Environment(loader=FileSystemLoader(HERE), autoescape=False)
        self.notebooks = {
            path: _cells(path) for path in sorted((root / "notebooks").glob("*.ipynb"))
        }
        self.menu = [
            (place_of(f"notebooks/{path.name}"), path.stem.replace("-", " ", 1))
            for path in self.notebooks
        ]

    def write(self, page: str, title: str, body: str) -> None:
        """Write a page around its body."""
        up = "../" * page.count("/")
        text = self.template.get_template("page.html").render(
            title=title, body=body, up=up, page=page, menu=self.menu
        )
        path = self.target / page
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")

    def link(self, page: str, source: str, url: str) -> str:
        """What a link in a document of the repository is on a page; a file is copied.

        Raises
        ------
        ValueError
            If it leads nowhere.
        """
        if re.match(r"[a-z]+:|#", url):
            return url
        path, _, anchor = url.partition("#")
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        if not (self.root / path).exists():
            raise ValueError(f"{source} links to {path}, which is not there")
        place = place_of(path)
        if place == path:
            if (self.root / path).is_dir():
                raise ValueError(f"{source} links to the folder {path}, which has no page")
            (self.target / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(self.root / path, self.target / place)
        return posixpath.relpath(place, posixpath.dirname(page) or ".") + (anchor and f"#{anchor}")

    def document(self, source: str) -> None:
        """A page from a document in Markdown."""
        markdown, page = (self.root / source).read_text(encoding="utf-8"), place_of(source)
        body = as_html(markdown, lambda url: self.link(page, source, url))
        self.write(page, _title(markdown), body)

    def notebook(self, path: Path) -> None:
        """A page from a notebook as it is committed, with its outputs."""
        from nbconvert import HTMLExporter  # here, because it takes long to import

        source = f"notebooks/{path.name}"
        page, cells = place_of(source), self.notebooks[path]
        exporter = HTMLExporter(
            template_name="basic", exclude_input_prompt=True, exclude_output_prompt=True
        )
        exporter.register_filter(
            "markdown2html",
            lambda text: as_html(text, lambda url: self.link(page, source, url)),
        )
        body, _ = exporter.from_filename(str(path))
        position = [place for place, _ in self.menu].index(page)
        around = [
            self.menu[k] if 0 <= k < len(self.menu) else None for k in (position - 1, position + 1)
        ]
        steps = self.template.get_template("steps.html").render(around=around)
        self.write(page, _title(cells[0]), body + steps)

    def figures(self) -> None:
        """A page with all figures of the notebooks, by notebook, with their captions."""
        shown = {}
        for path in self.notebooks:
            for caption, name in _pictures(path):
                shutil.copyfile(self.root / name, _made(self.target / name))
                shown.setdefault(path.stem, []).append((name, caption))
        body = self.template.get_template("figures.html").render(shown=shown)
        self.write("figures.html", "Figures", body)

    def ledger(self) -> None:
        """A page with the ledger, to be searched and filtered."""
        rows = pd.read_csv(self.root / "figures" / "ledger.csv", dtype=str, keep_default_na=False)
        body = self.template.get_template("ledger.html").render(
            rows=rows.to_dict("records"), verdicts=rows.verdict.value_counts().to_dict()
        )
        self.write("ledger.html", "The ledger", body)

    def reference(self) -> None:
        """The reference of the module, from its docstrings."""
        import pdoc

        import rodlib

        # what the door hands on, it imports when asked for it; pdoc looks without asking
        vars(rodlib).update({name: getattr(rodlib, name) for name in rodlib.__all__})
        modules = [
            name
            for _, name, _ in walk_packages(rodlib.__path__, "rodlib.")
            if hasattr(sys.modules.get(name.rpartition(".")[0]), "__all__")  # pdoc finds the others
        ]
        pdoc.render.configure(
            docformat="numpy", favicon="data:,", template_directory=HERE / "reference",
            show_source=False,
        )  # fmt: skip
        pdoc.pdoc("rodlib", *modules, output_directory=self.target / "reference")

    def style(self) -> None:
        """The style sheet, with the colours of the code."""
        light = HtmlFormatter(style="default").get_style_defs(".highlight")
        dark = HtmlFormatter(style="github-dark").get_style_defs(".highlight")
        style = (HERE / "style.css").read_text(encoding="utf-8")
        (self.target / "style.css").write_text(
            f"{light}\n@media (prefers-color-scheme: dark) {{\n{dark}\n}}\n{style}",
            encoding="utf-8",
        )
        shutil.copyfile(HERE / "ledger.js", self.target / "ledger.js")


def make_pages(root: Path = ROOT) -> Path:
    """Write all pages to build/pages, which is replaced whole.

    Parameters
    ----------
    root : Path
        The repository.

    Returns
    -------
    Path
        The entrance.

    Raises
    ------
    RuntimeError
        If the command is running already, or `root` is no clone.
    ValueError
        If a link leads nowhere, or a formula cannot be drawn.
    """
    build = folder(checkout("make pages", root) / "build")
    refusal = f"make pages is already running in {root}: wait until it has ended"
    with alone(build / "pages.lock", refusal), tempfile.TemporaryDirectory(dir=build) as made:
        pages = Pages(root, Path(made))
        pages.style()
        for document in DOCUMENTS:
            pages.document(document)
        for path in pages.notebooks:
            print(path.stem, flush=True)
            pages.notebook(path)
        pages.figures()
        pages.ledger()
        print("reference", flush=True)
        pages.reference()
        shutil.rmtree(build / "pages", ignore_errors=True)
        shutil.move(made, build / "pages")
        folder(Path(made))  # for the one that removes it
    return build / "pages" / "index.html"


def _cells(path):
    """The sources of a notebook's cells."""
    return ["".join(cell["source"]) for cell in json.loads(path.read_text("utf-8"))["cells"]]


def _pictures(path):
    """Caption and file of the figures in a notebook."""
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        for output in cell.get("outputs", []):
            if "image/png" in output.get("data", {}):
                name = "".join(output["data"]["text/plain"])
                yield output["metadata"]["image/png"]["alt"], name


def _title(markdown):
    """The first heading, without marks."""
    return re.sub(r"[*`$]", "", re.search(r"^# (.*)", markdown, re.MULTILINE)[1])


def _made(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def main(root: Path = ROOT) -> None:
    """Make the pages, and say where they begin, or leave with a message."""
    try:
        print(f"open {make_pages(root)}")
    except (RuntimeError, ValueError, OSError) as error:
        sys.exit(str(error))
