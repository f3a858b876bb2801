"""Which figures show the same as before, but for rounding.

Processors differ in the last digits of a sum, and so do the coordinates of what is drawn. Two PNG
files show the same if nothing has moved by more than `PRECISION`: a seventieth of the thinnest
line, and twice what was measured between processors. An edge that moves by a part of a pixel's side
changes it by no more than that part of the way from black to white, with `PRECISION` by 7 of 255
levels. A gray that changes by a hundredth is the same, too. A PDF is drawn from the same figure.
"""

from pathlib import Path

import matplotlib.image
import numpy as np

PIXELS_PER_INCH = 200  # of the PNG files
POINTS_PER_INCH = 72
PRECISION = 0.01  # points
SAME, DIFFERENT, NEW, GONE = "the same", "different", "new", "gone"


def compared(drawn: Path, before: Path) -> dict[str, str]:
    """What has become of each figure, by name, in order; each has a PNG and a PDF file."""
    new, old = _files_by_figure(drawn), _files_by_figure(before)
    found = dict.fromkeys(old, GONE)
    for name, files in new.items():
        if name not in old:
            found[name] = NEW
        else:
            found[name] = SAME if _same(files, old[name]) else DIFFERENT
    return dict(sorted(found.items()))


def _same(one, other):
    return (
        one.keys() == other.keys() and distance(one[".png"], other[".png"]) <= PRECISION
    )


def _files_by_figure(folder: Path) -> dict[str, dict[str, Path]]:
    """The files of each figure of the notebooks, by their endings."""
    found = {}
    for path in [*folder.glob("fig*"), *folder.glob("extra*")]:
        found.setdefault(path.stem, {})[path.suffix] = path
    return found


def distance(one: Path, other: Path) -> float:
    """How far things have moved, in points, at most; inf if there is another difference."""
    try:
        one, other = (
            matplotlib.image.imread(path) for path in (one, other)
        )  # from 0 to 1
    except (OSError, SyntaxError, ValueError):  # SyntaxError: pillow's
        return np.inf
    if one.shape != other.shape:
        return np.inf
    return float(np.abs(one - other).max()) * POINTS_PER_INCH / PIXELS_PER_INCH
