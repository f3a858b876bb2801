"""All that `make test` runs: whatever fails, the rest runs as well, and the end names what failed.

Lint; one run of pytest over the committed notebooks and the tests; the notebooks' figures and
ledger against those that are tracked. `python tools/suite.py --machine` leaves out lint and
browser, which do not depend on the processor.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

from rodlib.paper.reproduce import longest_first

ROOT = Path(__file__).resolve().parents[1]
PYTEST = "-m pytest -q -rs -n 2 --dist loadfile --no-loadscope-reorder --nbval --nbval-current-env"


def parts(build: Path, machine: bool) -> dict[str, list]:
    """Arguments of Python, by the name of what they run."""
    lint = {"lint": ["-m", "ruff", "check"], "format": ["-m", "ruff", "format", "--check"]}
    lint["tokens"] = [ROOT / "tools" / "rooms.py"]
    browser = ["-m", "pytest", "-q", "-rs", f"--junitxml={build / 'browser.xml'}"]
    lint["browser"] = [*browser, ROOT / "tests" / "browser"]
    report = f"--junitxml={build / 'report.xml'}"
    tests = [*longest_first(ROOT), ROOT / "tests", ROOT / "toolbox" / "tests"]
    return ({} if machine else lint) | {
        "tests": [*PYTEST.split(), report, *tests],
        "figures and ledger": [ROOT / "tools" / "results.py", build],
    }


def failures(report: Path) -> list[str]:
    """Names of the tests, and of the cells of notebooks, that failed."""
    if not report.exists():
        return ["pytest did not reach its end"]
    cases = ElementTree.parse(report).iter("testcase")
    failed = [case for case in cases if {"failure", "error"} & {child.tag for child in case}]
    return [f"{case.get('classname')}: {case.get('name')}" for case in failed]


def main(machine: bool = False) -> bool:
    """Run all parts and print the names of what failed; whether anything did."""
    build, failed = ROOT / "build" / "test", []
    shutil.rmtree(build, ignore_errors=True)
    build.mkdir(parents=True)
    environment = os.environ | {"RODLIB_RESULTS": str(build)}
    beside = None  # the browser, which waits more than it computes
    for part, arguments in parts(build, machine).items():
        process = subprocess.Popen([sys.executable, *arguments], cwd=ROOT, env=environment)
        if part == "browser":
            beside = process
        elif process.wait():
            names = failures(build / "report.xml") if part == "tests" else []
            failed.append("\n  ".join([part, *names]))
    if beside and beside.wait():
        failed.append("\n  ".join(["browser", *failures(build / "browser.xml")]))
    print("\n".join(["failed:", *failed] if failed else ["all passed"]), flush=True)
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main(machine="--machine" in sys.argv))
