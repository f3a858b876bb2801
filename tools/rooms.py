"""How much a reader has to take in: tokens of each room, against the table in pyproject.toml.

Tokens are names, operators, numbers and strings; docstrings, comments and layout do not count.
`make lint` compares. Whoever raises a number there says in the commit what it bought.
"""

import ast
import io
import sys
import tokenize
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LAYOUT = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
    tokenize.ENCODING, tokenize.ENDMARKER,
}  # fmt: skip
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def tokens(text: str) -> int:
    """How many a module has."""
    docstrings = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node) is not None:
            first = node.body[0]
            docstrings |= set(range(first.lineno, first.end_lineno + 1))
    each = tokenize.generate_tokens(io.StringIO(text).readline)
    return sum(t.type not in LAYOUT and t.start[0] not in docstrings for t in each)


def counted(root: Path, rooms: dict[str, int]) -> dict[str, int]:
    """Tokens of each room: a folder with all below it but for what is a room itself."""
    total = dict.fromkeys(rooms, 0)
    for path in root.rglob("*.py"):
        parents = [parent.as_posix() for parent in path.relative_to(root).parents]
        room = next((parent for parent in parents if parent in rooms), None)
        if room:
            total[room] += tokens(path.read_text(encoding="utf-8"))
    return total


def main(root: Path = ROOT) -> bool:
    """Print the rooms that have more than the table says, or what all of it has; whether any do."""
    table = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    rooms = table["tool"]["rooms"]
    total = rooms.pop("total")
    counts, passed = counted(root, rooms), False
    for room, count, most in [
        *((room, counts[room], most) for room, most in rooms.items()),
        ("the sum of the rooms", sum(rooms.values()), total),
    ]:
        if count > most:
            passed = True
            print(f"{room}: {count} tokens, {most} in pyproject.toml")
    return passed


if __name__ == "__main__":
    sys.exit(main())
