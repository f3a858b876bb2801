"""Does it work the whole way? Ten kinds of plants, from a model or a table to a log.

`make measure WHAT=whole_way` runs it and writes its table to figures/performance.md. The way is the
same for all: a design, its check on the linear plant of the rig, trials into a log, a replay of the
log. It is well if the trials learn, or if a warning or an error for the user says why not. A
failure is what does neither: silence, an error of another kind, a log that does not replay.
"""

import tempfile
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
from kinds import KINDS, Driver
from runner import publish, run, table

from ilctools import InfeasibleError, load_log, record, replay, synthesise, zero_phase_butterworth
from ilctools.errors import RigError
from ilctools.trials.rms import rms

TRIALS = 10
OFF = (1.0, 3.0)  # how far the rigs are off: by some ten percent, and by three times that
LEARNED, LOUD = 1 / 3, 2.0  # of the first RMS; or times the noise of the sensors
NUMBERS = [
    "off", "channels", "Ts (s)", "rate promised", "on the rig", "RMS of trial 1", "of the last",
    "noise",
]  # fmt: skip
WORSE = 3.0  # times the best RMS, or the noise: what got worse again has not learned


def go(row, kind, path, trials):
    """The whole way of one kind; each result goes into the row at once."""
    loop, reference, channels = kind.loop, kind.reference, len(kind.loop.outputs)
    row |= {"channels": channels, "Ts (s)": loop.Ts, "noise": kind.bench.noise * np.sqrt(channels)}
    Q = zero_phase_butterworth(2, kind.cutoff, loop.Ts)
    design = synthesise(kind.given, Q)
    row["rate promised"] = design.certificate.all_M
    try:
        row["on the rig"] = design.check(kind.P).rate
    except ValueError as error:  # no loop that is stable
        row["said"].append(f"{error}")
    log = record(Driver(kind), loop, design.law(), reference, trials=trials, path=path)
    row["rms"] = rms(log.e).values
    if not replay(load_log(path)).departure.values.max() <= 1e-9 * np.abs(log.v.values).max():
        row["failure"] = "the log departs from its law"


def outcome(name, off, trials=TRIALS):
    """How one kind ends: a row of the table."""
    row = {"kind": name, "off": off, "said": []}
    with warnings.catch_warnings(record=True) as raised, tempfile.TemporaryDirectory() as folder:
        warnings.simplefilter("always")
        try:
            go(row, KINDS[name](off), Path(folder) / "log.csv", trials)
        except (InfeasibleError, RigError) as error:
            row["said"].append(f"{error}")
        except Exception as error:
            row["failure"] = f"{type(error).__name__}: {error}"
    row["said"] += [f"{warning.message}" for warning in raised]
    return row | {"end": end_of(row)}


def end_of(row):
    """Whether the trials learned, or somebody said why not; else what went wrong."""
    if "failure" in row:
        return row["failure"]
    x, noise = row.get("rms", np.array([np.inf])), row.get("noise", 0.0)
    learned = x[-1] < max(LEARNED * x[0], LOUD * noise)
    if learned and x[-1] < WORSE * max(x.min(), noise):
        return "learned"
    return "said so" if row["said"] else "silent"


def table_of(rows):
    """The rows as a table in Markdown."""
    lines = []
    for row in rows:
        x = row.get("rms", [np.nan])
        row |= {"RMS of trial 1": x[0], "of the last": x[-1]}
        numbers = [row.get(title, np.nan) for title in NUMBERS]
        cells = [f"{value:.3g}" if np.isfinite(value) else "none" for value in numbers]
        lines.append([row["kind"], *cells, "yes" if row["said"] else "", row["end"]])
    return table(["kind", *NUMBERS, "warned", "end"], lines)


def main(ways=tuple((name, off) for off in OFF for name in KINDS)):
    """The table goes to figures/performance.md."""
    rows = list(run(outcome, ways))
    ends = Counter(row["end"] for row in rows)
    counts = ", ".join(f"{count} {end}" for end, count in ends.most_common())
    publish("whole_way", f"{table_of(rows)}\n\n{len(rows)} ways: {counts}.\n")


if __name__ == "__main__":
    main()
