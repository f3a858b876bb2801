"""`make test` on another machine, acted out on this one: with the kernels of another processor.

OpenBLAS and numpy bring kernels for several x86 processors, which differ in the last digits of
products and decompositions. A seed chooses one of them: texts, figures and ledger must show the
same. Two variables are all that differs, so that `OPENBLAS_CORETYPE=Nehalem pytest` runs a part.
"""

import os
import platform
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
KERNELS = ("Prescott", "Nehalem", "Sandybridge", "Haswell")  # of 2004, 2008, 2011 and 2013
NEWER = "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"  # what numpy uses of later processors


def environment(seed: int) -> dict[str, str]:
    """Variables with which a process and those that it starts have other kernels."""
    kernel = KERNELS[seed % len(KERNELS)]
    return {"OPENBLAS_CORETYPE": kernel, "NPY_DISABLE_CPU_FEATURES": NEWER}


def main(seed: int) -> int:
    """Run the tests with other kernels; as `make test` leaves."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        sys.exit("make machines has kernels of x86 processors alone, and this is another one")
    call = [sys.executable, "tools/suite.py", "--machine"]
    return subprocess.run(call, cwd=ROOT, env=os.environ | environment(seed)).returncode


def seed_of(arguments: list[str]) -> int:
    """The seed that was asked for, 1 without any; it leaves with a sentence if that is no seed."""
    text = " ".join(arguments) or "1"
    if not (text.isascii() and text.isdigit()):
        sys.exit(f"SEED={text} must be a whole number from 0 on, as in: make machines SEED=2")
    return int(text)


if __name__ == "__main__":
    sys.exit(main(seed_of(sys.argv[1:])))
