"""Whether the results that the notebooks left in a folder are those that are tracked.

`make test` runs the notebooks for their texts; their figures and the ledger are compared here.
"""

import sys
from pathlib import Path

from rodlib.paper import pictures
from rodlib.paper.ledger import changes, join, report


def main(build: Path, root: Path) -> bool:
    """Say what is the same and what is not; whether anything is not."""
    figures, texts = changes(join(build / "ledger"), build, root)
    print(report(figures, texts))
    return bool(texts) or any(kind != pictures.SAME for kind in figures.values())


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(__file__).resolve().parents[1]))
