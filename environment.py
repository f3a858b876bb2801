"""Create .venv from environment.lock, unless it is there, up to date, and this folder's own.

`make` calls this first. It needs nothing but Python; the environment is complete when bin/ready is
in it.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent
PIP = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check")


def packages(root: Path) -> list[Path]:
    """The folders of the two packages that are installed from the checkout."""
    return [root, root / "toolbox"]


def is_ready(root: Path) -> bool:
    """Whether the environment in `root` is complete, newer than the lock, and runs what is here.

    An environment carries the absolute path of its folder: in a copy of the folder, it would go on
    to run the packages of the original.
    """
    ready = root / ".venv" / "bin" / "ready"
    sources = [root / "environment.lock", *(folder / "pyproject.toml" for folder in packages(root))]
    if not ready.exists() or ready.stat().st_mtime < max(path.stat().st_mtime for path in sources):
        return False
    question = (
        "import os, rodlib, ilctools; same = os.path.samefile; "
        "same(*rodlib.__path__, 'rodlib') and same(*ilctools.__path__, 'toolbox/ilctools') "
        "or os._exit(1)"
    )
    call = [ready.with_name("python"), "-I", "-X", "utf8", "-c", question]  # -I: not by its folder
    try:
        return subprocess.run(call, cwd=root, stderr=subprocess.DEVNULL).returncode == 0
    except OSError:  # its Python has gone
        return False


def entry(package: str, lock: str) -> str:
    """The lines of a lock that pin and hash a package."""
    return re.search(rf"^{package}==.*?(?=^\S|\Z)", lock, re.MULTILINE | re.DOTALL)[0]


def create(root: Path) -> None:
    """Create the environment anew, by uv, which the lock holds, or else by pip, which is slower."""
    venv, lock = root / ".venv", root / "environment.lock"
    if venv.is_symlink() or (venv.exists() and not venv.is_dir()):  # what is there would be deleted
        sys.exit(f"{venv} is no folder, or a link to one: remove it, and call make again")
    python = venv / "bin" / "python"
    (python.parent / "ready").unlink(missing_ok=True)
    print("creating the environment from environment.lock (once, some minutes) ...", flush=True)
    run([sys.executable, "-m", "venv", "--clear", venv])
    first = venv / "first.txt"
    first.write_text(entry("uv", lock.read_text(encoding="utf-8")), encoding="utf-8")
    run([python, *PIP, "--require-hashes", "-r", first])
    by_uv = [python.with_name("uv"), "pip", "install", "--quiet", "--python", python]
    if not os.access(Path.home(), os.W_OK):  # where uv would keep what it downloads
        by_uv += ["--cache-dir", root / "build" / "uv"]
    if subprocess.run([*by_uv, "--require-hashes", "-r", lock]).returncode:
        print("by uv it does not go; by pip it takes longer ...", flush=True)
        run([python, *PIP, "--require-hashes", "-r", lock])
    editable = [word for folder in packages(root) for word in ("-e", folder)]
    run([python, *PIP, "--no-deps", "--no-build-isolation", *editable])
    # compiled now, and not by each of the processes that start together
    run([python, "-c", "import control, cvxpy, ipykernel.kernelapp, pandas, xarray"])
    (python.parent / "ready").touch()


def run(command) -> None:
    """Run a command, or leave with a message."""
    if subprocess.run(command).returncode:
        sys.exit(f"the environment is incomplete: {command[2]} failed, see above")


def main(root: Path = ROOT) -> None:
    """Create the environment if need be; refuse while another process is at it."""
    if sys.version_info < (3, 11):  # noqa: UP036, whatever Python there is starts this
        sys.exit("Python 3.11 or newer is needed: make PYTHON=...")
    if is_ready(root):
        return
    sys.path.insert(0, str(ROOT / "toolbox"))  # nothing is installed yet
    from ilctools.files import alone, folder

    refusal = f"another make is creating the environment in {root}: wait until it has ended"
    try:
        with alone(folder(root / "build") / "environment.lock", refusal):
            if not is_ready(root):  # or it has been created in the meantime
                create(root)
    except (OSError, RuntimeError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
