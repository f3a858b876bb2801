"""Files that are no text in UTF-8 are named as what they are, at both doors that read files."""

import gzip

import pytest

from ilctools import load_log, read_table
from ilctools.errors import LogError

TABLE = "t (s),Heizung (µW),T (°C)\n0,0,1\n1,1,2\n2,0,3\n"


def read(path, **options):
    return read_table(path, time="t", outputs={"T": "T"}, inputs={"Q": "Heizung"}, **options)


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16"])
def test_text_in_another_encoding_is_refused_with_the_remedy_that_reads_it(tmp_path, encoding):
    path = tmp_path / "table.csv"
    path.write_bytes(TABLE.encode(encoding))
    with pytest.raises(LogError, match=rf"table.csv: it is not UTF-8 .*'{encoding}'"):
        read(path)
    table = read(path, encoding=encoding)
    assert table.y.values.ravel().tolist() == [1, 2, 3]
    assert [table.output_unit.item(), table.control_unit.item()] == ["°C", "µW"]
    with pytest.raises(LogError, match=r"not UTF-8.*Save it as UTF-8"):
        load_log(path)


@pytest.mark.parametrize(
    ("encoding", "message"),
    [
        ("ascii", r"not ASCII .*encoding="),
        ("utf-16", r"not UTF-16 .*BOM"),
        ("utf-9", r"not UTF-9 \(unknown encoding: utf-9\): .*encoding="),
    ],
)
def test_an_encoding_that_does_not_fit_or_is_none_is_named(tmp_path, encoding, message):
    (tmp_path / "table.csv").write_text(TABLE, encoding="utf-8")
    with pytest.raises(LogError, match=message):
        read(tmp_path / "table.csv", encoding=encoding)


def test_workbooks_and_archives_are_to_be_exported_or_unpacked_but_for_their_names(tmp_path):
    path, content = tmp_path / "table.csv", gzip.compress(TABLE.encode())
    path.write_bytes(content)
    for door in (read, load_log):
        with pytest.raises(LogError, match=r"not UTF-8.* as CSV.* scipy.io.loadmat.* unpack"):
            door(path)
    assert read(path.rename(tmp_path / "table.csv.gz")).y.size == 3
