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
SAME, DIFFERENT, NEW, GONE = "the same", "different", "new", "gone"


def compared(drawn: Path, before: Path) -> dict[str, str]:
    """What has become of each figure of the notebooks, by name, in order."""
    new, old = pictures(drawn), pictures(before)
    changes = dict.fromkeys(old, GONE) | dict.fromkeys(new, NEW)
    for name in new.keys() & old.keys():
        changes[name] = SAME if same(new[name], old[name]) else DIFFERENT
    return dict(sorted(changes.items()))


def pictures(folder: Path) -> dict[str, Path]:
    """The PNG files of figures of the notebooks, by name."""
    paths = [*folder.glob("fig*.png"), *folder.glob("extra*.png")]
    return {path.stem: path for path in paths}


def same(one: Path, other: Path) -> bool:
    """Whether two PNG files show the same; one that cannot be read does not."""
    try:
        one, other = imread(one), imread(other)  # from 0 to 1
    except (OSError, SyntaxError, ValueError):  # SyntaxError: pillow's
        return False
    if one.shape != other.shape:
        return False
    return bool(np.abs(one - other).max() < (LEVELS + 0.5) / 255)
