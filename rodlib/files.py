"""Where the repository is, and how it is written to: as a whole or not at all, by one at a time.

Only the standard library, because `environment.py` needs this before anything is installed.
"""

import json
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # on Windows
    import msvcrt

    fcntl = None

ROOT = Path(__file__).resolve().parents[1]
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


def folder(path: Path) -> Path:
    """Make a folder, unless it or a link to one is there.

    Raises
    ------
    NotADirectoryError
        If a file is in the way.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        ways = (path, *path.parents)
        file = next(way for way in ways if os.path.lexists(way) and not way.is_dir())
        raise NotADirectoryError(f"{file} must be a folder: remove what is there") from None
    return path


@contextmanager
def alone(lock: Path, refusal: str, wait: bool = False) -> Iterator[None]:
    """Keep other processes from doing the same.

    Parameters
    ----------
    lock : Path
        A file in a folder that exists. The file stays, the lock ends with the process.
    refusal : str
        What to say to the second.
    wait : bool
        Let the second wait instead.

    Raises
    ------
    RuntimeError
        If another process is at it.
    """
    with open(lock, "a", encoding="utf-8") as file:
        try:
            if fcntl:
                fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            else:
                msvcrt.locking(file.fileno(), msvcrt.LK_LOCK if wait else msvcrt.LK_NBLCK, 1)
        except OSError:
            raise RuntimeError(refusal) from None
        yield


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A file to write instead of `path`, which it replaces if nothing goes wrong.

    Parameters
    ----------
    path : Path
        In a folder that exists.

    Yields
    ------
    Path
        Beside `path`; removed in case of an error.

    Raises
    ------
    FileExistsError
        If `path` is there and no regular file: a device is not written to by replacing it.
    """
    if path.exists() and not path.is_file():
        raise FileExistsError(f"{path} is no regular file: choose another name")
    temporary = _part(path)
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Replace a text file, UTF-8 with line feeds, as a whole or not at all."""
    write_pieces(path, [text.encode()])


def write_pieces(path: Path, pieces: Iterable[bytes]) -> None:
    """Replace a file, as a whole or not at all, by pieces that need not fit into memory at once."""
    with replacing(path) as temporary:
        _write(temporary, pieces)


def append_whole(path: Path, content: bytes) -> None:
    """Append to a file, all or nothing, unless the process is killed in the midst of it."""
    rest = memoryview(content)
    with open(path, "r+b", buffering=0) as file:
        end = file.seek(0, os.SEEK_END)
        try:
            while len(rest):
                rest = rest[file.write(rest) :]
            os.fsync(file.fileno())
        except BaseException:
            file.truncate(end)
            raise


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


def _part(path):
    return path.with_name(f".{path.name}.part")


def _write(path, pieces):
    with open(path, "wb") as file:
        file.writelines(pieces)
        file.flush()
        os.fsync(file.fileno())  # a full disk may show here only
