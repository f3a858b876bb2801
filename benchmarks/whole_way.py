"""Does it work the whole way? Ten kinds of plants, from a model or a table to a log.

`make measure WHAT=whole_way` runs it and writes its table to figures/performance.md; `whole_way.py
furnace 5` shows one kind with a rig that is further off, and all that is said. The way is the same
for all: a design, its check on the linear plant of the rig, trials into a log by a driver that dies
in the middle, the rest of them by another one, a replay of the log. It is well if the trials learn,
or if a warning or an error that is known says why not. A failure is what does neither: silence, an
error that nobody meant for a user, a log that does not go on or replay.
"""

import sys
import tempfile
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
from kinds import KINDS, DeadError, driver
from runner import publish, run, table

from ilctools import (
    ClosedLoop,
    InfeasibleError,
    load_log,
    record,
    replay,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.rigs.protocol import RigError
from ilctools.trials.run import rms

TRIALS, DIES = 10, 0.55  # trials, and after what share of them the first driver dies
# how far the rigs are off: by some ten percent, and by three times that
OFF = (1.0, 3.0)
LEARNED, LOUD = 1 / 3, 2.0  # of the first RMS; or times the noise of the sensors
WORSE = 3.0  # times the best RMS, or the noise: what got worse again has not learned
WELL = {"learned", "said so"}
SAYS = {  # what a warning or an error says, in a word or two
    "beyond the limits": "limits", "more than noise": "error grows",
    "learning adds": "not repeating",
    "keeps growing": "v grows", "differs from the model": "not the model",
    "it starts": "start", "not back": "start", "of the error in the band": "learns little",
    "too coarse": "coarse", "may reach": "coarse", "not linear": "not linear",
    "drifts": "drift", "too far apart": "sparse", "differs from I": "no anchor",
    "nothing can be learned": "not known", "limits of stop": "stopped",
    "infeasible": "infeasible", "P is singular": "singular", "loop unstable": "unstable",
}  # fmt: skip


def rate_on_the_rig(kind, design):
    """The largest sigma_max(M) on the linear plant of the rig."""
    loop, plant = kind.loop, kind.linear or kind.bench
    if isinstance(loop, ClosedLoop):
        P = plant.linear(loop.Ts, loop.references, loop.outputs)
    else:
        plant = plant.linear(loop.Ts, loop.controls, loop.outputs)
        P = loop.around(plant)[:, : len(loop.outputs)]
    return design.check(P).gamma


def go(row, kind, path, trials):
    """The whole way of one kind; each result goes into the row at once."""
    loop, reference, channels = kind.loop, kind.reference, len(kind.loop.outputs)
    row |= {"channels": channels, "Ts": loop.Ts}
    row["noise"] = kind.bench.noise * np.sqrt(channels)
    Q = zero_phase_butterworth(2, kind.cutoff, loop.Ts)
    plant = loop if kind.P is None else kind.P
    design = synthesise(plant, Q)
    row |= {"promised": design.certificate.all_M, "design": f"{design}"}
    try:
        row["on the rig"] = rate_on_the_rig(kind, design)
    except ValueError as error:  # no loop that is stable
        row["said"].append(f"{error}")
    law = design.law()

    def recorded(dies=np.inf, path=path):
        rig = driver(kind, dies)
        return record(rig, loop, law, reference, trials=trials, path=path)

    try:
        recorded(DIES * trials * len(reference))
    except DeadError:
        row["kept"] = load_log(path).sizes["trial"]
    log = recorded()
    row["rms"] = rms(log.e).values
    replayed = replay(load_log(path))
    row["summary"] = repr(replayed)
    if not replayed.departure.values.max() <= 1e-9 * np.abs(log.v.values).max():
        row["failure"] = "the log departs from its law"
    if kind.homes and not np.array_equal(recorded(path=None).y, log.y):
        row["failure"] = "gone on with, it is another experiment"
    if not 0 < row.get("kept", 0) < trials:
        row["failure"] = "the driver did not die in the middle"


def in_short(text):
    """What a warning or an error says, in a word or two; "?" if it is none that is known."""
    return next((short for long, short in SAYS.items() if long in text), "?")


def outcome(name, off=1.0, trials=TRIALS):
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
    row["words"] = list(dict.fromkeys(map(in_short, row["said"])))
    return row | {"end": end_of(row)}


def end_of(row):
    """Whether the trials learned, or somebody said why not; else what went wrong."""
    if "failure" in row or "?" in row["words"]:
        return row.get("failure", "said what is not known")
    x, noise = row.get("rms", np.array([np.inf])), row.get("noise", 0.0)
    learned = x[-1] < max(LEARNED * x[0], LOUD * noise)
    if learned and x[-1] < WORSE * max(x.min(), noise):
        return "learned"
    return "said so" if row["words"] else "silent"


def table_of(rows):
    """The rows as a table in Markdown."""
    titles = ["kind", "off", "channels", "Ts (s)", "rate promised", "on the rig", "RMS of trial 1",
              "of the last", "noise", "said", "end"]  # fmt: skip
    lines = []
    for row in rows:
        rig, x = row.get("on the rig", np.nan), row.get("rms", [np.nan])
        numbers = [row["off"], row["channels"], row["Ts"], row["promised"], rig]
        numbers += [x[0], x[-1], row["noise"]]
        cells = [f"{value:.3g}" if np.isfinite(value) else "none" for value in numbers]
        lines.append([row["kind"], *cells, ", ".join(row["words"]), row["end"]])
    return table(titles, lines)


def main(chosen):
    """Print the table, or all about one kind; the table goes to figures/performance.md."""
    if chosen:
        row = outcome(chosen[0], *map(float, chosen[1:]))
        parts = [row.get(key, "") for key in ("design", "summary")]
        print(*parts, *row["said"], f"{row}", sep="\n\n")
        return row["end"] not in WELL
    rows = list(run(outcome, [*KINDS] * 2, np.repeat(OFF, len(KINDS))))
    ends = Counter(row["end"] for row in rows)
    counts = ", ".join(f"{count} {end}" for end, count in ends.most_common())
    text = f"{table_of(rows)}\n\n{len(rows)} ways: {counts}.\n"
    print(text)
    publish("whole_way", text)
    return bool({*ends} - WELL)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
