"""Turn the benchmark's results into the tables and the picture of figures/performance."""

import json
import shutil
import sys

import matplotlib.pyplot as plt
import numpy as np
from runner import ROOT, publish, table

from rodlib.paper import figures

LABELS = {
    "neighbour": "structured, from the optimum for L_max = 45",
    "structured": "structured",
    "everywhere": "structured, bounds at every frequency",
    "cvxpy": "CVXPY, batched",
    "naive": "CVXPY, one `sigma_max` per frequency",
}
METHODS = ["problem (39)", "frequencies", "solver", "time (s)", "ratio", "memory (MB)"]
GROWTH = ["growing", "from", "to", "time (s)", "exponent of time, upper half"]
CAPTION = "Time of the synthesis over what it grows with; gray: the power law of the upper half."


def compared(group, rows):
    """Rows of the table of methods, the fastest first."""
    structured = next(time for name, time, _ in rows if name == "structured")
    for name, time, memory in sorted(rows, key=lambda row: row[1]):
        numbers = f"{time:.2f}", f"{time / structured:.3g}", f"{memory:.0f}"
        yield [*group.split(", "), LABELS[name], *numbers]


def drawn(axes, name, rows):
    """Draw how the time grows; a row of the table of growth."""
    x, time, memory = np.array(sorted(rows)).T
    # below, what does not grow with the problem counts
    upper = slice(len(x) // 2, None)
    slope, offset = np.polyfit(np.log(x[upper]), np.log(time[upper]), 1)
    line = np.exp(offset) * x[upper] ** slope
    axes.loglog(x, time, "o", color="black")
    axes.loglog(x[upper], line, label=f"exponent {slope:.1f}", **figures.GRAY)
    axes.set(xlabel={"order": "filter order", "size": "size m"}.get(name, name))
    axes.set_xticks(x, [f"{value:g}" for value in x], rotation=45)
    axes.minorticks_off()
    axes.legend()
    seconds = f"{time[0]:.2f} to {time[-1]:.2f}"
    megabytes = f"{memory[0]:.0f} to {memory[-1]:.0f}"
    return [name, f"{x[0]:g}", f"{x[-1]:g}", seconds, f"{slope:.1f}", megabytes]


def main(path):
    with open(path, encoding="utf-8") as file:
        report = json.load(file)
    groups = {}
    for entry in report["benchmarks"]:
        extra = entry["extra_info"]
        row = extra["x"], entry["stats"]["min"], extra["memory"]
        groups.setdefault(entry["group"], []).append(row)
    growing = {name: rows for name, rows in groups.items() if "," not in name}
    methods = [
        row
        for group, rows in groups.items()
        if group not in growing
        for row in compared(group, rows)
    ]
    figure, axes = plt.subplots(1, len(growing), figsize=figures.WIDE, sharey=True)
    growth = [
        drawn(column, name, rows)
        for column, (name, rows) in zip(axes, growing.items(), strict=True)
    ]
    axes[0].set_ylabel("time (s)")
    picture = figures.save(figure, "performance", CAPTION).path
    for path in (picture, picture.with_suffix(".pdf")):
        shutil.copy(path, ROOT / "figures")
    machine = report["machine_info"]
    cpu = machine["cpu"]
    text = f"""{table(METHODS, methods)}

{table([*GROWTH, METHODS[-1]], growth)}

Measured on: {cpu.get("brand_raw", machine["machine"])}, {cpu.get("count", "?")} cores, \
Python {machine["python_version"]}.

![Time of the synthesis over its size](performance.png)
"""
    publish("performance", text)
    print(text)


if __name__ == "__main__":
    plt.style.use("rodlib.paper.style")
    main(sys.argv[1])
