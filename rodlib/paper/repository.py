"""Where the repository is, and where a run saves its results."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def checkout(what: str, root: Path = ROOT) -> Path:
    """Return the clone that `what` writes to.

    If `root` is not a clone of the repository, a RuntimeError is raised.
    """
    project = root / "pyproject.toml"
    if project.is_file() and 'name = "rodlib"' in project.read_text(encoding="utf-8"):
        return root
    raise RuntimeError(
        f"{what} writes to a clone of the repository of rodlib, but {root} is not such a "
        "clone: clone the repository and work there"
    )


def results(what: str) -> Path:
    """Return the folder in which `what` saves: build/, or the folder of the notebook's run."""
    build = checkout(what) / "build"
    return Path(os.environ.get("RODLIB_RESULTS") or build)
