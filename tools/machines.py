"""`make test` on other machines, as far as this one can stand in for them.

Two machines differ in the last digits of linear algebra. OpenBLAS, on which numpy and scipy rest,
has code for every family of processors and can be told which to take, as far as this processor can
run it; where long doubles are no longer than doubles can be acted out; and rounding itself can be
varied, by a seed, which needs no other processor. For each such machine a scratch copy of the
checkout is tested: the text of the notebooks, the ledger and the README must come out as they are
here, to the byte, and the figures the same, as `make reproduce` judges it.

`python tools/machines.py [NAME ...]`: some of them; `rounding-7` is the seed 7. `--of COMMIT`
names the kernels that continuous integration takes for a commit, by its hash.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import rounding

ROOT = Path(__file__).resolve().parents[1]
LOGS = ROOT / "build" / "machines"
KERNELS = ("Haswell", "Prescott", "Nehalem", "Sandybridge", "Zen", "SkylakeX")
NO_LONG_DOUBLES = "no-long-doubles"
ROUNDING = tuple(f"rounding-{seed}" for seed in range(1, 6))
PRODUCT = "import numpy; x = numpy.ones((64, 64)); x @ x; numpy.linalg.svd(x)"
SHORT = "import numpy\nnumpy.longdouble, numpy.clongdouble = numpy.float64, numpy.complex128\n"


def probe(kernel: str) -> tuple[str, str]:
    """What OpenBLAS calls the code it takes for `kernel`, and why it cannot be run here, or ""."""
    environment = os.environ | {"OPENBLAS_CORETYPE": kernel, "OPENBLAS_VERBOSE": "2"}
    outcome = subprocess.run(
        [sys.executable, "-c", PRODUCT], env=environment, capture_output=True, text=True
    )
    said = outcome.stdout + outcome.stderr
    core = re.search(r"^Core: (\w+)", said, flags=re.MULTILINE)
    if not core:
        return "", "numpy does not rest on an OpenBLAS that can choose"
    if "Core not found" in said:
        return core[1], "this OpenBLAS has no code for it"
    return core[1], "this processor cannot run it" if outcome.returncode else ""


def copy_checkout(target: Path) -> None:
    """Copy what git tracks or would track, as it stands in the working tree."""
    listing = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listing, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in filter(None, names.split("\0")):
        if (ROOT / name).exists():  # not one that is deleted and still tracked
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)


def try_machine(name: str) -> list[str]:
    """Test a copy of the checkout as on another machine; what failed, or nothing."""
    with tempfile.TemporaryDirectory() as folder:
        checkout, path = Path(folder) / "checkout", Path(folder) / "path"
        copy_checkout(checkout)
        path.mkdir()
        folders = os.pathsep.join(map(str, [checkout, checkout / "toolbox", path]))
        environment = os.environ | {"PYTHONPATH": folders}
        if name in KERNELS:
            environment["OPENBLAS_CORETYPE"] = name
        elif name == NO_LONG_DOUBLES:
            (path / "sitecustomize.py").write_text(SHORT)
        else:
            seed = int(name.removeprefix("rounding-"))
            environment["PYTHONPATH"] = rounding.search_path(path, seed, folders)
            environment["IPYTHONDIR"] = rounding.ipython_folder(path, seed)
        log = LOGS / f"{name}.txt"
        call = [sys.executable, "tools/suite.py", "--machine"]
        with open(log, "w") as file:
            outcome = subprocess.run(call, cwd=checkout, env=environment, stdout=file, stderr=file)
        named = log.read_text().partition("\nfailed:\n")[2].splitlines()
        return (
            [*map(str.strip, named), f"see {log.relative_to(ROOT)}"] if outcome.returncode else []
        )


def runnable() -> dict[str, str]:
    """What OpenBLAS calls its code for processors that this one can stand in for, each once."""
    cores = {}
    for kernel in KERNELS:
        core, reason = probe(kernel)
        if not reason:
            cores.setdefault(core, kernel)
    return cores


def main(names: list[str]) -> int:
    """Try the machines named, or all, and print a table; the number of those that failed."""
    LOGS.mkdir(parents=True, exist_ok=True)
    tried, failures = {}, 0
    known = "|".join([*KERNELS, NO_LONG_DOUBLES, r"rounding-\d+"])
    for name in names:
        if not re.fullmatch(known, name):
            sys.exit(f"{name} is not one of {known}")
    for name in names or [*KERNELS, NO_LONG_DOUBLES, *ROUNDING]:
        core, reason = probe(name) if name in KERNELS else (name, "")
        if not reason and core in tried:  # OpenBLAS has one code for several families
            reason = f"the same code as {tried[core]}"
        failed = [] if reason else try_machine(name)
        if not reason:
            tried[core] = name
        failures += bool(failed)
        result = f"left out: {reason}" if reason else "; ".join(failed) or "passed"
        print(f"{name:<16} {result}", flush=True)
    return failures


if __name__ == "__main__":
    if sys.argv[1:2] == ["--of"]:
        kernels = [*runnable().values()] or [""]  # an empty name: as the processor has it
        print(kernels[int(sys.argv[2], 16) % len(kernels)])
    else:
        sys.exit(main(sys.argv[1:]))
