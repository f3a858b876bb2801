"""What is documented: the doors of both packages, and the examples of README and guide."""

import re

from books import text

import ilctools
import rodlib

OTHERS = {"MISMATCHED", "errors"}  # a rod, and a room
DOORS = sorted({*ilctools.__all__, *rodlib.__all__} - OTHERS)
BLOCK = re.compile(r"^```python\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)


def door(name):
    """By its name, which is in one of the two packages."""
    return getattr(ilctools if name in ilctools.__all__ else rodlib, name)


def examples(path):
    """The Python of a document, in a list."""
    return BLOCK.findall(text(path))
