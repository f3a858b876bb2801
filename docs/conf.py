"""How ``make pages`` makes a site of notebooks, texts and docstrings, with Sphinx and MyST-NB."""

import json
import re

project = html_title = "The heated rod"

extensions = [
    "myst_nb",
    "sphinx_external_toc",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx-mathjax-offline",
]
external_toc_path = "docs/toc.yml"
include_patterns = [
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "data/README.md",
    "docs/*.md",
    "figures/*.md",
    "notebooks/*.ipynb",
    "toolbox/README.md",
]

myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # notebooks are shown as committed
nb_code_prompt_show = "Show the code"
autodoc_default_options = {"members": True, "imported-members": True}
autodoc_member_order = "bysource"
default_role = "code"  # of what stands in single backticks
suppress_warnings = ["ref.python"]  # two classes with a field of one name
html_theme = "sphinx_book_theme"
html_static_path = html_css_files = ["pages.css"]
html_copy_source = False

# The theme listens to the first button for each sidebar, which it hides, and shows another one.
MENUS = """addEventListener("DOMContentLoaded", () => {
  for (const side of ["primary", "secondary"]) {
    const [heard, ...shown] = document.querySelectorAll(`button.${side}-toggle`);
    for (const button of shown) button.addEventListener("click", () => heard.click());
  }
});"""


def fold(app, docname, source):
    """Fold what JupyterLab folds: MyST-NB knows it by a tag. Code cells get an anchor each."""
    if docname.startswith("notebooks/"):
        notebook, cells = json.loads(source[0]), []
        for cell in notebook["cells"]:
            if cell["metadata"].get("jupyter", {}).get("source_hidden"):
                cell["metadata"]["tags"] = ["hide-input"]
            if cell["cell_type"] == "code":
                anchor = f'<span id="cell-id={cell["id"]}"></span>'
                at = {"cell_type": "markdown", "id": f"at-{cell['id']}", "metadata": {}}
                cells.append(at | {"source": anchor})
            cells.append(cell)
        source[0] = json.dumps(notebook | {"cells": cells})


def lead_to_anchors(app, docname, source):
    """Links to cells, which JupyterLab follows as they are, and to rows of the ledger."""
    link = r"\[([^]]+)\]\((\S+)\.(?:ipynb(?=#cell-id=)|md(?<=/ledger.md))(#[^)]+)\)"
    source[0] = re.sub(link, r'<a href="\2.html\3">\1</a>', source[0])


def escape_bars(app, what, name, thing, options, lines):
    """|x| in a docstring is an absolute value, in reStructuredText a substitution."""
    lines[:] = [line.replace("|", r"\|") for line in lines]


def setup(app):
    """Draw formulas as SVG, since some browsers load no fonts for a page that is a file."""
    app.config.mathjax_path = "mathjax/tex-svg.js"
    app.add_js_file(None, body=MENUS)
    app.connect("source-read", fold)
    app.connect("source-read", lead_to_anchors)
    app.connect("autodoc-process-docstring", escape_bars)
