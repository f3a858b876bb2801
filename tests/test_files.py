import pytest

from rodlib.files import replacing, write_whole


def test_a_file_is_replaced(tmp_path):
    path = tmp_path / "log.csv"
    write_whole(path, "old\n")
    write_whole(path, "Gałkowski\n")
    assert path.read_bytes() == "Gałkowski\n".encode()
    assert list(tmp_path.iterdir()) == [path]


def test_after_an_error_the_old_file_is_whole_and_nothing_else_is_left(tmp_path):
    path = tmp_path / "log.csv"
    write_whole(path, "old")
    with pytest.raises(UnicodeEncodeError):
        write_whole(path, "new \ud800")
    with pytest.raises(KeyboardInterrupt), replacing(path) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
