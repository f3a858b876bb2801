"""Whether the results that the notebooks left in a folder are those that are tracked.

`make test` runs the notebooks for their texts; their figures and the ledger are compared here.
"""

import sys
from pathlib import Path

from rodlib.paper.ledger import changes, join, read, report


def main(build: Path, root: Path) -> bool:
    """Say what is the same and what is not; whether anything is not."""
    try:
        rows = join(build / "ledger")
    except (KeyError, ValueError) as error:  # a notebook failed
        print(error)
        return True
    # nbval does not count the cells that it runs: which cell made a row is taken as tracked.
    tracked = read(root / "figures" / "ledger.csv")
    rows["cell"] = rows.key.map(tracked.cell)
    new = changes(rows, build, root)
    print(report(new, root))
    return bool(new)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(__file__).resolve().parents[1]))
