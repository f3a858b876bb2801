"""The compendium as pages to read without installing anything: what ``make pages`` runs.

nbconvert makes HTML of notebooks and Markdown, pdoc of docstrings, and the frame of pdoc is around
all of it. The pages, in build/pages, need no network, and no script but to search and to filter.
"""

import posixpath
import re
import shutil
import sys
import tempfile
from html import escape
from pathlib import Path
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
from rodlib.ilc.files import folder
from rodlib.paper.ledger import DEVIATIONS
from rodlib.paper.repository import ROOT, checkout

TEXTS = {  # of the repository, with their pages
    "README.md": "index.html",
    "CONTRIBUTING.md": "contributing.html",
    "data/README.md": "data.html",
    "figures/performance.md": "performance.html",
}
PLACES = TEXTS | {  # of what else links may lead to, beside notebooks, modules and files
    "figures": "figures.html",
    "figures/ledger.md": "ledger.html",
    "data": "data.html",
    "notebooks": "index.html",
}
FIGURES = """# Figures

All figures of the notebooks. Those that begin with *fig* follow a figure of the paper, with its
number; the *extra* ones show what the paper does not."""
TEMPLATES = Path(__file__).with_name("templates")  # which go before pdoc's and nbconvert's
SIZE = 16  # pixels at which formulas are drawn; on the page they are as large as the text around
ziamath.config.svg2 = False  # glyphs as paths, since two drawings on a page must not share names


def place_of(path: str) -> str:
    """Where the pages hold what the repository has at a path."""
    if path.endswith(".ipynb"):
        return path.replace(".ipynb", ".html")
    if path.split("/")[0] == "rodlib":
        return f"reference/{path.removesuffix('.py')}.html"
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


def write(target: Path, page: str, title: str, form: str = "page.html.jinja2", **body) -> None:
    """Write a page around its body, by a template."""
    template = pdoc.render.env.get_template(form)
    text = template.render(title=title, page=page, up="../" * page.count("/"), **body)
    (folder((target / page).parent) / Path(page).name).write_text(text, encoding="utf-8")


def linked(root: Path, target: Path, source: str, url: str) -> str:
    """What a link in a document of the repository is on its page; a file is copied."""
    if re.match(r"[a-z]+:|#", url):
        return url
    path, _, anchor = url.partition("#")
    path = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
    place, start = place_of(path), posixpath.dirname(place_of(source))
    if not (root / path).exists():
        raise ValueError(f"{source} links to {path}, which is not there")
    if place == path:
        if (root / path).is_dir():
            raise ValueError(f"{source} links to the folder {path}, which has no page")
        shutil.copyfile(root / path, folder((target / path).parent) / Path(path).name)
    return posixpath.relpath(place, start or ".") + (anchor and f"#{anchor}")


def document(root: Path, target: Path, source: str, text: str, body: str) -> None:
    """A page from a document whose Markdown begins with a title, and whose HTML is `body`."""

    def link(found):
        return f'{found[1]}="{linked(root, target, source, found[2])}"'

    title = re.search(r"^# (.*)", text, re.MULTILINE)[1]
    body = re.sub(r'\b(href|src)="([^"]+)"', link, body)
    write(target, place_of(source), re.sub(r"[*`$]", "", title), body=body)


def all_figures(notebooks: dict) -> str:
    """All figures of the notebooks, by notebook, with their captions, as Markdown."""
    lines = [FIGURES]
    for path, notebook in notebooks.items():
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
    return "\n\n".join(lines)


def reference(target: Path) -> None:
    """The reference of the modules, from their docstrings."""
    for package in (rodlib, rodlib.ilc, laboratory):  # pdoc does not ask for what doors hand on
        vars(package).update({name: getattr(package, name) for name in package.__all__})
    modules = [
        name
        for _, name, _ in walk_packages(rodlib.__path__, "rodlib.")
        if hasattr(sys.modules.get(name.rpartition(".")[0]), "__all__")  # pdoc finds the others
    ]
    pdoc.pdoc("rodlib", *modules, output_directory=target)


def make_pages(root: Path, target: Path) -> None:
    """Write all pages of a repository to an empty folder."""
    notebooks = {
        f"notebooks/{path.name}": nbformat.read(path, as_version=4)
        for path in sorted((root / "notebooks").glob("*.ipynb"))
    }
    pdoc.render.configure(
        docformat="numpy", favicon="data:,", show_source=False, template_directory=TEMPLATES
    )
    colours = {
        scheme: HtmlFormatter(style=style).get_style_defs([".highlight", ".pdoc-code"])
        for scheme, style in (("light", "default"), ("dark", "github-dark"))
    }
    menu = [(place_of(path), _named(path)) for path in notebooks]
    pdoc.render.env.globals |= {"menu": menu, **colours}
    texts = {path: (root / path).read_text(encoding="utf-8") for path in TEXTS}
    texts["figures"] = all_figures(notebooks)
    for source, text in texts.items():
        document(root, target, source, text, as_html(text))
    exporter = HTMLExporter(
        template_name="basic",
        template_file="notebook.html.jinja2",  # in which folded code is a line that opens it
        extra_template_paths=[str(TEMPLATES)],
        exclude_input_prompt=True,
        exclude_output_prompt=True,
    )
    exporter.register_filter("markdown2html", as_html)
    for source, notebook in notebooks.items():
        body, _ = exporter.from_notebook_node(notebook)
        document(root, target, source, notebook.cells[0].source, body)
    rows = pd.read_csv(root / "figures" / "ledger.csv", dtype=str, keep_default_na=False)
    deviations = as_html(DEVIATIONS.read_text(encoding="utf-8"))
    form = "ledger.html.jinja2"
    write(target, "ledger.html", "The ledger", form, rows=rows, deviations=deviations)
    reference(target / "reference")


def _named(path):
    return Path(path).stem.replace("-", " ", 1)


def main(root: Path = ROOT) -> None:
    """Replace build/pages as a whole and say where the pages begin, or leave with a message."""
    try:
        build = folder(checkout("make pages", root) / "build")
        with tempfile.TemporaryDirectory(dir=build) as made:
            make_pages(root, Path(made) / "pages")
            shutil.rmtree(build / "pages", ignore_errors=True)
            shutil.move(Path(made) / "pages", build)
    except (RuntimeError, ValueError, OSError) as error:
        sys.exit(str(error))
    print(f"open {build / 'pages' / 'index.html'}")


if __name__ == "__main__":
    main()
