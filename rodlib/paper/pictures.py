"""Which figures show the same as before, but for rounding.

Processors differ in the last digits of a sum, and so do the coordinates of what is drawn. An edge
that moves by a part of a pixel's side changes the pixel by no more than that part of the way from
black to white. At 200 pixels per inch, 7 of 255 levels are 0.01 pt: a seventieth of the thinnest
line, and twice what was measured between processors. A PDF is drawn from the same figure.
"""

from pathlib import Path

import numpy as np
from matplotlib.image import imread

PIXELS_PER_INCH = 200  # of the PNG files
LEVELS = 7  # of 255, by which a pixel may differ


def compared(drawn: Path, before: Path) -> dict[str, bool]:
    """Whether each figure of the notebooks is the same, by name; one that is new or gone is not."""
    folders = drawn, before
    paths = [path for folder in folders for path in folder.glob("*.png")]
    names = sorted({p.stem for p in paths if p.stem.startswith(("fig", "extra"))})
    return {
        name: same(*(folder / f"{name}.png" for folder in folders)) for name in names
    }


def same(one: Path, other: Path) -> bool:
    """Whether two PNG files show the same; one that cannot be read does not."""
    try:
        one, other = imread(one), imread(other)  # from 0 to 1
    except (OSError, SyntaxError, ValueError):  # SyntaxError: pillow's
        return False
    if one.shape != other.shape:
        return False
    return bool(np.abs(one - other).max() < (LEVELS + 0.5) / 255)
