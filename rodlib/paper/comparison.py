"""What counts as the same, of texts and of pictures: what a reader cannot distinguish.

Processors differ in the last digits of a sum, and no number of them tried proves that the next one
does not. So a printed number may differ by one unit of its last digit, whether it is rounded to
0.8833 or 0.8834, and a whole number above a thousand, which counts steps or samples, by a
thousandth. In a picture an edge may move by a part of a pixel: each pixel must lie between the
darkest and the lightest of the nine around its place in the other picture, and the other way round,
but for specks.

The PDF of a figure has the same content as its PNG, drawn at the same time, but other bytes on
another machine. It counts as the same if it has its end.
"""

import re
from decimal import Decimal
from pathlib import Path

import numpy as np
from matplotlib.image import imread
from scipy.ndimage import maximum_filter, minimum_filter

NUMBER = re.compile(r"((?<![\w.])[-+−]?(?:\d{1,3}(?:,\d{3})+|\d+)(?:\.\d+)?(?:[eE][-+]?\d+)?)")
LARGE = 1000  # from here on a whole number may be off by a thousandth
PIXELS_PER_INCH = 200  # of the PNG files: the thinnest lines are two pixels wide
LEVELS = 16  # of 255, which on a screen nobody sees
SPECK = 64  # of 255, which nobody sees of single pixels, as where lines cross,
SPECKS = 1e-5  # if so small a share of a picture has them: nine pixels of a figure, less than a dot


def same_text(one: str, other: str) -> bool:
    """Whether two texts differ in the last digits of numbers at most, and in spaces that align."""
    ours, theirs = (NUMBER.split(re.sub(r"[ \t]+", " ", text)) for text in (one, other))
    numbers = zip(ours[1::2], theirs[1::2], strict=False)
    return ours[::2] == theirs[::2] and all(same_number(*pair) for pair in numbers)


def same_number(one: str, other: str) -> bool:
    """Whether two printed numbers are one unit of the last digit apart at most."""
    a, b = (Decimal(text.replace(",", "").replace("−", "-")) for text in (one, other))
    # where zeros at the end are left out, 0.1 is next to 0.099
    unit = Decimal(1).scaleb(min(a.as_tuple().exponent, b.as_tuple().exponent))
    if not re.search("[.eE]", one + other):  # whole numbers
        unit = abs(a) // LARGE
    return abs(a - b) <= unit


def different_figures(drawn: Path, before: Path) -> list[str]:
    """Names of the figures that were not drawn alike before, or not at all."""
    pairs = [(path, before / path.name) for path in sorted(drawn.glob("*.png"))]
    return [path.stem for path, tracked in pairs if not same_figure(path, tracked)]


def same_figure(drawn: Path, tracked: Path) -> bool:
    """Whether a PNG file shows what a tracked one shows, and the PDF beside that has its end."""
    pdf = tracked.with_suffix(".pdf")
    ends = pdf.is_file() and pdf.read_bytes().rstrip().endswith(b"%%EOF")
    return ends and same_picture(drawn, tracked)


def same_picture(one: Path, other: Path) -> bool:
    """Whether two PNG files show the same; one that is missing or cannot be read does not."""
    try:
        one, other = imread(one), imread(other)  # from 0 to 1
    except (OSError, SyntaxError, ValueError):  # SyntaxError: pillow's
        return False
    return one.shape == other.shape and (
        np.array_equal(one, other) or (_within(one, other) and _within(other, one))
    )


def _within(one, other):
    """Whether each pixel lies between those around its place in the other picture."""
    low, high = (extreme(other, (3, 3, 1)) for extreme in (minimum_filter, maximum_filter))
    beyond = 255 * np.maximum(low - one, one - high).max(axis=2)
    specks = np.mean(beyond > LEVELS + 0.5)
    return bool(specks <= SPECKS and np.all(beyond <= SPECK + 0.5))
