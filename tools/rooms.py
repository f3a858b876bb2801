"""How much a reader has to take in: tokens of the code and of its tests, against pyproject.toml.

Tokens are names, operators, numbers and strings; docstrings, comments and layout do not count.
`make lint` compares with the upper limits. A limit is no target: plainness comes first.
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


def counted(root: Path, folders: list[str]) -> int:
    """Tokens of all modules in some folders."""
    paths = [path for folder in folders for path in (root / folder).rglob("*.py")]
    return sum(tokens(path.read_text(encoding="utf-8")) for path in paths)


def main(root: Path = ROOT) -> bool:
    """Print what has more tokens than its limit; return whether anything has."""
    table = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    passed = False
    for what, limit in table["tool"]["rooms"].items():
        count = counted(root, limit["folders"])
        if count > limit["most"]:
            passed = True
            print(f"{what}: {count} tokens, at most {limit['most']} in pyproject.toml")
    return passed


if __name__ == "__main__":
    sys.exit(main())
