"""The ledger: what the paper prints against what is computed here, and the verdict.

A number is *reproduced* if it agrees within half a unit of the last digit printed, a statement if
the number that tests it meets its criterion, which is ours; otherwise it *differs*. A statement too
vague for a criterion is *in words*: the row says how far it holds.

Counted apart, by kind: numbers that the paper prints, statements that its model and design decide,
and statements that only signals or a rig that we assume can test. Not counted is what could hardly
differ: parameters *taken over* from the paper; an *identity*, which holds by construction or
follows from other rows.

A number is shown to the last digit that the paper prints, one that tests a statement in words with
five significant digits, and with more only where the verdict would not follow from these: more
would say nothing about the agreement, and the coefficients of a flat optimum are not determined
further. Between processors those of (39), non-diagonal, move by up to 3e-8; the one that lies
closest to where its fourth decimal would change is 1.4e-7 away.
"""

import re
import sys
from collections.abc import Iterable
from operator import eq, ge, gt, le, lt
from pathlib import Path

import numpy as np
import pandas as pd

from ilctools.files import folder, read_json, replace_all, write_whole
from rodlib.paper import pictures, published
from rodlib.paper.published import Claim
from rodlib.paper.repository import ROOT, checkout, results

REPRODUCED, DIFFERS = "reproduced", "differs"
IN_WORDS, UNCHECKED = "in words", "cannot be checked"
OTHER = "not the paper's parameters"
VERDICTS = (REPRODUCED, DIFFERS, IN_WORDS, UNCHECKED)
DEVIATIONS = Path(__file__).with_name("deviations.md")
WORDS = "words: "  # begins a criterion that is a sentence with a place for the number
KINDS = {
    "number": "printed numbers",
    "coefficient": "coefficients of (39), a flat optimum",
    "statement": "statements about model and design",
    "assumed": "statements on assumed signals or a virtual rig",
}
NOISE = 1e-9  # what is smaller is rounding, and not the same on two machines
BELOW_NOISE = f"below {NOISE:g}"
SIGNIFICANT = 5  # digits of a number that tests a statement in words
COEFFICIENT = r"L_(?:diagonal|full)\["  # how the key of one of (39) begins
SAVED = r'\bsave\(\w+, "([^"]+)", caption\)'  # how a notebook saves a figure
COMPARE = {"<": lt, "<=": le, ">": gt, ">=": ge, "==": eq}
COLUMNS = [
    "key", "place", "claim", "printed", "computed", "deviation", "verdict", "kind", "note",
    "notebook", "cell",
]  # fmt: skip


def verdict(claim: Claim, computed: float) -> tuple[str, float]:
    """A verdict, and the deviation from the printed number, or from a criterion missed."""
    if claim.criterion.startswith(WORDS):
        return IN_WORDS, 0.0
    if not claim.criterion:
        deviation = computed - published.number(claim.printed)
        tolerance = published.half_unit(claim.printed) * (1 + 1e-9)
        return _outcome(abs(deviation) <= tolerance), float(deviation)
    first, _, second = claim.criterion.partition(" ")
    if first in COMPARE:
        limit = float(second)
        holds = COMPARE[first](computed, limit)
        return _outcome(holds), 0.0 if holds else float(computed - limit)
    if second.startswith("+- "):
        deviation = computed - float(first)
        holds = abs(deviation) <= float(second.removeprefix("+- "))
        return _outcome(holds), float(deviation)
    raise ValueError(f"criterion {claim.criterion!r} of claim {claim.key!r} is not understood")


def _outcome(holds):
    return REPRODUCED if holds else DIFFERS


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
            value == published.number(known[key].printed)  # a choice has no rounding
            for key, value in parameters.items()
        )

    def record(self, key: str, computed=None) -> None:
        """Enter what was computed for the claim `key`, or for a printed matrix of that name.

        A matrix has the shape that :func:`rodlib.paper.published.matrix` gives it; None stands for
        what cannot be checked.
        """
        if key in published.MATRICES:
            self._record_matrix(key, np.asarray(computed))
            return
        claim = published.claims()[key]
        if claim.criterion == UNCHECKED:
            outcome, shown, deviation = UNCHECKED, "", np.nan
        else:
            outcome, deviation = verdict(claim, float(computed))
            shown = _shown(claim, float(computed))
            if shown != BELOW_NOISE and outcome != IN_WORDS:
                deviation = verdict(claim, float(shown))[1]
        compares = claim.criterion.startswith(tuple(COMPARE))
        notes = [f"criterion: {claim.criterion}" if compares else "", claim.note]
        judged = self.papers_parameters or outcome == UNCHECKED
        self.rows[key] = {
            "key": key,
            "place": claim.place,
            "claim": claim.claim + (f" ({claim.unit})" if claim.unit else ""),
            "printed": claim.printed,
            "computed": shown,
            "deviation": f"{deviation:.1e}" if abs(deviation) > NOISE else "",
            "verdict": outcome if judged else OTHER,
            "kind": claim.kind,
            "note": "; ".join(filter(None, notes)),
            "notebook": self.notebook,
            "cell": _running(),
        }

    def _record_matrix(self, name, computed):
        expected = published.matrix(name).shape
        if computed.shape != expected:
            raise ValueError(f"{name} has shape {computed.shape}, but the paper's has {expected}")
        if name == "K_s":
            computed = computed.T
        if name == "L_diagonal":
            computed = np.einsum("iik->ki", computed)
        if name == "L_full":
            computed = computed.reshape(4, -1).T
        keys = [key for key in published.claims() if key.startswith(f"{name}[")]
        for key, value in zip(keys, computed.ravel(), strict=True):
            self.record(key, value)

    def table(self, keys: Iterable[str] | None = None) -> pd.DataFrame:
        """The rows recorded so far whose keys begin so, by default all, as a table."""
        chosen = [key for key in published.claims() if key in self.rows]
        if keys is not None:
            chosen = [key for key in chosen if key.startswith(tuple(keys))]
        rows = pd.DataFrame([self.rows[key] for key in chosen], columns=COLUMNS)
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


def _shown(claim, value):
    if claim.criterion.startswith(WORDS):
        return claim.criterion.removeprefix(WORDS).format(f"{value:.3g}")
    if 0 < abs(value) <= NOISE:
        return BELOW_NOISE
    digits, notation = published.decimals(claim.printed), "f"
    if digits is None:
        digits, notation = SIGNIFICANT, "g"
    outcome = verdict(claim, value)[0]
    texts = (f"{value:z.{more}{notation}}" for more in range(digits, digits + 17))
    return next(text for text in texts if verdict(claim, float(text))[0] == outcome)


def join(parts: Path) -> pd.DataFrame:
    """The rows of all notebooks, a CSV file each, in the order of the paper: one for each claim."""
    paths = sorted(parts.glob("*.csv"))
    tables = [pd.read_csv(path, dtype=str, keep_default_na=False) for path in paths]
    rows = pd.concat(tables) if tables else pd.DataFrame(columns=COLUMNS)
    twice = rows.key[rows.key.duplicated()].tolist()
    missing = [key for key in published.claims() if key not in set(rows.key)]
    if twice or missing:
        raise ValueError(f"ledger: claims without evidence {missing}, claims with two rows {twice}")
    return rows.set_index("key").loc[list(published.claims())].reset_index()[COLUMNS]


def summary(rows: pd.DataFrame) -> str:
    """What the README says of the results: the counts, and the statements that differ."""
    statements = rows[(rows.verdict == DIFFERS) & ~rows.key.str.match(COEFFICIENT)]
    return f"{_counts(rows)}\nBeside coefficients, these differ:\n\n{_reasons(statements)}"


def _counts(rows):
    """How many claims of each kind got which verdict, as Markdown."""
    kind = rows.kind.mask(rows.key.str.match(COEFFICIENT), "coefficient")
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
        elif first.verdict == IN_WORDS:
            text = f"{first.claim}: printed “{first.printed}”; {first.computed}"
        else:
            text = f"{first.claim}: printed “{first.printed}”, computed {first.computed}"
        lines.append(f"- {first.place}: {text}" + (f" ({first.note})" if first.note else ""))
    return "\n".join(lines or ["- nothing"]) + "\n"


def markdown(rows: pd.DataFrame) -> str:
    """The whole ledger as a readable page, with what we do otherwise than the paper."""
    links = [*map(_link, rows.notebook, rows.cell)]
    table = rows.drop(columns=["key", "cell"]).assign(notebook=links)
    table = table.replace({r"\|": r"\|"}, regex=True)
    return f"""# Printed against computed

Written by `make reproduce`. *Reproduced*: within half a unit of the last printed digit, or, for a
statement, the criterion named in its note holds. The criteria are ours. *In words*: too vague for a
criterion; the row says how far it holds. What is *taken over* or an *identity* could hardly differ.

{_counts(rows)}
What differs:

{_reasons(rows[rows.verdict == DIFFERS])}
Too vague for a criterion, and how far they hold:

{_reasons(rows[rows.verdict == IN_WORDS])}
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
    checkout("publishing", root)
    rows = join(build / "ledger")
    figures, texts = changes(rows, build, root)
    new = {}
    for name, change in figures.items():
        if change != pictures.SAME:
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
    return pictures.compared(build / "figures", root / "figures"), changed


def report(figures: dict[str, str], texts: Iterable[str]) -> str:
    """How many figures are the same, and what has become of the others and of texts."""
    same = list(figures.values()).count(pictures.SAME)
    if same == len(figures) and not texts:
        return f"all {same} figures, the ledger and the README are the same as before"
    line = f"{same} of {len(figures)} figures are the same as before"
    every = figures | dict.fromkeys(texts, pictures.DIFFERENT)
    for kind in (pictures.DIFFERENT, pictures.NEW, pictures.GONE):
        names = ", ".join(name for name, change in every.items() if change == kind)
        line += f"; {kind}: {names}" if names else ""
    return line
