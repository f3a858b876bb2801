"""What the benchmarks share: a process with one thread for each core, tables, performance.md."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from concurrent.futures import ProcessPoolExecutor

from tqdm import tqdm

from rodlib.ilc.files import write_whole
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
