"""Where the repository is, and where a run saves its results."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def checkout(what: str, root: Path = ROOT) -> Path:
    """The clone that `what` writes to; a RuntimeError where `root` is not one."""
    project = root / "pyproject.toml"
    if project.is_file() and 'name = "rodlib"' in project.read_text(encoding="utf-8"):
        return root
    raise RuntimeError(
        f"{what} writes to a clone of the repository of rodlib, and {root} is none: "
        "clone it and work there"
    )


def results(what: str) -> Path:
    """Where `what` saves: in build/, or in the folder of the run that the notebook is part of."""
    build = checkout(what) / "build"
    return Path(os.environ.get("RODLIB_RESULTS") or build)
