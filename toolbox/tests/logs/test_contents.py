"""Files that are no text in UTF-8 are named as what they are, at both doors that read files."""

import gzip
import zipfile

import pytest

from ilctools import load_log, read_table
from ilctools.errors import LogError

TABLE = "t (s),Heizung (µW),T (°C)\n0,0,1\n1,1,2\n2,0,3\n"
ASCII = "t,Heizung,T\n0,0,1\n1,1,2\n2,0,3\n"


def read(path, **options):
    return read_table(path, time="t", outputs={"T": "T"}, inputs={"Q": "Heizung"}, **options)


@pytest.mark.parametrize(
    ("text", "encoding", "units"),
    [
        (TABLE, "cp1252", ["°C", "µW"]),
        (TABLE, "utf-16", ["°C", "µW"]),
        (ASCII, "utf-16-le", ["", ""]),  # without a mark; its bytes are valid UTF-8
    ],
)
def test_text_in_another_encoding_is_named_and_read_with_it(tmp_path, text, encoding, units):
    """The remedy of the error, taken by its word, reads the file."""
    path = tmp_path / "table.csv"
    path.write_bytes(text.encode(encoding))
    with pytest.raises(LogError, match=r"not UTF-8.*encoding='") as refused:
        read(path)
    named = str(refused.value).split("encoding='")[1].split("'")[0]
    assert encoding.startswith(named)
    table = read(path, encoding=named)
    assert table.y.values.ravel().tolist() == [1, 2, 3]
    assert [table.output_unit.item(), table.control_unit.item()] == units
    with pytest.raises(LogError, match=f"not UTF-8.*{named[:6].upper()}.*Save it as UTF-8"):
        load_log(path)


@pytest.mark.parametrize(
    ("encoding", "message"),
    [
        ("ascii", r"not ASCII .*encoding='utf-8'"),
        ("utf-9", "one that Python knows"),
        (8, "= 8 must"),
    ],
)
def test_an_encoding_that_does_not_fit_or_is_none_is_named(tmp_path, encoding, message):
    (tmp_path / "table.csv").write_text(TABLE, encoding="utf-8")
    with pytest.raises(LogError, match=message):
        read(tmp_path / "table.csv", encoding=encoding)


def archive(path, name, content):
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(name, content)


def test_workbooks_and_archives_are_named_whatever_they_are_called(tmp_path):
    path = tmp_path / "book.csv"
    archive(path, "xl/workbook.xml", bytes(range(256)))
    for content, message in (
        (path.read_bytes(), r"\(\.xlsx, \.ods\).*\(\.zip\).* as CSV"),
        (bytes.fromhex("d0cf11e0a1b11ae1") + bytes(504), r"\(\.xls\).* as CSV"),
        (gzip.compress(TABLE.encode()), r"compressed, as \.gz files are"),
    ):
        path.write_bytes(content)
        for door in (read, load_log):
            with pytest.raises(LogError, match=rf"book\.csv: .*{message}"):
                door(path)


def test_compressed_tables_are_read_by_their_names(tmp_path):
    (tmp_path / "table.csv.gz").write_bytes(gzip.compress(TABLE.encode()))
    archive(tmp_path / "table.zip", "table.csv", TABLE)
    for name in ("table.csv.gz", "table.zip"):
        assert read(tmp_path / name).y.size == 3
