"""`make test` on another machine, acted out on this one: all rounding varied by a seed.

A scratch copy of the checkout is tested, with what tools/rounding.py does to products, transforms
and decompositions: texts, figures and ledger must show the same.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import rounding

ROOT = Path(__file__).resolve().parents[1]


def copy_checkout(target: Path) -> None:
    """Copy what git tracks or would track, as it stands in the working tree."""
    listing = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listing, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in filter(None, names.split("\0")):
        if (ROOT / name).exists():  # not one that is deleted and still tracked
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)


def main(seed: int) -> int:
    """Test a copy of the checkout with rounding varied; as `make test` leaves."""
    with tempfile.TemporaryDirectory() as folder:
        checkout, path = Path(folder) / "checkout", Path(folder) / "path"
        copy_checkout(checkout)
        folders = os.pathsep.join(map(str, [checkout, checkout / "toolbox"]))
        environment = os.environ | {
            "PYTHONPATH": rounding.search_path(path, seed, folders),
            "IPYTHONDIR": rounding.ipython_folder(path, seed),
        }
        call = [sys.executable, "tools/suite.py", "--machine"]
        return subprocess.run(call, cwd=checkout, env=environment).returncode


def seed_of(arguments: list[str]) -> int:
    """The seed that was asked for, 1 without any; it leaves with a sentence if that is no seed."""
    text = " ".join(arguments) or "1"
    if not (text.isascii() and text.isdigit()):
        sys.exit(f"SEED={text} must be a whole number from 0 on, as in: make machines SEED=2")
    return int(text)


if __name__ == "__main__":
    sys.exit(main(seed_of(sys.argv[1:])))
