"""What the benchmarks share: a process with one thread for each core, tables, performance.md.

Run by itself it lists them.
"""

import ast
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from tqdm import tqdm

from ilctools.files import write_whole
from rodlib.paper.ledger import splice
from rodlib.paper.repository import ROOT


def run(function, *cases):
    """Results of a function for many cases, in their order, while others are computed."""
    with ProcessPoolExecutor() as pool:
        yield from tqdm(pool.map(function, *cases), total=len(cases[0]))


def table(titles, rows):
    """A table in Markdown; what is a number in its last row is a column of numbers."""
    rule = ["---:" if cell[:1].isdigit() else "---" for cell in rows[-1]]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (titles, rule, *rows))


def publish(section, text):
    """Replace a section of figures/performance.md."""
    page = ROOT / "figures" / "performance.md"
    write_whole(page, splice(page.read_text(encoding="utf-8"), section, text))


def listed() -> str:
    """A line for each benchmark that `make measure` runs, the first of what it says of itself."""
    lines = {}
    for path in sorted(Path(__file__).parent.glob("*.py")):
        text = path.read_text(encoding="utf-8")
        if "__main__" in text and path.name not in ("runner.py", "report.py"):
            lines[path.stem] = ast.get_docstring(ast.parse(text)).partition("\n")[0]
    return "\n".join(f"make measure WHAT={name:<13} {line}" for name, line in lines.items())


if __name__ == "__main__":
    print(listed())
