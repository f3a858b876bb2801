"""Whether the results that the notebooks left in a folder are those that are tracked.

`make test` runs the notebooks for their texts; their figures and the ledger are compared here.
"""

import sys
from pathlib import Path

from rodlib.paper.ledger import changed


def main(build: Path, root: Path) -> bool:
    """Say what is the same and what is not; whether anything is not."""
    try:
        return bool(changed(build, root))
    except (KeyError, ValueError) as error:  # a notebook failed
        print(error)
        return True


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(__file__).resolve().parents[1]))
