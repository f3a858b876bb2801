"""Compare texts and pictures: they count as the same if a reader cannot distinguish them.

Processors differ in the last digits of a sum. However many processors are tried, the next one may
differ. A printed number may therefore differ by one unit of its last digit, such as 0.8833 and
0.8834. A whole number above a thousand counts steps or samples, and may differ by a thousandth.

In a picture, an edge may be displaced by a part of a pixel. Each pixel must lie between the darkest
and the lightest of the nine pixels around its place in the other picture, and the other way round.
Specks are exempt.

The PDF of a figure is drawn at the same time as its PNG, with the same content, but has other bytes
on another machine. A PDF counts as the same if its end is present.
"""

import re
from decimal import Decimal
from pathlib import Path

import numpy as np
from matplotlib.image import imread
from scipy.ndimage import maximum_filter, minimum_filter

NUMBER = re.compile(r"((?<![\w.])[-+−]?(?:\d{1,3}(?:,\d{3})+|\d+)(?:\.\d+)?(?:[eE][-+]?\d+)?)")
LARGE = 1000  # above, a whole number may differ by a thousandth
PIXELS_PER_INCH = 200  # of the PNG files: the thinnest lines are two pixels wide
LEVELS = 16  # of 255: a difference that nobody sees on a screen
SPECK = 64  # of 255: a difference that nobody sees in single pixels, as where lines cross,
SPECKS = 1e-5  # if this share of a picture has it: nine pixels of a figure, less than a dot


def same_text(one: str, other: str) -> bool:
    """Return whether two texts differ at most in last digits and in spaces for alignment."""
    ours, theirs = (NUMBER.split(re.sub(r"[ \t]+", " ", text)) for text in (one, other))
    numbers = zip(ours[1::2], theirs[1::2], strict=False)
    return ours[::2] == theirs[::2] and all(same_number(*pair) for pair in numbers)


def same_number(one: str, other: str) -> bool:
    """Return whether two printed numbers differ by at most one unit of the last digit."""
    a, b = (Decimal(text.replace(",", "").replace("−", "-")) for text in (one, other))
    # zeros at the end may be left out: 0.1 is next to 0.099
    unit = Decimal(1).scaleb(min(a.as_tuple().exponent, b.as_tuple().exponent))
    if not re.search("[.eE]", one + other):  # whole numbers
        unit = abs(a) // LARGE
    return abs(a - b) <= unit


def different_figures(drawn: Path, before: Path) -> list[str]:
    """Return the names of the figures that looked different before, or did not exist."""
    pairs = [(path, before / path.name) for path in sorted(drawn.glob("*.png"))]
    return [path.stem for path, tracked in pairs if not same_figure(path, tracked)]


def same_figure(drawn: Path, tracked: Path) -> bool:
    """Return whether two PNG files show the same picture, and the tracked PDF is complete."""
    pdf = tracked.with_suffix(".pdf")
    ends = pdf.is_file() and pdf.read_bytes().rstrip().endswith(b"%%EOF")
    return ends and same_picture(drawn, tracked)


def same_picture(one: Path, other: Path) -> bool:
    """Return whether two PNG files show the same picture.

    Two files with the same bytes do. If one of two different files cannot be read, return False.
    """
    try:
        if one.read_bytes() == other.read_bytes():  # the usual case, without decoding
            return True
        one, other = imread(one), imread(other)  # from 0 to 1
    except (OSError, SyntaxError, ValueError):  # SyntaxError: pillow's
        return False
    return one.shape == other.shape and _within(one, other) and _within(other, one)


def _within(one, other):
    """Whether each pixel lies within the range of the pixels around it in the other picture."""
    low, high = (extreme(other, (3, 3, 1)) for extreme in (minimum_filter, maximum_filter))
    beyond = 255 * np.maximum(low - one, one - high).max(axis=2)
    specks = np.mean(beyond > LEVELS + 0.5)
    return bool(specks <= SPECKS and np.all(beyond <= SPECK + 0.5))
