import csv
from io import StringIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rodlib.ilc.logs import tables

HEAD = '# made: by hand\n\ntrial,depth,"valve, left"\n'
ROWS = ["1,0.5,2\n", "1,1.5,3\n", "2,2.5,4\n"]


def replaced(row, text):
    return HEAD + "".join([*ROWS[:row], text, *ROWS[row + 1 :]])


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        (HEAD + "".join(ROWS), [4, 5, 6]),
        ((HEAD + "".join(ROWS)).replace("\n", "\r\n"), [4, 5, 6]),
        ("\N{BOM}" + HEAD + "".join(ROWS).removesuffix("\n"), [4, 5, 6]),
        (
            HEAD.replace(",depth", ", depth") + "".join(ROWS).replace("0.5", " +.5e0 "),
            [4, 5, 6],
        ),
        (replaced(1, '# a comment: none\n\n \n"1",1.5,"3"\n') + "\n", [4, 8, 9]),
    ],
)
def test_rows_are_read_and_known_by_their_line(text, lines):
    table = tables.read(text.encode())
    assert table.metadata == {"made": "by hand"} and not table.problems
    np.testing.assert_array_equal(table.column("depth"), [0.5, 1.5, 2.5])
    np.testing.assert_array_equal(table.column("valve, left"), [2, 3, 4])
    assert list(table.lines) == lines and table.problems_of(table.header) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (replaced(1, "1,,3\n"), "depth: entry is missing, in row 5"),
        (replaced(1, "1,nan,3\n"), "depth: entry is 'nan', not a finite number, in row 5"),
        (replaced(1, "1,1e400,3\n"), "depth: entry is '1e400', not a finite number, in row 5"),
        (replaced(1, "1,1_0,3\n"), "depth: entry is '1_0', not a finite number, in row 5"),
        (replaced(1, "1,１,3\n"), "depth: entry is '１', not a finite number, in row 5"),
        (replaced(1, "# a note\n\n1,off,3\n"), "depth: entry is 'off', not a finite number, in "
         "row 7"),
        (replaced(0, "1,off,2\n").replace("2.5", "off"), "depth: entry is 'off', not a finite "
         "number, in row 4 (2 such entries)"),
        (replaced(1, "1,1.5\n"), "row 5 has 2 entries, but the header has 3"),
        (replaced(1, "1,1.5,3,\n"), "row 5 has 4 entries, but the header has 3"),
        (replaced(2, "2,2.5,4\n# made: again\n"), "metadata: 'made' is given twice, again in line "
         "7"),
    ],
)  # fmt: skip
def test_what_is_no_number_is_told_by_its_row(text, message):
    table = tables.read(text.encode())
    assert table.problems_of(table.header) == [message]
    assert table.problems_of(["trial"]) == (
        [] if message.startswith("depth") else [message]
    )
    assert np.isfinite(table.column("trial")).sum() >= 2


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("", "no table: there is no line with the names of the columns"),
        ("a;b\n", "no table: its columns are separated by semicolons"),
        ("a\tb\n", "no table: its columns are separated by tabs"),
        ("a,b,\n", "ends with a comma: remove it"),
        ("a,b,a\n", "column 'a' stands there 2 times"),
        ("# a: 1\n# a: 2\na,b\n", "metadata: 'a' is given twice, again in line 2"),
    ],
)
def test_a_header_that_is_none_is_told(header, message):
    (problem,) = tables.read(header.encode()).problems
    assert message in problem


@given(
    st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1),
    st.text(min_size=1),
)
def test_numbers_and_titles_are_read_as_they_were_written(numbers, title):
    title = title.replace("\r", "").replace("\n", "").strip() or "#"
    assert next(csv.reader(StringIO(tables.quoted(title)))) == [title]
    table = tables.read(
        b"x,z\n" + tables.rows([np.array(numbers), np.arange(len(numbers))])
    )
    assert table.column("x").tobytes() == np.array(numbers).tobytes()
