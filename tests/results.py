"""Whether the results that the notebooks left in a folder are those that are tracked.

`make test` runs the notebooks for their texts; their figures and the ledger are compared here.
"""

import sys
from pathlib import Path

from rodlib.files import ROOT
from rodlib.paper import pictures
from rodlib.paper.ledger import changes, join, told

if __name__ == "__main__":
    build = Path(sys.argv[1])
    figures, texts = changes(join(build / "ledger"), build, ROOT)
    print(told(figures, texts))
    sys.exit(bool(texts) or {*figures.values()} != {pictures.SAME})
