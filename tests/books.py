"""The notebooks and the ledger as they are tracked, each read once."""

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


def cells(name, kind="code"):
    """The cells of a kind of a notebook."""
    return [cell for cell in BOOKS[name].cells if cell.cell_type == kind]


def code(name):
    """The sources of its code cells."""
    return [cell.source for cell in cells(name)]


def prose(name):
    """Its text."""
    return "\n".join(cell.source for cell in cells(name, "markdown"))
