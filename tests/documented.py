"""What is documented: the doors of both packages, and the examples of README and guide."""

import re

import ilctools
import rodlib
from rodlib.paper.repository import ROOT

OTHERS = {"MISMATCHED", "errors"}  # a rod, and a room
DOORS = sorted({*ilctools.__all__, *rodlib.__all__} - OTHERS)
BLOCK = re.compile(r"^```python\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)


def door(name):
    """By its name, which is in one of the two packages."""
    return getattr(ilctools if name in ilctools.__all__ else rodlib, name)


def examples(path):
    """The Python of a document, in a list."""
    return BLOCK.findall((ROOT / path).read_text("utf-8"))
