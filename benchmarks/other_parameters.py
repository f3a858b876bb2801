"""Notebooks with other parameters, drawn within the ranges that they state: how does each run end?

A run ends well, or with an error that the notebook or the packages raise on purpose, or with
another package's error, which is a defect. If a NaN is printed, the notebook has to say what the
NaN stands for, in a line that begins with "nan means:".
"""

import ast
import io
import os
import re
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from functools import cache

import matplotlib
import nbformat
import numpy as np
from runner import run

from rodlib.paper.repository import ROOT

RUNS = 10  # of each notebook
MOST_AT_ONCE = 3  # parameters that a run changes
LARGEST = {  # of parameters whose larger values take minutes, and show no more
    "draws": 4,
    "drawn": 60,
    "evaluations": 10,
    "frequencies": 400,
    "hours": 12.0,
    "records": 2,
    "rods": 1000,
    "sampled": 200,
    "samples": 5000,
    "seeds": 6,
    "trials": 12,
    "varying": 6,
}
OURS = ("ilctools", "rodlib", "<notebook>")
NAN = re.compile(r"\bnan\b", re.IGNORECASE)


def begun(name):
    """A notebook after its imports and parameters: its names, and the sources of further cells."""
    cells = nbformat.read(ROOT / f"notebooks/{name}.ipynb", as_version=4).cells
    imports, chosen, *sources = (cell.source for cell in cells if cell.cell_type == "code")
    names = {"display": print}
    exec(f"{imports}\n{chosen}", names)
    return names, sources


def run_cell(source, names):
    """Run a cell, and print the value of its last expression."""
    tree = ast.parse(source)
    if isinstance(last := tree.body[-1], ast.Expr):
        last.value = ast.Call(ast.Name("print", ast.Load()), [last.value], [])
    exec(compile(ast.fix_missing_locations(tree), "<notebook>", "exec"), names)


def arguments_of_checked(source):
    """The arguments of calls of `checked`, by name, each a list of expressions."""
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    calls = [call for call in calls if getattr(call.func, "id", "") == "checked"]
    return {word.arg: word.value.elts for call in calls for word in call.keywords}


@cache
def ranges(name):
    """The parameters of a notebook that have a range: name, and (default, least, most)."""
    with matplotlib.rc_context():  # the imports choose the style of the figures
        names, sources = begun(name)
    found = arguments_of_checked("\n".join(sources))
    return {
        parameter: [eval(ast.unparse(part), names) for part in range_]
        for parameter, (_, *range_) in found.items()
        if len(range_) == 3
    }


def drawn(name, number, seed):
    """The parameters of a run: up to three, each at an end of its range or within it."""
    rng, of = np.random.default_rng([seed, number, *name.encode()]), ranges(name)
    changed = rng.choice([*of], size=min(len(of), rng.integers(1, MOST_AT_ONCE + 1)), replace=False)
    values = {}
    for key in map(str, changed):
        _, least, most = of[key]
        most = max(least, min(most, LARGEST.get(key, most)))
        if rng.random() < 0.3:
            value = rng.choice([least, most])
        elif least > 0 and most / least > 30:
            value = np.exp(rng.uniform(np.log(least), np.log(most)))
        else:
            value = rng.uniform(least, most)
        whole = isinstance(least, int) and isinstance(most, int)
        values[key] = round(float(value)) if whole else float(f"{value:.4g}")
    return values


def raised_by_us(error, source):
    """Whether the last line that ran is a `raise` of the packages or of the notebook's cell."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    line = source.splitlines()[last.lineno - 1] if last.filename == "<notebook>" else last.line
    ours = any(part in last.filename for part in OURS)
    return bool(ours and str(error) and line.lstrip().startswith("raise"))


def ended(name, parameters):
    """How a run ends, in a word, with the last line of what it says, and its CPU seconds."""
    os.chdir(ROOT / "notebooks")
    os.environ["RODLIB_RESULTS"] = tempfile.mkdtemp()
    matplotlib.use("agg")
    said, start = io.StringIO(), time.process_time()
    outcome, text, source = "ended", "", ""
    with warnings.catch_warnings(), redirect_stdout(said), redirect_stderr(said):
        warnings.simplefilter("default")  # as in a notebook
        try:
            names, sources = begun(name)
            names |= parameters
            for source in sources:
                run_cell(source, names)
        except Exception as error:
            outcome = "own error" if raised_by_us(error, source) else "raw error"
            text = f"{type(error).__name__}: {error}"
    if outcome == "ended" and NAN.search(said.getvalue()) and "nan means:" not in said.getvalue():
        line = next(line for line in said.getvalue().splitlines() if NAN.search(line))
        outcome, text = "nan", line.strip()
    return outcome, " ".join(text.split())[:300], time.process_time() - start


def judged(case):
    """The outcome of a case (name, number, seed)."""
    name, *draw = case
    parameters = drawn(name, *draw)
    return name, parameters, *ended(name, parameters)


def main(*words):
    """Run all notebooks, or those whose names begin with a word; whether any run ended badly.

    A word may be seed=3, for other draws: make measure WHAT=other_parameters ARGS="seed=3 07 08".
    """
    seed = next((int(word[5:]) for word in words if word.startswith("seed=")), 0)
    names = tuple(word for word in words if not word.startswith("seed="))
    every = sorted(path.stem for path in ROOT.glob("notebooks/*.ipynb"))
    books = [name for name in every if not names or name.startswith(names)]
    cases = [(name, number, seed) for name in books if ranges(name) for number in range(RUNS)]
    counts = Counter()
    with ProcessPoolExecutor(max_tasks_per_child=1) as pool:
        for name, parameters, outcome, text, seconds in run(judged, cases, pool):
            counts[outcome] += 1
            if outcome != "ended":
                print(f"{name} {parameters}: {outcome}: {text} [{seconds:.0f} s]", flush=True)
    print(*(f"{count} {outcome}" for outcome, count in counts.items()), sep=", ")
    return bool(counts["raw error"] or counts["nan"])


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
