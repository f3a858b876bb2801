"""The compendium as pages to read without installing anything: what ``make pages`` runs.

The committed notebooks, the ledger, the figures, the README and the reference of the modules become
HTML in build/pages, which needs no network, and no script but to search and to filter. nbconvert
makes it of notebooks and Markdown, pdoc of docstrings, and the frame of pdoc is around all of it.
"""

import posixpath
import re
import shutil
import sys
import tempfile
from html import escape
from pathlib import Path, PurePosixPath
from pkgutil import walk_packages
from xml.etree import ElementTree

import nbformat
import pandas as pd
import pdoc
import ziamath
from nbconvert import HTMLExporter
from nbconvert.filters.markdown_mistune import IPythonRenderer, MarkdownWithMath
from pygments.formatters import HtmlFormatter

import rodlib
from rodlib.ilc import laboratory
from rodlib.ilc.files import alone, folder
from rodlib.paper.ledger import DEVIATIONS
from rodlib.paper.repository import ROOT, checkout

PLACES = {  # of what links may lead to, beside notebooks, modules and files
    "README.md": "index.html",
    "CONTRIBUTING.md": "contributing.html",
    "data/README.md": "data.html",
    "figures/performance.md": "performance.html",
    "figures": "figures.html",
    "figures/ledger.md": "ledger.html",
    "rodlib": "reference/rodlib.html",
    "rodlib/ilc": "reference/rodlib/ilc.html",
    "data": "data.html",
    "notebooks": "index.html",
}
TEMPLATES = Path(__file__).with_name("templates")  # which go before those of pdoc
FIGURES = (
    "All figures of the notebooks. Those that begin with *fig* follow a figure of the paper, with "
    "its number; the *extra* ones show what the paper does not."
)
SIZE = 16  # pixels at which formulas are drawn; on the page they are as large as the text around
ziamath.config.svg2 = False  # glyphs as paths, since two drawings on a page must not share names


def place_of(path: str) -> str:
    """Where the pages hold what the repository has at a path."""
    found = PurePosixPath(path)
    if found.suffix == ".ipynb":
        return str(found.with_suffix(".html"))
    if found.suffix == ".py" and found.parts[0] == "rodlib":
        return f"reference/{found.with_suffix('.html')}"
    return PLACES.get(path, path)


def formula(tex: str, inline: bool = True) -> str:
    """Draw LaTeX as an SVG element, to stand on the line of the text; its words are the LaTeX."""
    try:
        drawn = ziamath.Latex(tex.strip(), size=SIZE, color="currentColor", inline=inline)
        element = drawn.svgxml()
    except Exception as error:  # of many kinds
        raise ValueError(f"the formula {tex!r} cannot be drawn: {error}") from error
    _, top, _, height = (float(number) for number in element.attrib["viewBox"].split())
    for name in ("width", "height"):
        element.set(name, f"{float(element.attrib[name]) / SIZE:.4f}em")
    element.set("style", f"vertical-align:{-(top + height) / SIZE:.4f}em")
    element.attrib |= {"class": "math", "role": "img", "aria-label": " ".join(tex.split())}
    return ElementTree.tostring(element, encoding="unicode")


class Renderer(IPythonRenderer):
    """Markdown as nbconvert makes HTML of it, with drawn formulas, in headings, too."""

    def heading(self, text, level, **attrs):
        words = re.sub(r'<svg.*?aria-label="(.*?)".*?</svg>|<[^>]+>', r"\1", text, flags=re.DOTALL)
        name = re.sub(r"\W+", "-", words).strip("-").lower()
        link = f'<a class="anchor-link" href="#{name}" aria-label="link to this heading">¶</a>'
        return f'<h{level} id="{name}">{text}{link}</h{level}>\n'

    def inline_math(self, body):
        return formula(body)

    def block_math(self, body):
        return f'<div class="display">{formula(body, inline=False)}</div>'


as_html = MarkdownWithMath(renderer=Renderer(escape=False)).render


class Pages:
    """The pages of a repository as they are written to an empty folder."""

    def __init__(self, root: Path, target: Path):
        self.root, self.target = root, target
        self.notebooks = {
            f"notebooks/{path.name}": nbformat.read(path, as_version=4)
            for path in sorted((root / "notebooks").glob("*.ipynb"))
        }
        colours = {
            scheme: HtmlFormatter(style=style).get_style_defs([".highlight", ".pdoc-code"])
            for scheme, style in (("light", "default"), ("dark", "github-dark"))
        }
        pdoc.render.configure(
            docformat="numpy", favicon="data:,", show_source=False, template_directory=TEMPLATES
        )
        menu = [(place_of(path), _named(path)) for path in self.notebooks]
        pdoc.render.env.globals |= {"menu": menu, **colours}

    def write(self, page: str, title: str, **body) -> None:
        """Write a page around its body, by the template of its name or else that of all."""
        template = pdoc.render.env.select_template([f"{page}.jinja2", "page.html.jinja2"])
        path = self.target / page
        folder(path.parent)
        text = template.render(title=title, page=page, up="../" * page.count("/"), **body)
        path.write_text(text, encoding="utf-8")

    def link(self, page: str, source: str, url: str) -> str:
        """What a link in a document of the repository is on a page; a file is copied."""
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
            folder((self.target / place).parent)
            shutil.copyfile(self.root / path, self.target / place)
        return posixpath.relpath(place, posixpath.dirname(page) or ".") + (anchor and f"#{anchor}")

    def document(self, source: str, notebook) -> None:
        """A page from a notebook with its outputs, or from one cell of Markdown."""
        page = place_of(source)
        exporter = HTMLExporter(
            template_name="basic", exclude_input_prompt=True, exclude_output_prompt=True
        )
        exporter.register_filter("markdown2html", as_html)
        body, _ = exporter.from_notebook_node(notebook)
        body = re.sub(
            r'\b(href|src)="([^"]+)"',
            lambda found: f'{found[1]}="{self.link(page, source, found[2])}"',
            body,
        )
        title = re.search(r"^# (.*)", notebook.cells[0].source, re.MULTILINE)[1]
        self.write(page, re.sub(r"[*`$]", "", title), body=body)

    def figures(self) -> None:
        """A page with all figures of the notebooks, by notebook, with their captions."""
        lines = ["# Figures", FIGURES]
        for path, notebook in self.notebooks.items():
            lines.append(f"## [{_named(path)}]({path})")
            outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
            for output in outputs:
                if "image/png" in output.get("data", {}):
                    name = output.data["text/plain"]
                    caption = escape(output.metadata["image/png"]["alt"])
                    lines.append(
                        f'<figure><img src="{name}" alt="{caption}" loading="lazy"><figcaption>'
                        f"<strong>{Path(name).stem}.</strong> {caption}</figcaption></figure>"
                    )
        self.document("figures", _notebook("\n\n".join(lines)))

    def ledger(self) -> None:
        """A page with the ledger, to be searched and filtered."""
        rows = pd.read_csv(self.root / "figures" / "ledger.csv", dtype=str, keep_default_na=False)
        self.write(
            "ledger.html", "The ledger", rows=rows.to_dict("records"),
            verdicts=rows.verdict.value_counts().to_dict(),
            deviations=as_html(DEVIATIONS.read_text(encoding="utf-8")),
        )  # fmt: skip

    def reference(self) -> None:
        """The reference of the modules, from their docstrings."""
        for package in (rodlib, rodlib.ilc, laboratory):  # pdoc does not ask them for their names
            vars(package).update({name: getattr(package, name) for name in package.__all__})
        modules = [
            name
            for _, name, _ in walk_packages(rodlib.__path__, "rodlib.")
            if hasattr(sys.modules.get(name.rpartition(".")[0]), "__all__")  # pdoc finds the others
        ]
        pdoc.pdoc("rodlib", *modules, output_directory=self.target / "reference")


def make_pages(root: Path = ROOT) -> Path:
    """Write all pages to build/pages, which is replaced whole, and say where they begin."""
    build = folder(checkout("make pages", root) / "build")
    refusal = f"make pages is already running in {root}: wait until it has ended"
    with alone(build / "pages.lock", refusal), tempfile.TemporaryDirectory(dir=build) as made:
        pages = Pages(root, Path(made))
        for source in ("README.md", "CONTRIBUTING.md", "data/README.md", "figures/performance.md"):
            pages.document(source, _notebook((root / source).read_text(encoding="utf-8")))
        for source, notebook in pages.notebooks.items():
            print(source, flush=True)
            pages.document(source, notebook)
        pages.figures()
        pages.ledger()
        print("reference", flush=True)
        pages.reference()
        shutil.rmtree(build / "pages", ignore_errors=True)
        shutil.move(made, build / "pages")
        folder(Path(made))  # for the one that removes it
    return build / "pages" / "index.html"


def _named(path):
    return Path(path).stem.replace("-", " ", 1)


def _notebook(markdown):
    return nbformat.v4.new_notebook(cells=[nbformat.v4.new_markdown_cell(markdown)])


def main(root: Path = ROOT) -> None:
    """Make the pages, and say where they begin, or leave with a message."""
    try:
        print(f"open {make_pages(root)}")
    except (RuntimeError, ValueError, OSError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
