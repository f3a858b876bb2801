"""Where the repository is, and how several of its files are replaced at once."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rodlib.ilc.files import alone, folder, replace_all

ROOT = Path(__file__).resolve().parents[2]


def checkout(what: str, root: Path = ROOT) -> Path:
    """The repository that `what` is about to write to; site-packages, say, are none."""
    project = root / "pyproject.toml"
    if not (
        project.is_file() and 'name = "rodlib"' in project.read_text(encoding="utf-8")
    ):
        raise RuntimeError(
            f"{what} writes to a clone of the repository of rodlib, and {root} is none: "
            "clone it and work there"
        )
    return root


def results(what: str) -> Path:
    """Where `what` saves: in build/, or in the folder of the run that the notebook is part of."""
    build = checkout(what) / "build"
    return Path(os.environ.get("RODLIB_RESULTS") or build)


@contextmanager
def publishing(root: Path) -> Iterator[dict[str, bytes | None]]:
    """Replace several files of the repository, given by name; None removes one."""
    checkout("publishing", root)
    with alone(
        folder(root / "build") / "publishing.lock",
        "another process publishes",
        wait=True,
    ):
        new = {}
        yield new
        # The README last: after a kill it is the old one, and the next run, or git, mends the rest.
        names = sorted(new, key=lambda name: name == "README.md")
        replace_all({root / name: new[name] for name in names})
