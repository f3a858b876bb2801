"""How ``make pages`` makes a site of notebooks, texts and docstrings, with Sphinx and MyST-NB."""

import json
import re
from contextlib import chdir
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg

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
# where no texts are searched for
exclude_patterns = [".*", "build", "rodlib", "tests", "toolbox/ilctools", "toolbox/tests"]

myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # notebooks are shown as committed
nb_code_prompt_show = "Show the code"
autodoc_default_options = {"members": True, "imported-members": True}
autodoc_member_order = "bysource"
default_role = "code"  # of what stands in single backticks
suppress_warnings = ["ref.python"]  # two classes with a field of one name
html_theme = "sphinx_book_theme"
html_theme_options = {"navbar_persistent": []}  # the field to search is in the sidebar
html_css_files, html_js_files = ["pages.css"], ["tables.js", "trials.js"]
html_static_path = html_css_files + html_js_files
html_copy_source = False


def fold(app, docname, source):
    """Fold what JupyterLab folds: MyST-NB knows it by a tag. Code cells get an anchor each.

    Pictures get their captions as alternative texts, which MyST-NB reads of the cell alone.
    """
    if docname.startswith("notebooks/"):
        notebook, cells = json.loads(source[0]), []
        for cell in notebook["cells"]:
            if cell["metadata"].get("jupyter", {}).get("source_hidden"):
                cell["metadata"]["tags"] = ["hide-input"]
            for output in cell.get("outputs", []):
                if alt := output.get("metadata", {}).get("image/png", {}).get("alt"):
                    cell["metadata"]["mystnb"] = {"image": {"alt": alt}}
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


def draw_trials(app, exception):
    """Frames for the slider of docs/trials.js: Fig. 9 as notebook 5 draws it, trial by trial."""
    if exception or app.builder.name != "html":
        return
    book = json.loads(Path(app.srcdir, "notebooks/05-experiment-replay.ipynb").read_text("utf-8"))
    cells = ["".join(cell["source"]) for cell in book["cells"] if cell["cell_type"] == "code"]
    (drawn,) = (k for k, source in enumerate(cells) if '"fig09-recorded-signals"' in source)
    names = {"print": lambda *text: None}
    with chdir(Path(app.srcdir, "notebooks")):
        for source in cells[:drawn]:
            exec(source, names)  # the notebook's own
        names["save"] = lambda *arguments: None  # which would close it
        exec(cells[drawn], names)
    figure, trials = names["figure"], len(names["numbers"])
    figure.set_dpi(144)
    figure.get_layout_engine().execute(figure)
    figure.set_layout_engine("none")  # the same in all frames, computed once
    canvas, static = FigureCanvasAgg(figure), Path(app.outdir, "_static")
    for trial in range(trials):
        for column in figure.axes:
            for k, line in enumerate(column.lines, trials - len(column.lines)):
                line.set(color="black" if k == trial else "0.88", zorder=3 if k == trial else 2)
        canvas.print_png(static / f"fig09-trial-{trial + 1}.png")


def setup(app):
    """Draw formulas as SVG, since some browsers load no fonts for a page that is a file."""
    app.config.mathjax_path = "mathjax/tex-svg.js"
    app.connect("source-read", fold)
    app.connect("source-read", lead_to_anchors)
    app.connect("autodoc-process-docstring", escape_bars)
    app.connect("build-finished", draw_trials)
