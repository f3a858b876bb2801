"""What the benchmarks share: a process with one thread for each core, tables, performance.md."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext

from tqdm import tqdm

from ilctools.files import write_whole
from rodlib.paper.ledger import splice
from rodlib.paper.repository import ROOT


def run(function, cases, executor=None):
    """Results of a function for many cases, in their order, by a process for each core.

    Or by another executor, as in `rodlib.responses`.
    """
    with nullcontext(executor) if executor else ProcessPoolExecutor() as pool:
        yield from tqdm(pool.map(function, cases), total=len(cases))


def table(titles, rows):
    """A table in Markdown; what is a number in its last row is a column of numbers."""
    rule = ["---:" if cell[:1].isdigit() else "---" for cell in rows[-1]]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (titles, rule, *rows))


def publish(section, text):
    """Print a text, and make it a section of figures/performance.md."""
    print(text)
    page = ROOT / "figures" / "performance.md"
    text = text.rstrip("\n") + "\n"  # or the marker would end the last row of a table
    write_whole(page, splice(page.read_text(encoding="utf-8"), section, text))
