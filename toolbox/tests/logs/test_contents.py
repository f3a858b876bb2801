"""Files that are no text in UTF-8 are named as what they are, at both doors that read files."""

import gzip
import zipfile

import numpy as np
import pandas as pd
import pytest

from ilctools import load_log, read_table, save_log
from ilctools.errors import LogError

TABLE = "t (s),Heizung (µW),T (°C)\n0,0,1\n1,1,2\n2,0,3\n"
COLUMNS = {"time": "t", "outputs": {"T": "T"}, "inputs": {"Q": "Heizung"}}


@pytest.fixture
def log(tmp_path):
    """The text of a log in whose signals letters beyond ASCII stand."""
    path = tmp_path / "log.csv"
    save_log(read_table(pd.DataFrame([[0.0, 1, 2], [1, 2, 3]], columns=["t", 1, 2]),
             time="t", outputs={"T": 1}, inputs={"Q": 2}, units={"T": "°C"}), path)  # fmt: skip
    return path.read_text(encoding="utf-8")


def read(path, **options):
    return read_table(path, **COLUMNS, **options)


@pytest.mark.parametrize(
    "encoding", ["cp1252", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-be"]
)
def test_text_in_another_encoding_is_named_and_read_with_it(tmp_path, log, encoding):
    """The remedy of the error, taken by its word, reads the file."""
    path = tmp_path / "table.csv"
    marked = "\ufeff" if encoding == "utf-32-be" else ""  # programs write it with its mark
    path.write_bytes((marked + TABLE).encode(encoding))
    with pytest.raises(LogError, match=r"not UTF-8.*encoding='") as refused:
        read(path)
    named = str(refused.value).split("encoding='")[1].split("'")[0]
    assert encoding.startswith(named)
    table = read(path, encoding=named)
    assert table.y.values.ravel().tolist() == [1, 2, 3]
    assert table.output_unit.item() == "°C" and table.control_unit.item() == "µW"
    path.write_bytes((marked + log).encode(encoding))
    with pytest.raises(LogError, match=f"not UTF-8.*{named.upper()}.*Save it as UTF-8"):
        load_log(path)


def test_an_encoding_that_does_not_fit_or_is_none_is_named(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(TABLE, encoding="utf-8")
    with pytest.raises(LogError, match=r"not ASCII .*encoding='utf-8'"):
        read(path, encoding="ascii")
    with pytest.raises(LogError, match="encoding = 'utf-9' must be one that Python knows"):
        read(path, encoding="utf-9")
    with pytest.raises(LogError, match="encoding = 8 must be"):
        read(path, encoding=8)


def test_ascii_in_utf_16_without_a_mark_is_no_text_of_zeros(tmp_path):
    """Its bytes are valid UTF-8."""
    path = tmp_path / "table.csv"
    path.write_bytes(b"".join(bytes([byte, 0]) for byte in b"t,Heizung,T\n0,0,1\n1,1,2\n"))
    with pytest.raises(LogError, match="encoding='utf-16-le'"):
        read(path)


def archive(path, **members):
    with zipfile.ZipFile(path, "w") as file:
        for name, text in members.items():
            file.writestr(name.replace("_", "/"), text)


def workbook(path):
    archive(path, **{"[Content_Types].xml": "<Types/>", "xl_workbook.xml": "<workbook/>"})


def document(path):
    archive(path, mimetype="application/vnd.oasis.opendocument.spreadsheet", **{"content.xml": ""})


def old_workbook(path):
    path.write_bytes(bytes.fromhex("d0cf11e0a1b11ae1") + bytes(504))


@pytest.mark.parametrize("name", ["table", "table.csv"])  # whatever it is called
@pytest.mark.parametrize(
    ("write", "kind"), [(workbook, ".xlsx"), (document, ".ods"), (old_workbook, ".xls")]
)
def test_a_workbook_is_no_table_of_text(tmp_path, write, kind, name):
    path = tmp_path / (name if name.endswith("csv") else name + kind)
    write(path)
    for door in (read, load_log):
        with pytest.raises(LogError, match=rf"\({kind}\).* as CSV") as refused:
            door(path)
        assert str(path) in str(refused.value)


def test_compressed_tables_are_read_by_their_names_and_else_named(tmp_path):
    with gzip.open(tmp_path / "table.csv.gz", "wb") as file:
        file.write(TABLE.encode())
    archive(tmp_path / "table.zip", **{"table.csv": TABLE})
    for name in ("table.csv.gz", "table.zip"):
        assert read(tmp_path / name).y.size == 3
    hidden = (tmp_path / "table.csv.gz").rename(tmp_path / "table.csv")
    for door in (read, load_log):
        with pytest.raises(LogError, match=r"compressed, as \.gz files are"):
            door(hidden)
    path = tmp_path / "cut.csv"  # half an archive, whose directory is lost
    path.write_bytes((tmp_path / "table.zip").read_bytes()[:60])
    with pytest.raises(LogError, match=r"cut\.csv: "):
        read(path)


@pytest.mark.parametrize(("unit", "second"), [("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)])
@pytest.mark.parametrize("begin", [1.0e9, 1.7e9, 4.0e9])  # 2001, 2023, 2096
def test_a_clock_since_1970_in_a_finer_unit_is_not_one_in_s(unit, second, begin):
    """Seconds since 1970 are; and with its unit it is what the steps say."""
    t = begin + 0.25 * np.arange(40)  # multiples of a quarter, which doubles hold exactly
    table = pd.DataFrame({"t": np.round(t / second).astype("int64"), "T": np.arange(40.0)})
    asked = {"time": "t", "outputs": {"T": "T"}}
    for more in ({}, {"Ts": 0.25}, {"units": {"time": "s"}}):
        with pytest.raises(LogError, match=rf"count {unit} since 1970: .*'time': '{unit}'"):
            read_table(table, **asked, **more)
    assert read_table(table, **asked, units={"time": unit}).attrs["Ts"] == 0.25
    named = table.rename(columns={"t": f"t ({unit})"})
    assert read_table(named, **asked).attrs["Ts"] == 0.25
    assert read_table(table.assign(t=t), **asked).attrs["Ts"] == 0.25
    with pytest.raises(LogError, match="state its unit"):  # of 100 ns since 1601
        read_table(table.assign(t=(t + 11644473600) * 1e7), **asked)
