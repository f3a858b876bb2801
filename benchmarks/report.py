"""Turn the benchmark's results into the table of figures/performance.md."""

import json
import sys

from runner import publish, table

LABELS = {
    "structured": "structured",
    "everywhere": "structured, bounds at every frequency",
    "cvxpy": "CVXPY, batched",
    "naive": "CVXPY, one `sigma_max` per frequency",
}
METHODS = ["problem (39)", "frequencies", "solver", "time (s)", "ratio", "memory (MB)"]


def compared(group, rows):
    """Rows of the table of methods, the fastest first."""
    structured = next(time for name, time, _ in rows if name == "structured")
    for name, time, memory in sorted(rows, key=lambda row: row[1]):
        numbers = f"{time:.2f}", f"{time / structured:.3g}", f"{memory:.0f}"
        yield [*group.split(", "), LABELS[name], *numbers]


def main(path):
    with open(path, encoding="utf-8") as file:
        report = json.load(file)
    groups = {}
    for entry in report["benchmarks"]:
        extra = entry["extra_info"]
        row = extra["x"], entry["stats"]["min"], extra["memory"]
        groups.setdefault(entry["group"], []).append(row)
    methods = [row for group, rows in groups.items() for row in compared(group, rows)]
    machine = report["machine_info"]
    cpu = machine["cpu"]
    text = f"""{table(METHODS, methods)}

Measured on: {cpu.get("brand_raw", machine["machine"])}, {cpu.get("count", "?")} cores, \
Python {machine["python_version"]}.
"""
    publish("performance", text)


if __name__ == "__main__":
    main(sys.argv[1])
