"""Do the tests notice? Changes one thing in a copy of rodlib at a time, and runs the tests on it.

    python tests/mutation.py --changes 300 --seed 0 [--processes 2] [module ...]

A change is another comparison or arithmetic operator, `and` for `or`, a number that is off by one
or by a tenth, a `not` left out, or `max` for `min`. Printed are the changes that no test notices,
and the share that one does. Not part of `make test`: it takes about ten seconds a change.
"""

import argparse
import ast
import copy
import importlib
import multiprocessing
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
DRAWINGS = {"draw_rod", "draw_block_diagram"}  # coordinates of pictures, for the eye alone
OPERATORS = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.MatMult: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
MEMORY = 8 * 2**30  # bytes a test may ask for
SLOW_TO_IMPORT = [
    "control", "cvxpy", "daqp", "matplotlib.pyplot",
    "pandas", "scipy.interpolate", "scipy.optimize", "scipy.signal", "scipy.sparse.linalg",
    "xarray",
]  # fmt: skip
TWINS = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum"}
TWINS |= {"argmin": "argmax", "argmax": "argmin", "any": "all", "all": "any"}


def changed(node):
    """All nodes that could stand in place of this one."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float, complex):
        near = [node.value + 1, node.value - 1]
        near = near if isinstance(node.value, int) else [node.value * 1.1]
        return [ast.Constant(value) for value in near]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return [node.operand]
    if isinstance(node, ast.Name) and node.id in TWINS:
        return [ast.Name(TWINS[node.id], node.ctx)]
    if isinstance(node, ast.Attribute) and node.attr in TWINS:
        return [ast.Attribute(node.value, TWINS[node.attr], node.ctx)]
    others = []
    if isinstance(node, ast.Compare):
        for i, operator in enumerate(node.ops):
            other = copy.deepcopy(node)
            other.ops[i] = OPERATORS[type(operator)]()
            others.append(other)
    elif isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign) and type(node.op) in OPERATORS:
        other = copy.deepcopy(node)
        other.op = OPERATORS[type(node.op)]()
        others.append(other)
    return others


def places(tree):
    """Parent, field and index of every node; without drawings, annotations and messages."""
    for parent in ast.walk(tree):
        for child in ast.iter_child_nodes(parent):
            child.parent = parent
    skipped = set()
    for node in ast.walk(tree):
        idle = []
        if isinstance(node, ast.FunctionDef) and node.name in DRAWINGS:
            idle = [node]
        elif isinstance(node, ast.AnnAssign | ast.arg) and node.annotation:
            idle = [node.annotation]
        elif isinstance(node, ast.FunctionDef) and node.returns:
            idle = [node.returns]
        elif isinstance(node, ast.JoinedStr):
            idle = [node]
        for top in idle:
            skipped.update(id(inside) for inside in ast.walk(top))
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        for field, value in ast.iter_fields(node):
            for index, child in enumerate(value if isinstance(value, list) else [value]):
                if isinstance(child, ast.AST) and id(child) not in skipped:
                    yield node, field, index if isinstance(value, list) else None, child


def all_changes(path):
    """Source of the module, line, before and after, of every change of it."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    found = []
    for parent, field, index, child in places(tree):
        for other in changed(child):
            swap(parent, field, index, other)
            statement = ast.unparse(ast.fix_missing_locations(tree))
            swap(parent, field, index, child)
            found.append((path.name, child.lineno, shown(child), shown(other), statement))
    return found


def swap(parent, field, index, node):
    if index is None:
        setattr(parent, field, node)
    else:
        getattr(parent, field)[index] = node


def shown(node):
    return ast.unparse(ast.fix_missing_locations(node)).split("\n")[0]


def survives(change, original, mirrored, seconds):
    """Whether all tests pass with the change; to take much too long counts as noticed."""
    name, *_, source = change
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(original, folder, dirs_exist_ok=True)
        (Path(folder) / "rodlib" / name).write_text(source, encoding="utf-8")
        mirror = f"tests/test_{name}"
        order = [mirror] if (Path(folder) / mirror).exists() else []
        order = order if mirrored and order else [*order, "tests"]
        return all(passes(folder, tests, seconds) for tests in order)


def passes(folder, tests, seconds):
    """Run tests in a fork of this process, which has imported everything but rodlib."""
    child = os.fork()
    if not child:
        signal.alarm(10 * seconds)  # of the clock, for tests that wait
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        os.chdir(folder)
        os.environ["PYTHONPATH"] = folder
        sys.path.insert(0, folder)
        code = 1
        try:
            code = pytest.main(["-x", "-q", "-p", "no:cacheprovider", tests])
        finally:
            os._exit(int(code))
    return os.waitpid(child, 0)[1] == 0


def prepare():
    """Once, and not for every change: what takes long to import, on one thread."""
    sys.dont_write_bytecode = True
    os.environ |= {"PYTHONDONTWRITEBYTECODE": "1", "MPLBACKEND": "agg"}
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    for name in SLOW_TO_IMPORT:
        importlib.import_module(name)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("modules", nargs="*", help="such as filters; all if none is named")
    parser.add_argument("--changes", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seconds", type=int, default=600, help="of one processor, per change")
    parser.add_argument("--mirrored", action="store_true", help="run tests/test_<module> only")
    chosen = parser.parse_args()
    paths = sorted((ROOT / "rodlib").glob("*.py"))
    paths = [path for path in paths if not chosen.modules or path.stem in chosen.modules]
    found = [change for path in paths for change in all_changes(path)]
    tried = random.Random(chosen.seed).sample(found, min(chosen.changes, len(found)))
    print(f"{len(tried)} of {len(found)} changes", flush=True)
    prepare()
    fork = multiprocessing.get_context("fork")
    with (
        tempfile.TemporaryDirectory() as original,
        ProcessPoolExecutor(chosen.processes, mp_context=fork) as pool,
    ):
        ignored = shutil.ignore_patterns(".venv", ".git", ".*_cache", "build", "__pycache__")
        shutil.copytree(ROOT, original, dirs_exist_ok=True, ignore=ignored)

        def survival(changes):
            limits = [
                [limit] * len(changes) for limit in (original, chosen.mirrored, chosen.seconds)
            ]
            return pool.map(survives, changes, *limits)

        unchanged = [(path.name, path.read_text(encoding="utf-8")) for path in paths]
        for (name, _), passed in zip(unchanged, survival(unchanged), strict=True):
            if not passed:
                sys.exit(f"the tests fail as they are: tests/test_{name}, or others")
        survivors = 0
        for number, (change, survived) in enumerate(zip(tried, survival(tried), strict=True)):
            name, line, before, after, _ = change
            if survived:
                survivors += 1
                print(f"{number}: rodlib/{name}:{line}: {before} -> {after}", flush=True)
    print(f"{len(tried) - survivors} of {len(tried)} noticed, {1 - survivors / len(tried):.1%}")


if __name__ == "__main__":
    main()
