"""Warnings that name the line which called the toolbox, not a line inside the toolbox."""

import sys
import warnings


def warn(text: str) -> None:
    """Warn at the line that called the toolbox."""
    frame, level = sys._getframe(), 1
    while frame.f_back and frame.f_globals.get("__name__", "").startswith("ilctools."):
        frame, level = frame.f_back, level + 1
    warnings.warn(text, stacklevel=level)
