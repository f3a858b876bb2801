"""How much a reader has to take in: tokens of the code and of its tests, against pyproject.toml.

And whether a name says of what it is: no constant's name may stand for three values in the code.

Tokens are names, operators, numbers and strings; docstrings, comments and layout do not count.
`make lint` compares with the upper limits. A limit is no target: plainness comes first.
"""

import ast
import io
import sys
import tokenize
import tomllib
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LAYOUT = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
    tokenize.ENCODING, tokenize.ENDMARKER,
}  # fmt: skip
MOST_VALUES = 2  # of one name, in different modules; with three nobody knows which one is meant
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


def texts(root: Path, folders: list[str]) -> list[str]:
    """All modules in some folders."""
    paths = [path for folder in folders for path in (root / folder).rglob("*.py")]
    return [path.read_text(encoding="utf-8") for path in paths]


def ambiguous(modules: list[str]) -> list[str]:
    """Names of constants that have more than two values, but for the registry of each package."""
    values = defaultdict(set)
    for text in modules:
        for node in ast.parse(text).body:
            match node:
                case ast.Assign([ast.Name(name)], value) if name.isupper() and name != "MODULES":
                    values[name].add(ast.dump(value))
    return [name for name, each in values.items() if len(each) > MOST_VALUES]


def main(root: Path = ROOT) -> bool:
    """Print what has more tokens or values than its limit; return whether anything has."""
    table = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    limits = table["tool"]["rooms"]
    passed = ambiguous(texts(root, limits["code"]["folders"]))
    for name in passed:
        print(f"{name} has more than two values in the code: let each name say of what it is")
    for what, limit in limits.items():
        count = sum(map(tokens, texts(root, limit["folders"])))
        if count > limit["most"]:
            passed.append(what)
            print(f"{what}: {count} tokens, at most {limit['most']} in pyproject.toml")
    return bool(passed)


if __name__ == "__main__":
    sys.exit(main())
