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
from itertools import count
from operator import eq, ge, gt, le, lt
from pathlib import Path

import numpy as np
import pandas as pd

from ilctools.files import folder, read_json, replace_all, write_whole
from rodlib.paper import published
from rodlib.paper.comparison import different_figures, same_text
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
NEGLIGIBLE = f"below {NOISE:g}"
SIGNIFICANT = 5  # digits of a number that tests a statement in words
PAGE = ["verdict", "claim", "printed", "computed", "tolerance", "kind", "place", "cell"]
COEFFICIENT = r"L_(?:diagonal|full)\["  # how the key of one of (39) begins
SAVED = r'\bsave\(\w+, "([^"]+)", caption\)'  # how a notebook saves a figure
COMPARE = {"<": lt, "<=": le, ">": gt, ">=": ge, "==": eq}
COLUMNS = [
    "key", "place", "claim", "printed", "computed", "tolerance", "deviation", "verdict", "kind",
    "note", "notebook", "cell",
]  # fmt: skip


def expected(claim: Claim) -> tuple[float, float]:
    """The number that is expected, printed or a criterion "0.58 +- 0.01", and its tolerance."""
    number, _, tolerance = claim.criterion.partition(" +- ")
    if number:
        return float(number), float(tolerance)
    return published.value(claim.printed), published.half_unit(claim.printed)


def verdict(claim: Claim, computed: float) -> tuple[str, float]:
    """A verdict, and the deviation from the printed number, or from a criterion missed."""
    relation, _, bound = claim.criterion.partition(" ")
    if relation in COMPARE:
        deviation = computed - float(bound)
        return (REPRODUCED, 0.0) if COMPARE[relation](deviation, 0) else (DIFFERS, deviation)
    number, tolerance = expected(claim)
    deviation = computed - number
    agrees = abs(deviation) <= tolerance * (1 + 1e-9)
    return REPRODUCED if agrees else DIFFERS, deviation


class Ledger:
    """The rows of one notebook, by its name, in which pandas then shows whole sentences.

    If one of its parameters that the paper prints, by key, is not exactly the paper's, no row gets
    a verdict.
    """

    def __init__(self, notebook: str, **parameters):
        pd.set_option("display.max_colwidth", None, "display.max_rows", None, "display.width", 200)
        self.notebook, self.rows, claims = notebook, {}, published.claims()
        self.papers_parameters = all(
            value == published.value(claims[key].printed)  # a choice has no rounding
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
        row = vars(claim) | _judged(claim, computed)
        if not self.papers_parameters and row["verdict"] != UNCHECKED:
            row["verdict"] = OTHER
        self.rows[key] = row | {"notebook": self.notebook, "cell": _running()}

    def table(self, keys: Iterable[str] = ("",)) -> pd.DataFrame:
        """The rows recorded so far whose keys begin so, by default all: those that differ first."""
        keys = tuple(keys)
        chosen = [key for key in published.claims() if key in self.rows and key.startswith(keys)]
        chosen.sort(key=lambda key: self.rows[key]["verdict"] != DIFFERS)
        rows = pd.DataFrame([self.rows[key] for key in chosen], columns=COLUMNS)
        return rows.set_index("place")[["claim", "printed", "computed", "deviation", "verdict"]]

    def save(self) -> None:
        """Write the rows to build/ledger, or to the folder of the run, which joins them."""
        path = folder(results("Ledger.save") / "ledger") / f"{self.notebook}.csv"
        rows = pd.DataFrame(self.rows.values(), columns=COLUMNS)
        ids = [cell["id"] for cell in _code(self.notebook)]
        rows["cell"] = rows.cell.map(dict(enumerate(ids, start=1)))
        write_whole(path, rows.to_csv(index=False, lineterminator="\n"))


def _running():
    """The number of the code cell that runs; 0 outside a notebook."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    return len(shell.user_ns["In"]) - 1 if shell else 0


def _code(notebook):
    """The code cells of a tracked notebook, by its name."""
    path = ROOT / "notebooks" / f"{notebook}.ipynb"
    cells = read_json(path.read_text("utf-8"))["cells"]
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


def _judged(claim, computed):
    """What a row says of a computed number."""
    row = {"claim": claim.claim + (f" ({claim.unit})" if claim.unit else "")}
    row |= dict.fromkeys(["computed", "tolerance", "deviation"], "")
    if claim.criterion == UNCHECKED:
        return row | {"verdict": UNCHECKED}
    value = float(computed)
    if claim.criterion.startswith(WORDS):
        sentence = claim.criterion.removeprefix(WORDS).format(f"{value:.3g}")
        return row | {"verdict": IN_WORDS, "computed": sentence}
    shown = _shown(claim, value)
    outcome, deviation = verdict(claim, value if shown == NEGLIGIBLE else float(shown))
    compares = claim.criterion.partition(" ")[0] in COMPARE
    return row | {
        "computed": shown,
        "tolerance": claim.criterion if compares else f"± {expected(claim)[1]:.2g}",
        "deviation": f"{deviation:.1e}" if abs(deviation) > NOISE else "",
        "verdict": outcome,
    }


def _shown(claim, value):
    """A computed number with as many digits as are printed, or as its verdict needs."""
    if 0 < abs(value) <= NOISE:
        return NEGLIGIBLE
    digits, notation = published.decimals(claim.printed), "f"
    if digits is None:
        digits, notation = SIGNIFICANT, "g"
    outcome, _ = verdict(claim, value)
    for places in count(digits):
        shown = f"{value:z.{places}{notation}}"
        if verdict(claim, float(shown))[0] == outcome:
            return shown


def join(parts: Path) -> pd.DataFrame:
    """The rows of all notebooks, a CSV file each, in the order of the paper: one for each claim.

    A claim with two rows is a ValueError, one without a row a KeyError; both name it.
    """
    rows = pd.concat([*map(read, sorted(parts.glob("*.csv")))], verify_integrity=True)
    return rows.loc[list(published.claims())].reset_index()[COLUMNS]


def read(path: Path) -> pd.DataFrame:
    """The rows of a CSV file as text, by key."""
    return pd.read_csv(path, index_col="key", dtype=str, keep_default_na=False)


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
    before, marker, _ = text.partition(start)
    _, end_marker, after = text.partition(end)
    if not (marker and end_marker):
        raise ValueError(f"the text has no markers {start.strip()} and {end}")
    return before + start + content + end + after


def publish(build: Path, root: Path) -> None:
    """Put what a complete run has changed into figures/ and the README, and print what that is."""
    rows = join(build / "ledger")
    new = changes(rows, build, root)
    replace_all(new)
    print(f"ledger: {rows.verdict.value_counts().to_dict()}")
    print(report(new, root))


def changes(rows: pd.DataFrame, build: Path, root: Path) -> dict[Path, bytes | None]:
    """What a reader sees changed by a run: new contents of files, None of a figure that is gone."""
    readme, tracked = root / "README.md", root / "figures"
    rows = settled(rows, tracked / "ledger.csv")
    texts = {
        tracked / "ledger.csv": rows.to_csv(index=False, lineterminator="\n"),
        tracked / "ledger.md": markdown(rows),
        # The last: after a kill it is the old one, and the next run, or git, mends the rest.
        readme: splice(readme.read_text(encoding="utf-8"), "ledger", summary(rows)),
    }
    names = different_figures(build / "figures", tracked)
    files = [f"{name}.{suffix}" for name in names for suffix in ("png", "pdf")]
    new = {tracked / name: _content(build / "figures" / name) for name in files}
    new |= {path: text.encode() for path, text in texts.items()}
    return {path: content for path, content in new.items() if content != _content(path)}


def _content(path):
    return path.read_bytes() if path.exists() else None


def report(new: dict[Path, bytes | None], root: Path) -> str:
    """Which figures and texts are not what they were."""
    names = [path.relative_to(root).as_posix() for path in new if path.suffix != ".pdf"]
    return f"different: {', '.join(names)}" if names else "all is the same as before"


def settled(rows: pd.DataFrame, path: Path) -> pd.DataFrame:
    """The rows with computed numbers as they are tracked, where a reader sees no difference."""
    if not path.exists():
        return rows
    tracked = read(path).reindex(rows.key, fill_value="new").set_axis(rows.index)
    same = rows.computed.combine(tracked.computed, same_text) & (rows.verdict == tracked.verdict)
    numbers = ["computed", "deviation"]
    return rows.assign(**rows[numbers].mask(same, tracked[numbers]))
