import rooms

MODULE = '''"""What it is,
in two lines."""

def f(x):  # as it is
    """Twice."""
    return 2 * x
'''


def test_only_what_a_reader_has_to_take_in_counts(tmp_path):
    """def f ( x ) : return 2 * x"""
    assert rooms.tokens(MODULE) == 10
    (tmp_path / "house" / "room").mkdir(parents=True)
    for folder in ("house", "house/room"):
        (tmp_path / folder / "module.py").write_text(MODULE)
    assert rooms.counted(tmp_path, {"house": 0, "house/room": 0}) == {"house": 10, "house/room": 10}
    assert rooms.counted(tmp_path, {"house": 0}) == {"house": 20}


def test_a_room_that_has_grown_is_named(tmp_path, capsys):
    """And rooms that may have more than before where none has less."""
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "module.py").write_text(MODULE)
    for most, total in ((9, 10), (11, 10), (10, 10)):
        table = f'[tool.rooms]\ntotal = {total}\n"room" = {most}\n'
        (tmp_path / "pyproject.toml").write_text(table)
        assert rooms.main(tmp_path) == (most != total)
    said = "room: 10 tokens, 9 in pyproject.toml\nthe sum of the rooms: 11 tokens, 10 in"
    assert capsys.readouterr().out == f"{said} pyproject.toml\n"
