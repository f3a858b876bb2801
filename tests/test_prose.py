"""Numbers in the prose of the notebooks: each is an output, in the ledger, or a choice in the code.

In the README, in docs/answers.md and in the list of deviations each is one of the notebooks, or of
the benchmarks, that the paragraph names; a cell of a notebook may have those of a benchmark that it
names by `make measure WHAT=...`.

Read are numbers in digits, in text, in formulas and in the captions of figures. Labels of
equations, figures and the like, exponents, indices and sizes (2 x 2) are no results; neither are
whole numbers up to 12 without a unit, which count things. A number is found where another one of
the same notebook rounds to its printed digits; signs are left to the words around it. Of wrong
numbers with three digits or more none was found by chance (120 tried), of two digits one in six,
of one digit most: what must not move unseen is given with three.
"""

import io
import re
import tokenize
from copy import deepcopy
from decimal import Decimal

import pytest
from books import BOOKS, ROWS, text
from nbformat import v4

from rodlib.paper.ledger import DEVIATIONS

PERFORMANCE = text("figures/performance.md")
ANSWERS = text("docs/answers.md")
CONSTANTS = {  # that no cell prints, with the reason
    "02-feedback": {
        "45": "free numbers of a rotation in ten dimensions, 10 x 9 / 2",
        "44": "entries of K_s and K_L, 20 + 24, each with its row in the ledger",
    },
    "10-measurement": {"2012": "year of the book"},
}
NUMBER = r"(?<![\w.^])\d+(?:\.\d+)?(?:e[-+]?\d+)?"
NO_RESULT = re.compile(
    r"\*\*Try\*\*[^\n]*"  # of other parameters: test_equations runs them
    r"|```.*?```|`[^`]*`"  # code
    r"|\]\([^)]*\)"  # the target of a link
    r"|\(\d+\)|\[\d+\]"  # an equation, an entry of the paper's bibliography
    r"|^#+ \d+|^\d+\. "  # a heading, an item of a list
    r"|(?:Figs?\.|[Nn]otebooks?|Note|Lemma)\s\d+(?:(?:, | and | to |–)\d+)*"
    r"|\d+\s*(?:\\times|×)\s*\d+"
    r"|[_^]\{[^{}]*\}",
    flags=re.DOTALL | re.MULTILINE,
)
SCALES = {"%": 100, "\\%": 100, "mK": 1000, "mW": 1000, "mm": 1000}
UNIT = r"[\s~]*(?P<unit>\\?%|mK|mW|mm|K|W|s|min|rad|1/s)(?!\w)"


def numbers(markdown):
    """Numbers that are results, as (text, factors by which a match may be scaled)."""
    text = re.sub(r"\\[,;]", " ", markdown.replace("{,}", ""))
    text = re.sub(r"(?<=\d)\s*(?:\\cdot|\\times|·|×)\s*10\^\{?(-?\d+)\}?", r"e\1", text)
    text = re.sub(r"(?<![\w.])10\^\{?(-?\d+)\}?", r"1e\1", text)
    text = NO_RESULT.sub(" ", text)
    after = re.compile(rf"(?:\s*(?:to|and|or|–|,)\s*{NUMBER})*{UNIT}")
    for number in re.finditer(NUMBER, text):
        unit = (match := after.match(text, number.end())) and match["unit"]
        if unit or not number[0].isdigit() or int(number[0]) > 12:
            yield number[0], {1, SCALES.get(unit, 1)}


def is_rounding_of(shown, value, factors):
    half = Decimal(5).scaleb(Decimal(shown).as_tuple().exponent - 1)
    return any(abs(Decimal(shown) - value * factor) <= half for factor in factors)


def known_numbers(notebook, rows):
    """Magnitudes of all numbers in the outputs, the code and the ledger's rows of a notebook."""
    texts = [*rows.computed, *rows.printed]
    for cell in notebook.cells:
        if cell.cell_type == "code":
            tokens = tokenize.generate_tokens(io.StringIO(cell.source).readline)
            texts += [token.string for token in tokens if token.type == tokenize.NUMBER]
            texts += [
                o.get("text") or o.get("data", {}).get("text/plain", "") for o in cell.outputs
            ]
    return {Decimal(found) for text in texts for found in re.findall(NUMBER, text)}


def not_found(notebook, rows, constants=()):
    texts = [cell.source for cell in notebook.cells if cell.cell_type == "markdown"]
    outputs = [o for cell in notebook.cells for o in cell.get("outputs", [])]
    texts += [o.data["text/markdown"] for o in outputs if "text/markdown" in o.get("data", {})]
    known = known_numbers(notebook, rows)
    return [
        shown
        for text in texts
        for shown, factors in numbers(text)
        if shown not in constants
        and not any(is_rounding_of(shown, value, factors) for value in known | benchmarked(text))
    ]


def benchmarked(text):
    """The numbers of the benchmarks that a text names, in their sections of performance.md.

    Of one that is gone, the text names the commit that made its section; or a parameter of itself.
    """
    found = set()
    for name in re.findall(r"`(?:make measure WHAT=|git show \S+/|)(\w+)(?:\.py| = 10)?`", text):
        _, _, section = PERFORMANCE.partition(f"<!-- {name} -->")
        section = section.partition(f"<!-- end of {name} -->")[0]
        found |= {Decimal(number) for number in re.findall(NUMBER, section)}
    return found


def rows_of(name):
    """Of the ledger, but for the entries of matrices: any digits at all."""
    return ROWS[(ROWS.notebook == name) & ~ROWS.key.str.contains("[", regex=False)]


@pytest.mark.parametrize("name", BOOKS)
def test_every_number_in_prose_is_computed_or_chosen(name):
    assert not_found(BOOKS[name], rows_of(name), CONSTANTS.get(name, ())) == []


def paragraphs():
    """Of these texts, without tables, code and what is generated."""
    ledger = r"<!-- ledger -->.*<!-- end of ledger -->"
    readme = re.sub(ledger, "", text("README.md"), flags=re.DOTALL)
    for document in (readme, ANSWERS, text(DEVIATIONS)):
        for paragraph in re.split(r"\n\n+|\n(?=- )", document):
            if not paragraph.startswith(("```", "    ", "|")):
                yield paragraph


def test_every_number_of_these_texts_is_where_it_points():
    seen = 0
    for paragraph in paragraphs():
        named = {int(number) for number in re.findall(r"[Nn]otebook (\d+)", paragraph)}
        known = set()
        for name, notebook in BOOKS.items():
            if int(name[:2]) in named:
                known |= known_numbers(notebook, rows_of(name))
        if "performance.md" in paragraph:
            known |= {Decimal(found) for found in re.findall(NUMBER, PERFORMANCE)}
        for shown, factors in numbers(paragraph) if known or paragraph in ANSWERS else ():
            assert any(is_rounding_of(shown, value, factors) for value in known), (shown, paragraph)
            seen += 1
    assert seen > 30


def test_a_wrong_number_is_found_in_prose_and_in_captions():
    name = "02-feedback"
    notebook = deepcopy(BOOKS[name])
    caption = v4.new_output("display_data", {"text/markdown": "*It is 37.3 %.*"})
    notebook.cells.append(v4.new_markdown_cell("It is $0.0339$ rad/s in all."))
    notebook.cells.append(v4.new_code_cell(outputs=[caption]))
    assert not_found(notebook, rows_of(name), CONSTANTS[name]) == ["0.0339", "37.3"]
