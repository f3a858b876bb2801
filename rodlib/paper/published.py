"""Every number that the paper prints, as printed, with where it stands.

The data are in data/published; a wheel has them in rodlib/paper/printed. ``claims.csv`` holds
single numbers, and statements in words with the criterion that we test them by; one file each holds
the matrices. Numbers are kept as strings, because their last digit says how precise they are.
"""

import csv
import re
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np

from rodlib.paper.repository import ROOT

INSTALLED = Path(__file__).with_name("printed")
FOLDER = INSTALLED if INSTALLED.is_dir() else ROOT / "data" / "published"
MATRICES = ("K_s", "K_L", "N", "L_diagonal", "L_full")


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
    kind: str = "number"  # or a key of ledger.KINDS, "taken over", "identity"


def number(printed: str) -> float:
    """Value of a printed number: decimal, fraction ("3/8"), power of ten ("10^-4") or "pi"."""
    if printed == "pi":
        return float(np.pi)
    if power := re.fullmatch(r"10\^(-?\d+)", printed):
        return 10.0 ** int(power[1])
    return float(Fraction(printed))


def decimals(printed: str) -> int | None:
    """Number of printed digits after the point; None for fractions, powers, pi and words."""
    return len(printed.partition(".")[2]) if re.fullmatch(r"-?\d+(\.\d+)?", printed) else None


def half_unit(printed: str) -> float:
    """Half a unit of the last printed digit; for fractions, powers and pi, rounding errors only."""
    places = decimals(printed)
    return 1e-12 * abs(number(printed)) if places is None else 0.5 * 10.0**-places


def _table(name):
    with open(FOLDER / f"{name}.csv", newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def matrix(name: str) -> np.ndarray:
    """A printed matrix, one of `MATRICES`, filters with the shape of their coefficients."""
    values = np.array([[number(entry) for entry in row[1:]] for row in _table(name)[1:]])
    if name == "K_s":
        return values.T
    if name == "L_diagonal":
        return np.stack([np.diag(row) for row in values], axis=-1)
    if name == "L_full":
        return values.T.reshape(2, 2, -1)
    return values


@cache
def claims() -> dict[str, Claim]:
    """All numbers and statements by key, in the order of the paper.

    An entry of a matrix has a key like "N[1,2]": row and column as in its file, from one.
    """
    rows = [Claim(*row) for row in _table("claims")[1:]]
    expanded = []
    for claim in rows:
        if claim.key in MATRICES:
            head, *table = _table(claim.key)
            for row in table:
                for label, printed in zip(head[1:], row[1:], strict=True):
                    entry = f"[{row[0]},{label}]"
                    name = {"key": claim.key + entry, "claim": claim.claim + entry}
                    disturbance = claim.key == "K_L" and row[0] in ("11", "12")
                    # no state coordinates
                    kind = "number" if disturbance else claim.kind
                    expanded.append(replace(claim, **name, printed=printed, kind=kind))
        elif claim.key == "invariants":
            expanded.extend(_invariants(claim.place))
        else:
            expanded.append(claim)
    return {claim.key: claim for claim in expanded}


def _invariants(place):
    """Products of K_s and K_L that no orthogonal change of state coordinates alters."""
    Ks, KL1 = matrix("K_s"), matrix("K_L")[:10].T
    rounding = half_unit("0.0001")
    for label, X, Y in (("K_s K_s'", Ks, Ks), ("K_L1' K_L1", KL1, KL1), ("K_s K_L1", Ks, KL1)):
        for i in range(2):
            for j in range(i if X is Y else 0, 2):
                value = X[i] @ Y[j]
                # what the rounding of the printed entries can add up to
                tolerance = rounding * (np.abs(X[i]).sum() + np.abs(Y[j]).sum() + 10 * rounding)
                yield Claim(
                    f"{label}[{i + 1},{j + 1}]",
                    place,
                    f"{label}, entry [{i + 1},{j + 1}], from the printed gains",
                    f"{value:.5f}",
                    criterion=f"{value:.8f} +- {tolerance:.8f}",
                    note="independent of the state coordinates; tolerance from the printed digits",
                )
