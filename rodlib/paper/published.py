"""Every number that the paper prints, as printed, with its place in the paper.

The data are in data/published. A wheel has them in rodlib/paper/printed. ``claims.csv`` contains
single numbers, and statements in words with the criterion by which we test them. Each matrix has
its own file. Numbers are kept as strings, because their last digit shows how precise they are.
"""

import re
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from rodlib.paper.repository import ROOT

INSTALLED = Path(__file__).with_name("printed")
FOLDER = INSTALLED if INSTALLED.is_dir() else ROOT / "data" / "published"
PRINTED_MATRICES = ("K_s", "K_L", "N", "L_diagonal", "L_full")


@dataclass(frozen=True)
class Claim:
    """A number or a statement of the paper."""

    key: str
    place: str  # section, equation or figure of the paper
    claim: str  # in our words
    printed: str  # as printed
    unit: str = ""
    criterion: str = ""  # for statements: what the computed number must fulfil
    note: str = ""
    kind: str = "printed"  # or another key of ledger.KINDS


def value(printed: str) -> float:
    """Return the value of a printed decimal, fraction ("3/8"), power of ten ("10^-4") or "pi"."""
    if printed == "pi":
        return float(np.pi)
    if power := re.fullmatch(r"10\^(-?\d+)", printed):
        return 10.0 ** int(power[1])
    return float(Fraction(printed))


def decimals(printed: str) -> int | None:
    """Count the printed digits after the point.

    For fractions, powers, pi and words, return None.
    """
    return len(printed.partition(".")[2]) if re.fullmatch(r"-?\d+(\.\d+)?", printed) else None


def half_unit(printed: str) -> float:
    """Return half a unit of the last printed digit.

    For fractions, powers and pi, return a tolerance for rounding errors instead.
    """
    places = decimals(printed)
    return 1e-12 * abs(value(printed)) if places is None else 0.5 * 10.0**-places


def _table(name):
    return pd.read_csv(FOLDER / f"{name}.csv", index_col=0, dtype=str, keep_default_na=False)


def matrix(name: str) -> np.ndarray:
    """Return the printed matrix that has this name in `PRINTED_MATRICES`.

    For a filter, the result is the array of its coefficients, (2, 2, coefficients).
    """
    return _arranged(name, _table(name).map(value).to_numpy())


def keys(name: str) -> np.ndarray:
    """Return the key of the claim for each entry of a matrix.

    If an entry is zero because of the structure of the matrix, its key is "".
    """
    table = _table(name)
    entries = [[f"{name}[{row},{column}]" for column in table] for row in table.index]
    return _arranged(name, np.array(entries))


def _arranged(name, table):
    """Arrange the entries of a file's table in the shape of the matrix."""
    if name == "K_s":
        return table.T
    if name == "L_diagonal":
        return np.stack([np.diag(row) for row in table], axis=-1)
    if name == "L_full":
        return table.T.reshape(2, 2, -1)
    return table


@cache
def claims() -> dict[str, Claim]:
    """Return all numbers and statements by key, in the order of the paper.

    An entry of a matrix has a key like "N[1,2]": row and column as in its file, counted from one.
    """
    expanded = []
    for claim in (Claim(*row) for row in _table("claims").itertuples()):
        expanded.extend(_entries(claim) if claim.key in PRINTED_MATRICES else [claim])
    return {claim.key: claim for claim in expanded}


def _entries(claim):
    """Yield the claims of a matrix, one for each entry."""
    for (row, column), printed in _table(claim.key).stack().items():
        entry = f"[{row},{column}]"
        # The observer's last two rows belong to the disturbance, in any coordinates of the state.
        kind = "printed" if claim.key == "K_L" and row in ("11", "12") else claim.kind
        name = {"key": claim.key + entry, "claim": claim.claim + entry}
        yield replace(claim, **name, printed=printed, kind=kind)
