"""Whether the results that the notebooks left in a folder are those that are tracked.

`make test` runs the notebooks for their texts; their figures and the ledger are compared here.
"""

import sys
from pathlib import Path

import pandas as pd

from rodlib.paper.comparison import SAME
from rodlib.paper.ledger import changes, join, report


def main(build: Path, root: Path) -> bool:
    """Say what is the same and what is not; whether anything is not."""
    try:
        rows = join(build / "ledger")
    except (KeyError, ValueError) as error:  # a notebook failed
        print(error)
        return True
    # nbval does not count the cells that it runs: which cell made a row is taken as tracked.
    tracked = pd.read_csv(
        root / "figures" / "ledger.csv", index_col="key", dtype=str, keep_default_na=False
    )
    rows["cell"] = rows.key.map(tracked.cell)
    figures, texts = changes(rows, build, root)
    print(report(figures, texts))
    return bool(texts) or any(kind != SAME for kind in figures.values())


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(__file__).resolve().parents[1]))
