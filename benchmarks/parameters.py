"""Do the notebooks take other parameters? Each is run with two other settings.

It says of each run how it ends: to the end, in a sentence (a parameter is out of its range, or no
filter meets the bounds), or in a traceback, which must not be. Nothing is written but to a
temporary folder.
"""

import os
import re
import sys
import tempfile
from collections import Counter
from pathlib import Path

import papermill
from runner import ROOT

FEW = {"rods": 20, "sampled": 20}
SETTINGS = {
    "01": [{"degree": 4, "Ts": 2.0}, {"degree": 2, "Ts": 0.5}],
    "02": [{"Ts": 0.5, "R_s": 0.5}, {"degree": 1, "Q_o": 20.0, "R_o": 10.0}],
    "03": [
        {"M_max": 0.85, "order": 5, "L_max": 100.0},
        {"n_Q": 4, "cutoff": 0.08, "frequencies": 300},
    ],
    "04": [{"trials": 5, "samples": 1000}, {"first_disturbed": 9, "M_max": 0.85}],
    "05": [{"unmeasured": []}, {"unmeasured": ["theta_a", "Q2"]}],
    "06": [{"samples": 1500, "rest": 30}, {"M_max": 0.85, "noise": 0.1, "rest": 0}],
    "07": [{"L_max": 5.0, "Ts": 2.0}, {"M_max": 0.85, "frequencies": 300}],
    "08": [
        {"L_max": 20.0, "noise": 0.1, "evaluations": 6, "seeds": 1},
        {"rest": 0, "frequencies": 40, "searched": 2, "evaluations": 6},
    ],
    "09": [FEW | {"spread": 0.3}, FEW | {"M_max": 0.85, "cutoff": 0.05}],
    "10": [{"trials": 2, "hours": 3.0}, {"amplitude": 2.0}],
    "11": [{"rest": 0, "seed": 2}, {"trials": 3, "rest": 40}],
    "12": [{"M_max": 0.85, "noise": 0.1}, {"L_max": 5.0}],
    "13": [
        {"drawn": 20, "seed": 2, "draws": 2, "records": 1},
        {"cutoff": 0.08, "draws": 2, "records": 2},
    ],
    "14": [{"limit": 24.0, "trials": 4}, {"trials": 5, "rest": 0}],
    "15": [{"trials": 2, "cells": 48}, {"M_max": 0.6, "L_max": 200.0, "heat": 0.0}],
    "16": [{"trials": 3, "hours": 4.0}, {"trials": 4, "stronger": 12.0}],
    "17": [{"noise": 0.0, "trials": 3}, {"lag": 10.0, "noise": 0.1, "varying": 4}],
    "18": [{"noise": 0.05}, {"draws": 2}],
    "19": [{"sigma": 0.1}, {"rest": 0}],
}
SENTENCES = {"ValueError", "InfeasibleError"}
WAYS = ("to the end", "in a sentence", "in a traceback")


def run(path: Path, parameters: dict) -> tuple[str, str]:
    """How a notebook ends with these parameters, and what it says then."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["RODLIB_RESULTS"] = folder
        quiet = {"progress_bar": False, "log_output": False}
        try:
            papermill.execute_notebook(
                path, Path(folder) / path.name, parameters, cwd=path.parent, **quiet
            )
        except papermill.PapermillExecutionError as error:
            ends = WAYS[1] if is_a_sentence(error) else WAYS[2]
            return ends, f"cell {error.exec_count}: {error.ename}: {error.evalue}"
    return WAYS[0], ""


def is_a_sentence(error: papermill.PapermillExecutionError) -> bool:
    """Whether an error was raised by our code or by the notebook itself, and not further in."""
    raised = re.sub(r"\x1b\[[\d;]*m", "", "".join(error.traceback[-2:]))
    ours = re.search("rodlib|ilctools", raised) or re.search(r"-> +\d+ +raise ValueError", raised)
    return error.ename in SENTENCES and bool(ours)


def main() -> bool:
    """Run all settings of the notebooks; whether any run ends in a traceback."""
    counts = Counter()
    for number, settings in SETTINGS.items():
        (path,) = (ROOT / "notebooks").glob(f"{number}-*.ipynb")
        for parameters in settings:
            ends, said = run(path, parameters)
            counts[ends] += 1
            words = ", ".join(f"{name} = {value}" for name, value in parameters.items())
            print(f"{path.stem}, {words}: {ends}. {said}".rstrip(), flush=True)
    print(", ".join(f"{counts[way]} end {way}" for way in WAYS))
    return counts[WAYS[2]] > 0


if __name__ == "__main__":
    sys.exit(main())
