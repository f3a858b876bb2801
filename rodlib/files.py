"""Files are replaced as a whole or not at all, so that nothing half-written is ever left."""

import os
from pathlib import Path


def write_whole(path: Path, text: str) -> None:
    """Replace a text file as a whole or not at all."""
    temporary = path.with_name(f".{path.name}.part")
    temporary.write_text(text, encoding="utf-8", newline="\n")
    os.replace(temporary, path)
