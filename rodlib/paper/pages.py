"""The compendium as pages to read without installing anything: what ``make pages`` runs.

nbconvert makes HTML of notebooks and Markdown, pdoc of docstrings, and the frame of pdoc is around
all of it. The pages, in build/pages, need no network, and no script but to search and to filter.
"""

import posixpath
import re
import shutil
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules, walk_packages
from xml.etree import ElementTree

import nbformat
import pdoc
import ziamath
from nbconvert import HTMLExporter
from nbconvert.filters.markdown_mistune import IPythonRenderer, MarkdownWithMath

import rodlib
from rodlib.ilc.files import folder
from rodlib.paper.ledger import VERDICTS
from rodlib.paper.repository import ROOT, checkout

TEXTS = ("README.md", "CONTRIBUTING.md", "data/README.md")
TEXTS += ("figures/ledger.md", "figures/performance.md")
TEMPLATES = Path(__file__).with_name(
    "templates"
)  # which go before those of pdoc and nbconvert
SIZE = 16  # pixels at which formulas are drawn; on the page they are as large as the text around
ziamath.config.svg2 = (
    False  # glyphs as paths, since two drawings on a page must not share names
)


def page_of(path: str) -> str:
    """Where the pages show a text, a notebook, a module or a folder of the repository."""
    return re.sub(r"\.(ipynb|md|py)$|$", ".html", path, count=1)


def formula(tex: str, inline: bool = True) -> str:
    """Draw LaTeX as an SVG element, to stand on the line of the text; its words are the LaTeX."""
    try:
        drawn = ziamath.Latex(
            tex.strip(), size=SIZE, color="currentColor", inline=inline
        ).svgxml()
    except Exception as error:  # of many kinds
        raise ValueError(f"the formula {tex!r} cannot be drawn: {error}") from error
    _, top, width, height = (
        float(number) / SIZE for number in drawn.attrib["viewBox"].split()
    )
    drawn.attrib |= {"width": f"{width:.4f}em", "height": f"{height:.4f}em"}
    drawn.attrib |= {
        "class": "math",
        "role": "img",
        "aria-label": " ".join(tex.split()),
    }
    drawn.set("style", f"vertical-align:{-(top + height):.4f}em")
    return ElementTree.tostring(drawn, encoding="unicode")


class Renderer(IPythonRenderer):
    """Markdown as nbconvert makes HTML of it, with drawn formulas, in headings, too."""

    def heading(self, text, level, **attrs):
        words = re.sub(
            r'<svg.*?aria-label="(.*?)".*?</svg>|<[^>]+>', r"\1", text, flags=re.DOTALL
        )
        name = re.sub(r"\W+", "-", words).strip("-").lower()
        return f'<h{level} id="{name}">{text}</h{level}>\n'

    def inline_math(self, body):
        return formula(body)

    def block_math(self, body):
        return f'<div class="display">{formula(body, inline=False)}</div>'


as_html = MarkdownWithMath(renderer=Renderer(escape=False)).render


def document(root: Path, target: Path, source: str, text: str, body: str) -> None:
    """A page from a document whose Markdown begins with a title, and whose HTML is `body`."""

    def linked(
        found,
    ):  # as in the repository, but to a page if there is one; or else to a copy
        attribute, url, anchor = found.groups()
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), url))
        if not (root / path).exists():
            raise ValueError(f"{source} links to {path}, which is not there")
        if (root / path).is_dir() or path.endswith((".ipynb", ".md", ".py")):
            url = page_of(url)
        else:
            shutil.copyfile(
                root / path, folder((target / path).parent) / Path(path).name
            )
        return f'{attribute}="{url}{anchor}"'

    page, title = page_of(source), re.search(r"^# (.*)", text, re.MULTILINE)[1]
    body = re.sub(r'\b(href|src)="(?![a-z]+:)([^"#]+)([^"]*)"', linked, body)
    up = "../" * page.count("/")
    body = re.sub(
        r">(\d\d-[^\s<]+)</td>", rf'><a href="{up}notebooks/\1.html">\1</a></td>', body
    )
    template = pdoc.render.env.get_template("page.html.jinja2")
    text = template.render(
        title=re.sub(r"[*`$]", "", title), page=page, up=up, body=body
    )
    (folder((target / page).parent) / Path(page).name).write_text(
        text, encoding="utf-8"
    )


def all_figures(notebooks: dict) -> str:
    """All figures of the notebooks, by notebook, with their captions, as Markdown."""
    lines = ["# Figures"]
    for path, notebook in notebooks.items():
        lines.append(f"## [{Path(path).stem}]({path})")
        for output in [
            output for cell in notebook.cells for output in cell.get("outputs", [])
        ]:
            if "image/png" in output.get("data", {}):
                name, caption = (
                    output.data["text/plain"],
                    output.metadata["image/png"]["alt"],
                )
                lines += [f"![{caption}]({name})", f"**{Path(name).stem}.** {caption}"]
    return "\n\n".join(lines)


def make_pages(root: Path, target: Path) -> None:
    """Write all pages of a repository to an empty folder."""
    notebooks = {
        f"notebooks/{path.name}": nbformat.read(path, as_version=4)
        for path in sorted((root / "notebooks").glob("*.ipynb"))
    }
    pdoc.render.configure(
        docformat="numpy", show_source=False, template_directory=TEMPLATES
    )
    packages = [
        name
        for _, name, package in walk_packages(rodlib.__path__, "rodlib.")
        if package
    ]
    for package in map(import_module, ["rodlib", *packages]):
        # pdoc asks neither for what doors hand on, nor for the modules behind doors
        names = getattr(package, "__all__", [])
        vars(package).update({name: getattr(package, name) for name in names})
        package.__all__ = [
            *names,
            *(module.name for module in iter_modules(package.__path__)),
        ]
    pdoc.pdoc("rodlib", output_directory=target)
    menu = [page_of(path) for path in (*TEXTS, "figures", "rodlib", *notebooks)]
    pdoc.render.env.globals |= {"menu": menu, "verdicts": VERDICTS}
    texts = {path: (root / path).read_text(encoding="utf-8") for path in TEXTS}
    for source, text in (texts | {"figures": all_figures(notebooks)}).items():
        document(root, target, source, text, as_html(text))
    exporter = HTMLExporter(  # in which folded code is a line that opens it
        template_file="notebook.html.jinja2", extra_template_paths=[str(TEMPLATES)]
    )
    exporter.register_filter("markdown2html", as_html)
    for source, notebook in notebooks.items():
        body, _ = exporter.from_notebook_node(notebook)
        body = body.replace(
            'class="highlight ', 'class="highlight pdoc-code '
        )  # with its colours
        document(root, target, source, notebook.cells[0].source, body)
    shutil.copyfile(target / "README.html", target / "index.html")


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
