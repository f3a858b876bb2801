"""The ledger: what the paper prints against what is computed here, and the verdict.

A number is *reproduced* if it agrees within its tolerance, half a unit of the last digit printed, a
statement if the number that tests it meets its criterion, which is ours; otherwise it *differs*.
Both stand in one column. A statement too vague for a criterion is *in words*: the row says how far
it holds. Words are judged alike in both directions. "Small", "little" and "approximately" hold
below a tenth, fail above a third, and are in words in between; so is, whichever way it comes out,
what hangs on a choice of ours: a start, a reference found by search, one of several optimal
filters. Where rigs of ours disagree, the row cannot be checked.

Counted apart, by kind: numbers that the paper *prints*; those *derived* from printed ones, where
the entries depend on coordinates; statements that its model and design decide, and statements that
only signals or a rig that we assume can test; *misprints*. Not counted is what could hardly differ:
parameters *taken over* from the paper; an *identity*, which is imposed, or algebra, or follows from
another row: a double zero counts once.

A number is shown to the last digit that the paper prints, one that tests a statement in words with
five significant digits, and with more only where the verdict would not follow from these: more
would say nothing about the agreement, and the coefficients of a flat optimum are not determined
further. Where rounding moves it by one unit of the last digit shown, the row stays as it is.
"""

import re
import sys
from collections.abc import Iterable
from operator import eq, ge, gt, le, lt
from pathlib import Path

import numpy as np
import pandas as pd

from ilctools.files import folder, read_json, replace_all, write_whole
from rodlib.paper import published
from rodlib.paper.comparison import DIFFERENT, GONE, NEW, SAME, compared, same_text
from rodlib.paper.published import Claim
from rodlib.paper.repository import ROOT, results

REPRODUCED, DIFFERS = "reproduced", "differs"
IN_WORDS, UNCHECKED = "in words", "cannot be checked"
OTHER = "not the paper's parameters"
VERDICTS = (REPRODUCED, DIFFERS, IN_WORDS, UNCHECKED)
DEVIATIONS = Path(__file__).with_name("deviations.md")
WORDS = "words: "  # begins a criterion that is a sentence with a place for the number
KINDS = {
    "printed": "printed numbers",
    "derived": "numbers derived from printed ones",
    "coefficient": "coefficients of (39), a flat optimum",
    "statement": "statements about model and design",
    "assumed": "statements on assumed signals or a virtual rig",
    "misprint": "misprints",
}
HEADLINE = """\
- **Numbers**: {printed} that could have differed come out as printed, and {derived}
  invariants of the feedback gains, which stand for 40 printed entries.
- **Learning filters**: {coefficient} coefficients agree to the last digit; the optimum is flat,
  and the printed ones reach it to a few millionths.
- **Statements**: {statement}
  that model and design decide hold; of those that only signals or rigs of ours can test,
  {assumed}; {vague} are too vague, or hang on choices of ours; {unchecked} cannot be checked.
"""
NOISE = 1e-9  # what is smaller is rounding, and not the same on two machines
SIGNIFICANT = 5  # digits of a number that tests a statement in words
PAGE = ["verdict", "claim", "printed", "computed", "tolerance", "kind", "place", "cell"]
COEFFICIENT = r"L_(?:diagonal|full)\["  # how the key of one of (39) begins
SAVED = r'\bsave\(\w+, "([^"]+)", caption\)'  # how a notebook saves a figure
COMPARE = {"<": lt, "<=": le, ">": gt, ">=": ge, "==": eq}
COLUMNS = [
    "key", "place", "claim", "printed", "computed", "tolerance", "deviation", "verdict", "kind",
    "note", "notebook", "cell",
]  # fmt: skip


def verdict(claim: Claim, computed: float) -> tuple[str, float]:
    """A verdict, and the deviation from the printed number, or from a criterion missed."""
    first, _, second = claim.criterion.partition(" ")
    if claim.criterion.startswith(WORDS):
        return IN_WORDS, 0.0
    if first in COMPARE:
        holds, expected = COMPARE[first](computed, float(second)), float(second)
        return (REPRODUCED, 0.0) if holds else (DIFFERS, float(computed - expected))
    if claim.criterion:  # "0.58 +- 0.01"
        expected, tolerance = float(first), float(second.removeprefix("+- "))
    else:
        expected = published.value(claim.printed)
        tolerance = published.half_unit(claim.printed) * (1 + 1e-9)
    deviation = computed - expected
    return REPRODUCED if abs(deviation) <= tolerance else DIFFERS, float(deviation)


class Ledger:
    """The rows of one notebook, by its name, in which pandas then shows whole sentences.

    If one of its parameters that the paper prints, by key, is not exactly the paper's, no row gets
    a verdict.
    """

    def __init__(self, notebook: str, **parameters):
        pd.set_option("display.max_colwidth", None, "display.max_rows", None, "display.width", 200)
        self.notebook = notebook
        self.rows = {}
        known = published.claims()
        self.papers_parameters = all(
            value == published.value(known[key].printed)  # a choice has no rounding
            for key, value in parameters.items()
        )

    def record(self, key: str, computed=None) -> None:
        """Enter what was computed for the claim `key`, or for a printed matrix of that name.

        A matrix has the shape that :func:`rodlib.paper.published.matrix` gives it; None stands for
        what cannot be checked.
        """
        if key in published.MATRICES:
            for entry, name in np.ndenumerate(published.keys(key)):
                if name:
                    self.record(name, computed[entry])
            return
        claim = published.claims()[key]
        outcome, shown, deviation = _judged(claim, computed)
        judged = self.papers_parameters or outcome == UNCHECKED
        self.rows[key] = {
            "key": key,
            "place": claim.place,
            "claim": claim.claim + (f" ({claim.unit})" if claim.unit else ""),
            "printed": claim.printed,
            "computed": shown,
            "tolerance": _tolerance(claim),
            "deviation": f"{deviation:.1e}" if abs(deviation) > NOISE else "",
            "verdict": outcome if judged else OTHER,
            "kind": claim.kind,
            "note": claim.note,
            "notebook": self.notebook,
            "cell": _running(),
        }

    def table(self, keys: Iterable[str] = ("",)) -> pd.DataFrame:
        """The rows recorded so far whose keys begin so, by default all: those that differ first."""
        keys = tuple(keys)
        chosen = [key for key in published.claims() if key in self.rows and key.startswith(keys)]
        rows = pd.DataFrame([self.rows[key] for key in chosen], columns=COLUMNS)
        rows = rows.sort_values("verdict", key=lambda verdict: verdict != DIFFERS, kind="stable")
        return rows.set_index("place")[["claim", "printed", "computed", "deviation", "verdict"]]

    def save(self) -> None:
        """Write the rows to build/ledger, or to the folder of the run, which joins them."""
        rows = pd.DataFrame(self.rows.values(), columns=COLUMNS)
        ids = [cell["id"] for cell in _code(self.notebook)]
        rows["cell"] = rows.cell.map(dict(enumerate(ids, start=1)))
        path = folder(results("Ledger.save") / "ledger") / f"{self.notebook}.csv"
        write_whole(path, rows.to_csv(index=False, lineterminator="\n"))


def _running():
    """The number of the code cell that runs; 0 outside a notebook."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    return len(shell.user_ns["In"]) - 1 if shell else 0


def _code(notebook):
    """The code cells of a tracked notebook, by its name; none of another."""
    path = ROOT / "notebooks" / f"{notebook}.ipynb"
    cells = read_json(path.read_text("utf-8"))["cells"] if path.exists() else []
    return [cell for cell in cells if cell["cell_type"] == "code"]


def _link(notebook, cell):
    """Where JupyterLab, and a page, show a cell; the notebook, elsewhere."""
    return f"[{notebook}](../notebooks/{notebook}.ipynb#cell-id={cell})"


def _figures():
    """A line of Markdown for each figure, with the cell that saves it."""
    lines = []
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        for cell in _code(path.stem):
            for name in re.findall(SAVED, "".join(cell["source"])):
                lines.append(f"- [{name}]({name}.png): {_link(path.stem, cell['id'])}")
    return "\n".join(sorted(lines))


def _tolerance(claim):
    """By what a row is judged: a criterion, or how far a number may be off; "" if it is not."""
    expected, _, tolerance = claim.criterion.partition(" +- ")
    if not expected or tolerance:
        return f"± {float(tolerance or published.half_unit(claim.printed)):.2g}"
    return "" if expected[0].isalpha() else expected


def _judged(claim, computed):
    """The verdict, the number as it is shown, and by how much that deviates."""
    if claim.criterion == UNCHECKED:
        return UNCHECKED, "", 0.0
    value = float(computed)
    outcome, deviation = verdict(claim, value)
    if outcome == IN_WORDS:
        return IN_WORDS, claim.criterion.removeprefix(WORDS).format(f"{value:.3g}"), 0.0
    if 0 < abs(value) <= NOISE:
        return outcome, f"below {NOISE:g}", deviation
    digits, notation = published.decimals(claim.printed), "f"
    if digits is None:
        digits, notation = SIGNIFICANT, "g"
    shown = f"{value:z.{digits}{notation}}"
    while verdict(claim, float(shown))[0] != outcome:
        digits += 1
        shown = f"{value:z.{digits}{notation}}"
    return outcome, shown, verdict(claim, float(shown))[1]


def join(parts: Path) -> pd.DataFrame:
    """The rows of all notebooks, a CSV file each, in the order of the paper: one for each claim.

    A claim with two rows is a ValueError, one without a row a KeyError; both name it.
    """
    tables = [pd.DataFrame(columns=COLUMNS)]
    for path in sorted(parts.glob("*.csv")):
        tables.append(pd.read_csv(path, dtype=str, keep_default_na=False))
    rows = pd.concat([table.set_index("key") for table in tables], verify_integrity=True)
    return rows.loc[list(published.claims())].reset_index()[COLUMNS]


def summary(rows: pd.DataFrame) -> str:
    """What the README says of the results: of each kind how many agree, and which do not."""
    kind, texts = _kinds(rows), {}
    for name in KINDS:
        verdicts = rows[kind == name].set_index("key").verdict
        differ = verdicts.index[verdicts == DIFFERS]
        agree = (verdicts == REPRODUCED).sum()
        texts[name] = f"{agree} of {agree + len(differ)}"
        if len(differ) and name != "coefficient":
            texts[name] += f" (not {', '.join(f'`{key}`' for key in differ)})"
    vague = (rows.verdict[kind != "misprint"] == IN_WORDS).sum()
    return HEADLINE.format(**texts, vague=vague, unchecked=(rows.verdict == UNCHECKED).sum())


def _kinds(rows):
    """The kind of each row, coefficients apart."""
    return rows.kind.mask(rows.key.str.match(COEFFICIENT), "coefficient")


def _counts(rows):
    """How many claims of each kind got which verdict, as Markdown."""
    kind = _kinds(rows)
    counts = pd.crosstab(kind, rows.verdict)
    counts = counts.reindex(index=list(KINDS), columns=VERDICTS, fill_value=0)
    others = rows[~kind.isin(KINDS)]
    kinds = ", ".join(f"{n} {kind}" for kind, n in others.kind.value_counts(sort=False).items())
    agree = (others.verdict == REPRODUCED).sum()
    return (
        f"{counts.rename(index=KINDS).rename_axis(None).rename_axis(None, axis=1).to_markdown()}"
        f"\n\nNot counted, because they could hardly differ: {kinds}; {agree} of {len(others)} "
        "agree.\n"
    )


def _reasons(rows):
    """A line of Markdown for each row, or for all entries of a matrix."""
    group = rows.key.str.extract(rf"^({'|'.join(published.MATRICES)})\[", expand=False)
    lines = []
    for name, part in rows.groupby(group.fillna(rows.key), sort=False):
        first = part.iloc[0]
        if name in published.MATRICES:
            largest = part.deviation.astype(float).abs().max()
            total = sum(key.startswith(f"{name}[") for key in published.claims())
            what = first.claim.partition("[")[0]
            text = f"{what}: {len(part)} of {total} by at most {largest:.1e}"
        else:
            text = f"{first.claim}: printed “{first.printed}”, computed {first.computed}"
            text += f", judged by {first.tolerance}"
        lines.append(f"- {first.place}: {text}" + (f" ({first.note})" if first.note else ""))
    return "\n".join(lines or ["- nothing"]) + "\n"


def markdown(rows: pd.DataFrame) -> str:
    """The whole ledger as a readable page, with what we do otherwise than the paper."""
    cells = [*map(_link, rows.notebook, rows.cell)]
    claims = rows.claim + rows.note.map(lambda note: note and f"<br>*{note}*")
    table = rows.assign(claim=claims, cell=cells)[PAGE].replace({r"\|": r"\|"}, regex=True)
    return f"""# Printed against computed

Written by `make reproduce`. *Reproduced*: a number within its tolerance, half a unit of the last
printed digit; a statement whose criterion, which is ours, holds. *In words*: too vague for one; the
row says how far it holds. "Small", "little" and "approximately" hold below a tenth and fail above a
third. What hangs on a choice of ours (a start, a search, one of several optimal filters) is in
words, whichever way it comes out; where our rigs disagree, it cannot be checked. *Derived* are
products of printed gains that do not depend on the coordinates of the state, ten for 40 entries.
What is *taken over* from the paper, or an *identity* (imposed, algebra, or another row once more),
could hardly differ.

{_counts(rows)}
What differs:

{_reasons(rows[rows.verdict == DIFFERS])}
## Deviations from the paper

{DEVIATIONS.read_text(encoding="utf-8")}
## All rows

{table.to_markdown(index=False, disable_numparse=True)}

## The figures

{_figures()}
"""


def splice(text: str, name: str, content: str) -> str:
    """Replace what stands between the two markers `name` of a Markdown text."""
    start, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
    before, found, rest = text.partition(start)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"the text has no markers {start.strip()} and {end}")
    return before + start + content + end + after


def publish(build: Path, root: Path) -> None:
    """Put what a complete run has changed into figures/ and the README, and print what that is."""
    rows = join(build / "ledger")
    figures, texts = changes(rows, build, root)
    new = {}
    for name, change in figures.items():
        if change != SAME:
            for path in (root / "figures").glob(f"{name}.*"):
                new[path] = None
            for path in (build / "figures").glob(f"{name}.*"):
                new[root / "figures" / path.name] = path.read_bytes()
    # The README last: after a kill it is the old one, and the next run, or git, mends the rest.
    replace_all(new | {root / name: text for name, text in texts.items()})
    print(f"ledger: {rows.verdict.value_counts().to_dict()}")
    print(report(figures, texts))


def changes(rows: pd.DataFrame, build: Path, root: Path) -> tuple[dict[str, str], dict[str, bytes]]:
    """What a run has made of each figure, in a word, and the texts that are not what they were."""
    readme = (root / "README.md").read_text(encoding="utf-8")
    rows = settled(rows, root)
    texts = {
        "figures/ledger.csv": rows.to_csv(index=False, lineterminator="\n"),
        "figures/ledger.md": markdown(rows),
        "README.md": splice(readme, "ledger", summary(rows)),
    }
    changed = {}
    for name, text in texts.items():
        path = root / name
        if not path.exists() or path.read_bytes() != text.encode():
            changed[name] = text.encode()
    return compared(build / "figures", root / "figures"), changed


def settled(rows: pd.DataFrame, root: Path) -> pd.DataFrame:
    """The rows with computed numbers as they are tracked, where a reader sees no difference."""
    path, moving = root / "figures" / "ledger.csv", ["computed", "deviation"]
    if path.exists():
        tracked = pd.read_csv(path, dtype=str, keep_default_na=False).set_index("key")
        rows, tracked = rows.set_index("key"), tracked.reindex(rows.key)
        same = np.array([*map(same_text, rows.computed, tracked.computed.fillna("new"))])
        same &= rows.verdict == tracked.verdict
        rows.loc[same, moving] = tracked.loc[same, moving]
        rows = rows.reset_index()[COLUMNS]
    return rows


def report(figures: dict[str, str], texts: Iterable[str]) -> str:
    """How many figures are the same, and what has become of the others and of texts."""
    same = list(figures.values()).count(SAME)
    line = f"{same} of {len(figures)} figures are the same as before"
    every = figures | dict.fromkeys(texts, DIFFERENT)
    for kind in (DIFFERENT, NEW, GONE):
        names = ", ".join(name for name, change in every.items() if change == kind)
        line += f"; {kind}: {names}" if names else ""
    return line
