"""Where the repository is, and how several of its files are replaced at once."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rodlib.ilc.files import _part, _write, alone, folder, write_whole

ROOT = Path(__file__).resolve().parents[2]
JOURNAL = ".publishing"


def checkout(what: str, root: Path = ROOT) -> Path:
    """The repository that `what` is about to write to.

    Raises
    ------
    RuntimeError
        If `root` is something else: the site-packages of an installed rodlib, say.
    """
    project = root / "pyproject.toml"
    if not (project.is_file() and 'name = "rodlib"' in project.read_text(encoding="utf-8")):
        raise RuntimeError(
            f"{what} writes to a clone of the repository of rodlib, and {root} is none: "
            "clone it and work there"
        )
    return root


def results(what: str) -> Path:
    """Where `what` saves: in build/, or in the folder of the run that the notebook is part of.

    Raises
    ------
    RuntimeError
        Outside a clone of the repository.
    """
    build = checkout(what) / "build"
    return Path(os.environ.get("RODLIB_RESULTS") or build)


@contextmanager
def publishing(root: Path) -> Iterator[dict[str, bytes | None]]:
    """Replace several files of the repository: all of them or none, whenever it ends.

    The new files are written beside the old ones before the first is replaced. A journal says
    which they are and whether all are there; with it, the next call finishes what a killed
    process has begun to replace, and removes what it had only begun to write.

    Parameters
    ----------
    root : Path

    Yields
    ------
    dict
        To be filled: new content by name relative to `root`, None for a file that goes.

    Raises
    ------
    RuntimeError
        Outside a clone, or if a file cannot be replaced after others have been.
    """
    checkout("publishing", root)
    with alone(folder(root / "build") / "publishing.lock", "another process publishes", wait=True):
        finish_publishing(root)
        new = {}
        yield new
        journal = {"complete": False, "kept": {name: new[name] is not None for name in new}}
        try:
            write_whole(root / JOURNAL, json.dumps(journal))
            for name, content in new.items():
                if content is not None:
                    _write(_part(folder((root / name).parent) / Path(name).name), [content])
            write_whole(root / JOURNAL, json.dumps(journal | {"complete": True}))
        except BaseException:
            finish_publishing(root)
            raise
        try:
            finish_publishing(root)
        except OSError as error:
            raise RuntimeError(
                f"published in part, for {error}. Mend that; the next `make reproduce` begins "
                "with the rest"
            ) from error


def finish_publishing(root: Path) -> bool:
    """Bring figures/ and README to one state after a killed process; True if it is the new one."""
    journal = root / JOURNAL
    _part(journal).unlink(missing_ok=True)
    if not journal.exists():
        return False
    state = json.loads(journal.read_text(encoding="utf-8"))
    for name, kept in state["kept"].items():
        path = root / name
        if not state["complete"]:
            _part(path).unlink(missing_ok=True)
        elif not kept:
            path.unlink(missing_ok=True)
        elif _part(path).exists():  # or else it has been replaced before
            os.replace(_part(path), path)
    journal.unlink()
    return state["complete"]
