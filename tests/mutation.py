"""Do the tests notice? Changes one thing in a copy of rodlib at a time, and runs the tests on it.

    python tests/mutation.py [--changes 300] [--seed 0] [--processes 2] [module ...]

A change is another comparison or arithmetic operator, `and` for `or`, a number that is off by one
or by a tenth, a `not` left out, or `max` for `min`. Printed are the changes that no test notices,
and the share that one does. First the tests run once as they are, to learn which lines each of
them executes and how long it takes. Then a change costs only the tests that execute its line, the
quick ones first, up to the first that fails. A test that takes ten times as long as it did
notices, too. Not part of `make test`: it takes about five seconds a change, and a minute
or more where all tests pass.
"""

import argparse
import ast
import copy
import importlib
import multiprocessing
import os
import pickle
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter, defaultdict
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import coverage
import pytest
from hypothesis import Phase, settings

ROOT = Path(__file__).resolve().parent.parent
MODULES = ROOT / "rodlib"
OPERATORS = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.MatMult: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
TWINS = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum"}
TWINS |= {"argmin": "argmax", "argmax": "argmin", "any": "all", "all": "any"}
DRAWINGS = {"draw_rod", "draw_block_diagram"}  # coordinates of pictures, for the eye alone
PYTEST = [
    "-x", "-q", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning",
    "--ignore", "tests/test_machines.py",  # of a tool beside rodlib, and it asks git
]  # fmt: skip
MEMORY = 8 * 2**30  # bytes a test may ask for
SLOW_TO_IMPORT = [
    "control", "cvxpy", "daqp", "matplotlib.pyplot", "nbformat", "pandas", "papermill",
    "scipy.interpolate", "scipy.optimize", "scipy.signal", "scipy.sparse.linalg", "xarray",
]  # fmt: skip

# Lines, as they begin, whose numbers another would do for: it alters nothing that is promised.
# They are left out; operators and comparisons on these lines are not.
FREE_NUMBERS = {
    "how a picture looks": {
        "paper/figures": [
            "WIDE =", "TALL =", '"figure.', '"savefig.dpi"', '"font.size"', '"axes.', '"lines.',
        ],
    },
    "how a solver gets to the optimum, and when it gives up: the certificate judges its result": {
        "synthesis/active_set": [
            "NEAR =", "NOISE =", "CONVERGED =", "K, unit =", "H[:K, :K] =", "H[K, K] =",
            "unbounded, kind =", "tolerances =", "while damping", "penalty = np.max",
            "if gain + NOISE", "if part == 1", "damping = 0.1", "damping, part =",
            "multipliers.append(np.where",
        ],
        "synthesis/bounds": ["INSIDE =", "size =", "apart =", "for _ in range("],
        "synthesis/design": ["GOOD =", "CVXPY_TOLERANCES ="],
        "synthesis/inequalities": ["_, inverse =", "while high - low"],
        "synthesis/interior_point": [
            "GAP =", "STATIONARY =", "REFINEMENTS =", "limits = np.where(peaks", "mu = 5",
            "primal, dual = step_lengths", "sigma = min(1", "for iteration in", "closed =",
            "if closed", "if iteration > 40", "damping =", "if max(primal, dual)",
        ],
        "synthesis/newton": [
            "Ch, _ =", "shift =", "shift *=", "scale = 1 / np.sqrt(np.maximum",
            "R = np.linalg.qr(np.vstack([R * scale",
        ],
        "synthesis/program": ["GENEROUS =", "weight = np.maximum"],
    },
    "how work is divided": {
        "evidence/finite_trial": ["LANCZOS =", "start = np.random"],
        "evidence/models": ["unit = 2.0"],
        "evidence/peak": ["CHUNK =", "CLOSEST =", "DENSER =", "step = max(1"],
        "paper/reproduce": ["AT_A_TIME ="],
        "synthesis/bounds": ["if A.shape[0] * B.shape[1] > 36"],
    },
    "a limit that is not reached": {
        "evidence/optimality": ["STEPS ="],
        "evidence/peak": ["for _ in range(100)"],
        "evidence/robustness": ["STEPS ="],
        "paper/ledger": ["texts ="],
    },
    "what is as good as zero, or where a square might leave the doubles": {
        "arguments": ['size = "large"'],  # it is asked beyond the limits only
        "evidence/finite_trial": ["return int(np.ceil(np.log(1e-18)"],
        "filters": ["decay = int"],
        "laboratory/virtual_rig": ["near =", "lagging ="],
        "posing": ["slack = 1e-9"],
        "problem": ["if not (total.min", "extreme ="],
    },
}  # fmt: skip


@dataclass(frozen=True)
class Change:
    """One thing that is different in a module."""

    module: str
    line: int
    lines: range  # of the statement, or of the head of a compound one
    before: str
    after: str
    source: str
    number: bool  # whether another number is all

    def __str__(self):
        return f"rodlib/{self.module}.py:{self.line}: {self.before} -> {self.after}"


@dataclass(frozen=True)
class Tests:
    """What is known about the tests: their duration in seconds, and who executes which lines."""

    seconds: dict
    executing: dict  # module and line: tests
    elsewhere: set  # tests that start other processes, whose lines are not known

    def of(self, change):
        """The tests that could notice a change, the quick ones and those of its module first."""
        places = [(change.module, line) for line in change.lines]
        chosen = set().union(*(self.executing.get(place, ()) for place in places))
        if None in chosen:  # executed by the import: whoever uses the module
            chosen = set().union(
                *(tests for (module, _), tests in self.executing.items() if module == change.module)
            ) - {None}
        module = Path(change.module)
        mirror = f"tests/{module.with_name(f'test_{module.name}.py').as_posix()}"

        def costs(test):
            return self.seconds[test] * (1 if test.startswith(mirror) else 4)

        return [*sorted(chosen, key=costs), *sorted(self.elsewhere - chosen, key=costs)]


class Measuring:
    """Plugin of pytest that finds out what :class:`Tests` holds.

    A fixture is made once for many tests; its lines belong to all of them.
    """

    def __init__(self, folder):
        self.coverage = coverage.Coverage(data_file=None, source=[str(folder / "rodlib")])
        self.folder = folder
        self.seconds, self.fixtures, self.elsewhere = {}, {}, set()
        self.test = None
        sys.addaudithook(self.heard)

    def heard(self, event, _):
        if self.test and event == "subprocess.Popen":
            self.elsewhere.add(self.test)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item, nextitem):
        self.test = item.nodeid
        self.fixtures[item.nodeid] = {f"fixture {name}" for name in item.fixturenames}
        self.coverage.switch_context(item.nodeid)
        begin = time.perf_counter()
        result = yield
        self.seconds[item.nodeid] = time.perf_counter() - begin
        return result

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef, request):
        self.coverage.switch_context(f"fixture {fixturedef.argname}")
        try:
            return (yield)
        finally:
            self.coverage.switch_context(self.test)

    def found(self):
        users = defaultdict(set, {"": {None}})
        for test, fixtures in self.fixtures.items():
            for context in (test, *fixtures):
                users[context].add(test)
        data, executing = self.coverage.get_data(), {}
        for path in data.measured_files():
            for line, contexts in data.contexts_by_lineno(path).items():
                tests = set().union(*(users[context] for context in contexts))
                executing[name_of(Path(path), self.folder / "rodlib"), line] = tests
        return Tests(self.seconds, executing, self.elsewhere)


class Chosen:
    """Plugin of pytest that runs some tests only, in a given order, each for a limited time."""

    def __init__(self, order, seconds):
        self.order, self.seconds = {test: place for place, test in enumerate(order)}, seconds

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items):
        items[:] = [item for item in items if item.nodeid in self.order]
        items.sort(key=lambda item: self.order[item.nodeid])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item, nextitem):
        limit = 10 + 10 * self.seconds[item.nodeid]
        signal.setitimer(signal.ITIMER_PROF, limit)  # of the processor
        signal.alarm(int(10 * limit))  # of the clock, for tests that wait
        return (yield)

    def pytest_collection(self):
        """That an example fails is enough; the simplest one is not looked for."""
        settings.register_profile("any", settings.default, phases=[Phase.explicit, Phase.generate])
        settings.load_profile("any")


def name_of(path, folder=MODULES):
    """Of a module in a folder, such as "filters" or "evidence/peak"."""
    return path.relative_to(folder).with_suffix("").as_posix()


def changed(node):
    """All nodes that could stand in place of this one."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float, complex):
        near = [node.value + 1, node.value - 1]
        near = near if isinstance(node.value, int) else [node.value * 1.1 or 1.0]
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
    """Every node with its statement; without drawings, annotations and messages.

    And without the negative size in reshape, for which numpy takes any negative number.
    """

    def inside(node, statement):
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "returns"):
                continue
            for child in value if isinstance(value, list) else [value]:
                drawing = isinstance(child, ast.FunctionDef) and child.name in DRAWINGS
                if (
                    isinstance(child, ast.AST)
                    and not drawing
                    and not isinstance(child, ast.JoinedStr)
                ):
                    nearest = child if isinstance(child, ast.stmt) else statement
                    yield child, nearest
                    yield from inside(child, nearest)

    return inside(tree, None)


def head(statement):
    """Lines of a statement, or of what stands before the body of a compound one."""
    body = getattr(statement, "body", None)
    stop = body[0].lineno if body else statement.end_lineno + 1
    return range(statement.lineno, max(stop, statement.lineno + 1))


def all_changes(path):
    """Every change of a module."""
    text = path.read_text(encoding="utf-8")
    lines = text.encode().splitlines(keepends=True)
    ends = [0]
    for line in lines:
        ends.append(ends[-1] + len(line))
    for node, statement in places(ast.parse(text)):
        for other in changed(node):
            after = ast.unparse(other)
            after = after if isinstance(node, ast.stmt) else f"({after})"
            start = ends[node.lineno - 1] + node.col_offset
            stop = ends[node.end_lineno - 1] + node.end_col_offset
            source = (text.encode()[:start] + after.encode() + text.encode()[stop:]).decode()
            before, number = ast.unparse(node), isinstance(node, ast.Constant)
            yield Change(name_of(path), node.lineno, head(statement), before, after, source, number)


def free_numbers(paths):
    """Modules and lines of `FREE_NUMBERS`; an entry that fits no line is an error."""
    text = {name_of(path): path.read_text(encoding="utf-8").splitlines() for path in paths}
    found = set()
    for modules in FREE_NUMBERS.values():
        for module, beginnings in modules.items():
            for start in beginnings:
                fitting = {
                    (module, number)
                    for number, line in enumerate(text[module], 1)
                    if line.strip().startswith(start)
                }
                if not fitting:
                    sys.exit(f"FREE_NUMBERS: no line of rodlib/{module}.py begins {start!r}")
                found |= fitting
    return found


def drawn(changes, count, seed):
    """A random part of the changes; it stays nearly the same when a module is edited elsewhere."""
    seen, lots = Counter(), {}
    for change in changes:
        what = (change.module, change.before, change.after)
        seen[what] += 1
        lots[random.Random(f"{seed} {what} {seen[what]}").random()] = change
    return [lots[lot] for lot in sorted(lots)[:count]]


def in_a_fork(folder, work):
    """Do some work in a fork of this process, which has imported everything but rodlib.

    Returns the code with which the fork ended; it and all it started are gone by then.
    """
    child = os.fork()
    if not child:
        code = 1
        try:
            os.setsid()
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            os.chdir(folder)
            os.environ["PYTHONPATH"] = str(folder)
            sys.path.insert(0, str(folder))
            code = work()
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(int(code))
    _, status = os.waitpid(child, 0)
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    return status


def measure(folder):
    """Run all tests once, as they are."""
    kept = folder / "measured"

    def work():
        measuring = Measuring(folder)
        with measuring.coverage.collect():
            code = pytest.main([*PYTEST, "tests"], [measuring])
        kept.write_bytes(pickle.dumps(measuring.found()))
        return code

    if in_a_fork(folder, work):
        sys.exit("the tests fail as they are")
    return pickle.loads(kept.read_bytes())


def survives(original, tests, change):
    """Whether all tests pass with the change."""
    order = tests.of(change)
    if not order:
        return True
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(original, folder, dirs_exist_ok=True)
        (Path(folder) / "rodlib" / f"{change.module}.py").write_text(
            change.source, encoding="utf-8"
        )
        files = dict.fromkeys(test.partition("::")[0] for test in order)
        chosen = Chosen(order, tests.seconds)

        def work():
            silence = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silence, 1)
            os.dup2(silence, 2)
            return pytest.main([*PYTEST, *files], [chosen])

        return in_a_fork(folder, work) == 0


def prepare():
    """Once, and not for every change: what takes long to import, on one thread."""
    os.nice(10)
    os.environ |= {"PYTHONDONTWRITEBYTECODE": "1", "MPLBACKEND": "agg"}
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    for name in SLOW_TO_IMPORT:
        importlib.import_module(name)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("modules", nargs="*", help="filters, evidence/peak, ...; by default all")
    parser.add_argument("--changes", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    chosen = parser.parse_args()
    paths = sorted(MODULES.rglob("*.py"))
    free = free_numbers(paths)
    for module in {*chosen.modules} - {name_of(path) for path in paths}:
        parser.error(f"there is no module rodlib/{module}.py")
    found = [
        change
        for path in paths
        if not chosen.modules or name_of(path) in chosen.modules
        for change in all_changes(path)
    ]
    left = [c for c in found if not (c.number and (c.module, c.line) in free)]
    tried = drawn(left, chosen.changes, chosen.seed)
    print(f"{len(tried)} of {len(left)} changes; {len(found) - len(left)} are left out", flush=True)
    prepare()
    with tempfile.TemporaryDirectory() as original:
        ignored = shutil.ignore_patterns(".venv", ".git", ".*_cache", "build", "__pycache__")
        shutil.copytree(ROOT, original, dirs_exist_ok=True, ignore=ignored)
        tests = measure(Path(original))
        sys.dont_write_bytecode = True
        all_of, noticed = Counter(), Counter()
        with multiprocessing.get_context("fork").Pool(chosen.processes) as pool:
            survival = pool.imap(partial(survives, original, tests), tried)
            for change, survived in zip(tried, survival, strict=True):
                all_of[change.module] += 1
                noticed[change.module] += not survived
                if survived:
                    print(change, flush=True)
    for module in sorted(all_of):
        print(f"{module:34}{noticed[module]:4} of {all_of[module]:3} noticed")
    share = noticed.total() / all_of.total()
    print(f"{noticed.total()} of {all_of.total()} noticed, {share:.1%} (seed {chosen.seed})")


if __name__ == "__main__":
    main()
