"""The ledger compares what the paper prints with what is computed here, and gives verdicts.

A number is *reproduced* if it agrees within its tolerance, half a unit of the last printed digit. A
statement is *reproduced* if the number that tests it meets its criterion, which is ours. Otherwise
the number or the statement *differs*. Tolerance and criterion share one column. A statement too
vague for a criterion is *in words*: its row says how far the statement holds.

Words are judged alike in both directions. "Small", "little" and "approximately" hold below a tenth,
fail above a third, and are in words in between. If a claim depends on a choice of ours, the claim
is in words, whatever its number is. The choice may be an initial condition, a reference found by
search, one of several optimal filters, a signal or a rig. A claim is in words, too, if its verdict
changes when the signals and rigs that we assume are varied. Its row then has the range of the
number. If our rigs disagree, the row cannot be checked.

The verdicts are counted by kind:

- numbers that the paper *prints*;
- numbers *derived* from printed ones, where the entries depend on coordinates;
- statements that the paper's model and design decide;
- statements that only assumed signals or an assumed rig can test;
- *misprints*.

Rows that could hardly differ are not counted: parameters *taken over* from the paper, and each
*identity*. An identity is imposed, or is algebra, or follows from another row: a double zero
counts once.

A number is shown to the last digit that the paper prints. A number that tests a statement in words
has five significant digits. Each number is judged as it is shown. More digits would not say more
about the agreement, and the coefficients of a flat optimum are not determined further. If rounding
moves numbers by one unit of the last digit shown, the ledger does not change.
"""

import json
from operator import eq, gt, le, lt
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from ilctools.files import folder, write_pieces, write_whole
from rodlib.paper import published
from rodlib.paper.comparison import different_figures, same_text
from rodlib.paper.published import Claim
from rodlib.paper.repository import ROOT, results

REPRODUCED, DIFFERS = "reproduced", "differs"
IN_WORDS, UNCHECKED = "in words", "cannot be checked"
OTHER = "not the paper's parameters"
VERDICTS = (REPRODUCED, DIFFERS, IN_WORDS, UNCHECKED)
DEVIATIONS = Path(__file__).with_name("deviations.md")
SENTENCE_PREFIX = "words: "  # begins a criterion that is a sentence with a place for the number
KINDS = {
    "printed": "printed numbers",
    "derived": "invariants of the feedback gains, for 40 printed entries",
    "coefficient": "coefficients of (39), a flat optimum",
    "statement": "statements about model and design",
    "assumed": "statements on signals or rigs of ours",
    "misprint": "misprints",
    "taken over": "taken over; could hardly differ",
    "identity": "imposed or algebra; could hardly differ",
}
LEAST_SHOWN = 1e-9  # smaller numbers are rounding, and differ between machines
BELOW_LEAST = f"below {LEAST_SHOWN:g}"
SIGNIFICANT = 5  # digits, for a number that tests a statement in words
TABLE = ["claim", "printed", "computed", "deviation", "verdict"]  # columns that a notebook shows
COUNTED = {  # what could have differed, as the README says it
    "printed": "printed numbers",
    "derived": "invariants of the 40 printed entries of the feedback gains",
    "coefficient": "coefficients of the flat optimum of (39)",
    "statement": "statements about the model and the design",
    "assumed": "statements about assumed signals or rigs",
}
COMPARE = {"<": lt, "<=": le, ">": gt, "==": eq}
COLUMNS = [
    "key", "place", "claim", "printed", "computed", "tolerance", "deviation", "verdict", "kind",
    "note", "notebook", "cell",
]  # fmt: skip


class Rule(NamedTuple):
    """How a number is judged: by its relation to a bound, or by its distance from a number."""

    number: float
    tolerance: float = 0.0
    relation: str = ""  # to the number, a key of COMPARE; "": within the tolerance


def rule(claim: Claim) -> Rule:
    """Return the rule that judges the number of a claim."""
    if not claim.criterion:
        return Rule(published.value(claim.printed), published.half_unit(claim.printed))
    if " +- " in claim.criterion:
        return Rule(*map(float, claim.criterion.split(" +- ")))
    relation, bound = claim.criterion.split()
    return Rule(float(bound), relation=relation)


def verdict(claim: Claim, computed: float) -> tuple[str, float]:
    """Return the verdict, and the deviation from the printed number or from a failed criterion."""
    number, tolerance, relation = rule(claim)
    deviation = computed - number
    if relation:
        return (REPRODUCED, 0.0) if COMPARE[relation](deviation, 0) else (DIFFERS, deviation)
    agrees = abs(deviation) <= tolerance * (1 + 1e-9)
    return REPRODUCED if agrees else DIFFERS, deviation


def judged(claim: Claim, computed: float) -> dict[str, str]:
    """Return the entries of a row for a computed number."""
    if claim.criterion == UNCHECKED:
        return {"verdict": UNCHECKED}
    value = float(computed)
    if claim.criterion.startswith(SENTENCE_PREFIX):
        sentence = claim.criterion.removeprefix(SENTENCE_PREFIX).format(f"{value:.3g}")
        return {"computed": sentence, "verdict": IN_WORDS}
    text = shown(claim, value)
    outcome, deviation = verdict(claim, value if text == BELOW_LEAST else float(text))
    tolerance = rule(claim).tolerance
    return {
        "computed": text,
        "tolerance": f"± {tolerance:.2g}" if tolerance else claim.criterion,
        "deviation": f"{deviation:.1e}" if abs(deviation) > LEAST_SHOWN else "",
        "verdict": outcome,
    }


def shown(claim: Claim, value: float) -> str:
    """Return a computed number as text, with as many digits as the paper prints."""
    if 0 < abs(value) <= LEAST_SHOWN:
        return BELOW_LEAST
    places = published.decimals(claim.printed)
    return f"{value:z.{SIGNIFICANT}g}" if places is None else f"{value:z.{places}f}"


class Ledger:
    """The rows of the ledger that one notebook computes.

    As soon as such an object is made, pandas shows whole sentences in the notebook. `parameters`
    are the notebook's parameters that the paper prints, by key. If a parameter is not exactly the
    paper's, no row gets a verdict.
    """

    def __init__(self, notebook: str, **parameters):
        pd.set_option("display.max_colwidth", None, "display.max_rows", None, "display.width", 200)
        self.notebook, self.rows, claims = notebook, {}, published.claims()
        self.papers_parameters = all(
            value == published.value(claims[key].printed)  # a chosen value has no rounding
            for key, value in parameters.items()
        )

    def record(self, key: str, computed=None) -> None:
        """Record the computed value of a claim, or of a printed matrix, by its key or name.

        A matrix has the shape of :func:`rodlib.paper.published.matrix`. None stands for a claim
        that cannot be checked.
        """
        if key in published.PRINTED_MATRICES:
            for entry, name in np.ndenumerate(published.keys(key)):
                if name:
                    self.record(name, computed[entry])
            return
        claim = published.claims()[key]
        unit = f" ({claim.unit})" if claim.unit else ""
        said = {"claim": claim.claim + unit} | judged(claim, computed)
        row = dict.fromkeys(COLUMNS, "") | vars(claim) | said
        if not self.papers_parameters and row["verdict"] != UNCHECKED:
            row["verdict"] = OTHER
        self.rows[key] = row

    def table(self) -> pd.DataFrame:
        """Return the rows recorded so far, differing rows first, each part in the paper's order."""
        return differing_first(self.frame()).set_index("place")[TABLE]

    def save(self) -> None:
        """Write the rows to build/ledger, or to the folder of the run that joins all rows."""
        path = folder(results("Ledger.save") / "ledger") / f"{self.notebook}.csv"
        notebook = ROOT / "notebooks" / f"{self.notebook}.ipynb"
        cell = json.loads(notebook.read_text("utf-8"))["cells"][-1]["id"]  # the last one records
        rows = self.frame().assign(notebook=self.notebook, cell=cell)
        write_whole(path, rows.to_csv(index=False, lineterminator="\n"))

    def frame(self) -> pd.DataFrame:
        """Return the rows recorded so far, in the order of the paper."""
        rows = [self.rows[key] for key in published.claims() if key in self.rows]
        return pd.DataFrame(rows, columns=COLUMNS)


def differing_first(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows in their order, with the rows that differ before all others."""
    return rows.sort_values("verdict", key=lambda verdicts: verdicts != DIFFERS, kind="stable")


def join(parts: Path) -> pd.DataFrame:
    """Join the rows of all notebooks, one CSV file each, in the order of the paper.

    Each claim has one row. A claim with two rows raises a ValueError, and a claim without a row
    raises a KeyError. Both errors name the claim.
    """
    rows = pd.concat([*map(read, sorted(parts.glob("*.csv")))], verify_integrity=True)
    return rows.loc[list(published.claims())]


def read(path):
    """Read the rows of a CSV file as text, by key."""
    return pd.read_csv(path, index_col="key", dtype=str, keep_default_na=False)


def summary(rows: pd.DataFrame) -> str:
    """Return the text for the README, which says how many claims agree and which differ.

    Only claims that could differ count.
    """
    counts, lines = counted(rows), []
    for name, what in COUNTED.items():
        agree, differ = counts.loc[name, [REPRODUCED, DIFFERS]]
        keys = rows.key[(rows.kind == name) & (rows.verdict == DIFFERS)]
        linked = "[`{0}`](figures/ledger.md#{0})".format
        names = ", ".join(map(linked, keys)) if name != "coefficient" else ""
        which = f" These do not agree: {names}." if names else ""
        lines.append(f"- {agree} of {agree + differ} {what} agree.{which}\n")
    vague, unchecked = counts[IN_WORDS].drop("misprint").sum(), counts[UNCHECKED].sum()
    last = f"- {vague} statements are too vague for a verdict, or depend on a choice of ours.\n"
    last += f"- {unchecked} statements cannot be checked.\n"
    if other := sum(rows.verdict == OTHER):
        last += f"- {OTHER}, and so not judged: {other}\n"
    return "".join([*lines, last])


def counted(rows: pd.DataFrame) -> pd.DataFrame:
    """Count the claims of each kind by verdict."""
    counts = pd.crosstab(rows.kind, rows.verdict)
    return counts.reindex(index=KINDS, columns=VERDICTS, fill_value=0)


def markdown(rows: pd.DataFrame) -> str:
    """Return the ledger as a readable page, with our deviations from the paper."""
    rows = differing_first(rows)
    notes = "<br>*" + rows.place + rows.note.map(lambda note: note and f". {note}") + "*"
    cells = "](../notebooks/" + rows.notebook + ".ipynb#cell-id=" + rows.cell + ")"
    columns = {
        "key": '<a id="' + rows.key + '"></a>`' + rows.key + "`",
        "claim": rows.claim + notes,
        "printed or criterion": rows.printed + " " + rows.tolerance,
        "computed": rows.computed,
        "verdict": "[" + rows.verdict + cells,
    }
    table = pd.DataFrame(columns).replace({r"\|": r"\|"}, regex=True)
    hardly = ~rows.kind.isin([*COUNTED, "misprint"]) & (rows.verdict != DIFFERS)
    first, folded = (
        part.to_markdown(index=False, disable_numparse=True)
        for part in (table[~hardly], table[hardly])
    )
    counts = counted(rows).rename(index=KINDS).rename_axis("")
    return f"""# Printed against computed

`make reproduce` writes this page. A row has one of these verdicts:

- *Reproduced*: the number is within its tolerance, half a unit of the last printed digit. Or the
  statement meets its criterion, which is ours.
- *Differs*: the number is not within its tolerance, or the statement does not meet its criterion.
- *In words*: the statement is too vague for a criterion, or the verdict hangs on a choice of ours.
  The row says how far the statement holds. The choice may be an initial condition, a search, one of
  several optimal filters, a signal or a rig. If a verdict changes when we vary the signals and rigs
  that we assume, the row has the range of the number ([performance](performance.md)).
- *Cannot be checked*: the data are not published, or our rigs disagree.

"Small", "little" and "approximately" hold below a tenth and fail above a third. *Derived* numbers
are products of printed gains that do not depend on the coordinates of the state: ten numbers for 40
entries. A parameter *taken over* from the paper could hardly differ. The same is true for an
*identity*, which is imposed, or is algebra, or follows from another row.

{counts.to_markdown()}

## Deviations from the paper

{DEVIATIONS.read_text(encoding="utf-8")}
## What could have differed, what differs first

Each verdict leads to the cell that computes the number.

{first}

## What is taken over or imposed

<details><summary>Rows that could hardly differ</summary>

{folded}

</details>
"""


def splice(text: str, name: str, content: str) -> str:
    """Replace the text between the two markers `name` in a Markdown text."""
    begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
    before, _, rest = text.partition(begin)
    _, found, after = rest.partition(end)
    if not found:
        raise ValueError(f"the text has no markers {begin.strip()} and {end}")
    return before + begin + content + end + after


def publish(build: Path, root: Path) -> None:
    """Copy what a complete run has changed to figures/ and the README.

    If the copy is interrupted, git can restore the files.
    """
    for name in changed(build, root):
        write_pieces(root / name, [(build / name).read_bytes()])


def changed(build: Path, root: Path) -> list[str]:
    """Print and return the names of the files that a run has visibly changed.

    The texts are written to `build`, under their names in the repository. If a reader cannot
    distinguish the computed numbers from the tracked ones, the tracked numbers are kept.
    """
    rows, tracked = join(build / "ledger"), read(root / "figures" / "ledger.csv")
    if same_text(*(table[["computed", "verdict"]].to_csv() for table in (rows, tracked))):
        rows = rows.assign(**tracked[["computed", "deviation"]])
    rows = rows.reset_index()[COLUMNS]
    texts = {
        "figures/ledger.csv": rows.to_csv(index=False, lineterminator="\n"),
        "figures/ledger.md": markdown(rows),
        "README.md": splice((root / "README.md").read_text("utf-8"), "ledger", summary(rows)),
    }
    drawn = build / "figures"
    different = different_figures(drawn, root / "figures")
    files = (path for name in different for path in sorted(drawn.glob(f"{name}.*")))
    names = [f"figures/{path.name}" for path in files]
    for name, text in texts.items():
        write_whole(build / name, text)
        if text.encode() != (root / name).read_bytes():
            names.append(name)
    print(f"different: {', '.join(names)}" if names else "all is the same as before")
    return names
