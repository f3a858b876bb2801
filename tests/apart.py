"""What a process of its own runs: by import, so not from a test, whose module has no such name."""

import os

from rodlib.paper import reproduce


def to_files(root):
    """Reproduce, with all that is said in files."""
    for number, name in ((1, "stdout"), (2, "stderr")):
        with open(root / name, "w") as file:
            os.dup2(file.fileno(), number)
    reproduce.main(root)
