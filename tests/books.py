"""The notebooks, the ledger and the texts as they are tracked; the first two are read once."""

import nbformat
import pandas as pd

from rodlib.paper.repository import ROOT

# how a notebook saves a figure
SAVED = r'\bsave\(\w+, "([^"]+)", caption\)'
BOOKS = {
    path.stem: nbformat.read(path, as_version=4)
    for path in sorted((ROOT / "notebooks").glob("*.ipynb"))
}
ROWS = pd.read_csv(ROOT / "figures" / "ledger.csv", dtype=str, keep_default_na=False)


def text(path):
    """What a file of the repository contains."""
    return (ROOT / path).read_text(encoding="utf-8")


def cells(name, kind="code"):
    """The cells of a kind of a notebook."""
    return [cell for cell in BOOKS[name].cells if cell.cell_type == kind]


def code(name):
    """The sources of its code cells."""
    return [cell.source for cell in cells(name)]


def prose(name):
    """Its text."""
    return "\n".join(cell.source for cell in cells(name, "markdown"))
