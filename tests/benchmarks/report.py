"""Turn the benchmark's results into the tables and the picture of figures/performance."""

import json
import sys

import matplotlib.pyplot as plt
import numpy as np

from rodlib.ilc.files import replace_all
from rodlib.paper import figures
from rodlib.paper.ledger import splice
from rodlib.paper.repository import checkout

LABELS = {
    "neighbour": "structured, from the optimum for L_max = 45",
    "structured": "structured",
    "everywhere": "structured, bounds at every frequency",
    "threads": "structured, where BLAS has a thread for each core",
    "all": "structured, all bounds at once",
    "cvxpy": "CVXPY, batched",
    "naive": "CVXPY, one `sigma_max` per frequency",
}
CAPTION = "Time of the synthesis over what it grows with; gray: the power law of the upper half."


def main(path):
    try:
        root = checkout("tests/benchmarks/report.py")
    except RuntimeError as error:
        sys.exit(str(error))
    with open(path, encoding="utf-8") as file:
        report = json.load(file)
    groups = {}
    for entry in report["benchmarks"]:
        row = (
            entry["extra_info"]["x"],
            entry["stats"]["min"],
            entry["extra_info"]["memory"],
        )
        groups.setdefault(entry["group"], []).append(row)

    lines = ["| problem (39) | frequencies | solver | time (s) | ratio | memory (MB) |"]
    lines += ["|---|---:|---|---:|---:|---:|"]
    for group in [name for name in groups if "," in name]:
        rows = groups.pop(group)
        structured = next(time for name, time, _ in rows if name == "structured")
        for name, time, memory in sorted(rows, key=lambda row: row[1]):
            cells = [*group.split(", "), LABELS[name], f"{time:.2f}"]
            cells += [f"{time / structured:.3g}", f"{memory:.0f}"]
            lines.append(f"| {' | '.join(cells)} |")
    lines += [
        "",
        "| growing | from | to | time (s) | exponent of time, upper half | memory (MB) |",
    ]
    lines += ["|---|---:|---:|---:|---:|---:|"]
    trials = dict(row[:2] for row in groups.pop("trials"))
    designs = dict(row[:2] for row in groups.pop("alternatives"))
    figure, axes = plt.subplots(1, len(groups), figsize=figures.WIDE, sharey=True)
    for column, (name, rows) in zip(axes, groups.items(), strict=True):
        x, time, memory = np.array(sorted(rows)).T
        upper = slice(
            len(x) // 2, None
        )  # below, what does not grow with the problem counts
        slope, offset = np.polyfit(np.log(x[upper]), np.log(time[upper]), 1)
        lines.append(
            f"| {name} | {x[0]:g} | {x[-1]:g} | {time[0]:.2f} to {time[-1]:.2f} | {slope:.1f} | "
            f"{memory[0]:.0f} to {memory[-1]:.0f} |"
        )
        column.loglog(x, time, "o", color="black")
        line = np.exp(offset) * x[upper] ** slope
        column.loglog(x[upper], line, label=f"exponent {slope:.1f}", **figures.GRAY)
        column.set(xlabel={"order": "filter order", "size": "size m"}.get(name, name))
        column.set_xticks(x, [f"{value:g}" for value in x], rotation=45)
        column.minorticks_off()
        column.legend()
    axes[0].set_ylabel("time (s)")
    machine, python = report["machine_info"], report["machine_info"]["python_version"]
    cpu = machine["cpu"].get("brand_raw", machine["machine"])
    ratio = trials["one_by_one"] / trials["judged"]
    lines += [
        "",
        f"A study of many rods is {ratio:.0f} times as fast, rod by rod, as",
    ]
    lines += [
        "a loop over `run_trials`, which counts neither the rates nor the unstable poles."
    ]
    lines += [
        "",
        "A filter of another design, and its first use on a trial of 2500 samples:",
    ]
    lines += [", ".join(f"{name} {time:.3f} s" for name, time in designs.items()) + "."]
    lines += [
        "",
        f"Measured on: {cpu}, {machine['cpu'].get('count', '?')} cores, Python {python}.",
    ]
    saved = figures.save(figure, "performance", CAPTION).path
    pdf = saved.with_suffix(".pdf")
    lines += ["", "![Time of the synthesis over its size](performance.png)"]
    text = "\n".join(lines) + "\n"
    target = root / "figures"
    page = (target / "performance.md").read_text(encoding="utf-8")
    new = {target / path.name: path.read_bytes() for path in (saved, pdf)}
    new[target / "performance.md"] = splice(page, "performance", text).encode()
    replace_all(new)
    print(text)


if __name__ == "__main__":
    plt.style.use("rodlib.paper.style")
    main(sys.argv[1])
