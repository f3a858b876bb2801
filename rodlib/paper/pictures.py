"""Which figures show the same as before, but for rounding.

Processors differ in the last digits of a sum, and so do the coordinates of what is drawn. Two files
show the same if nothing has moved by more than `PRECISION`: a seventieth of the thinnest line, and
twice what was measured between processors. Of a PDF the numbers are compared, and what is no number
(a letter of a text, a pixel of an image) must be equal. Of a PNG the pixels are: an edge that moves
by a part of a pixel's side changes it by no more than that part of the way from black to white,
with `PRECISION` by 7 of 255 levels. A gray that changes by a hundredth is the same, too.
"""

import re
import zlib
from pathlib import Path

import matplotlib.image
import numpy as np

PIXELS_PER_INCH = 200  # of the PNG files
POINTS_PER_INCH = 72  # of the PDF files
PRECISION = 0.01  # points
SAME, DIFFERENT, NEW, GONE = "the same", "different", "new", "gone"


def compared(drawn: Path, before: Path) -> dict[str, str]:
    """What has become of each figure, by name, in order; the same are those with both files so."""
    new, old = _files_by_figure(drawn), _files_by_figure(before)
    found = dict.fromkeys(old, GONE)
    for name, files in new.items():
        if name not in old:
            found[name] = NEW
        else:
            found[name] = SAME if _same(files, old[name]) else DIFFERENT
    return dict(sorted(found.items()))


def _same(one, other):
    return one.keys() == other.keys() and all(
        distance(one[end], other[end]) <= PRECISION for end in one
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
        if one.read_bytes() == other.read_bytes():
            return 0.0
        return {".png": _between_pixels, ".pdf": _between_numbers}[one.suffix](one, other)
    except (OSError, SyntaxError, ValueError, KeyError, zlib.error):  # SyntaxError: pillow's
        return np.inf


def _between_pixels(one, other):
    one, other = (matplotlib.image.imread(path) for path in (one, other))  # from 0 to 1
    if one.shape != other.shape:
        return np.inf
    return float(np.abs(one - other).max()) * POINTS_PER_INCH / PIXELS_PER_INCH


def _between_numbers(one, other):
    (*one, numbers), (*other, others) = (_parts(path.read_bytes()) for path in (one, other))
    return float(np.abs(numbers - others).max()) if one == other else np.inf


def _parts(pdf):
    """The texts of a PDF, what else is no number, and the numbers, without those of its packing."""
    streams = rb">>\nstream\n(.*?)\nendstream"
    body = re.sub(streams, lambda stream: zlib.decompress(stream[1]), pdf, flags=re.DOTALL)
    lengths, places = rb"/Length \d+|(?<=obj\n)\d+(?=\nendobj)", rb"\d{10}(?= \d{5} n)"
    body = re.sub(lengths + b"|" + places + rb"|(?<=startxref\n)\d+", b"", body)
    text, number = rb"(\((?:\\.|[^\\()])*\))", rb"(?<![\w.])(-?\d+(?:\.\d+)?)"
    parts = re.split(text + b"|" + number, body, flags=re.DOTALL)
    rest = [part.replace(b"\n", b" ") for part in parts[0::3]]  # lines break where digits end
    return parts[1::3], rest, np.array([float(part or 0) for part in parts[2::3]])
