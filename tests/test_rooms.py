import rooms

MODULE = '''"""What it is,
in two lines."""

def f(x):  # as it is
    """Twice."""
    return 2 * x
'''


def test_a_room_that_has_grown_is_named(tmp_path, capsys):
    """Of def f ( x ) : return 2 * x, which alone counts, and of a room within a room."""
    for folder in ("house", "house/room"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "module.py").write_text(MODULE)
    assert rooms.counted(tmp_path, {"house": 0}) == {"house": 20}
    for most, total in ((9, 20), (11, 20), (10, 20)):
        table = f'[tool.rooms]\ntotal = {total}\n"house" = 10\n"house/room" = {most}\n'
        (tmp_path / "pyproject.toml").write_text(table)
        assert rooms.main(tmp_path) == (most != 10)
    said = "house/room: 10 tokens, 9 in pyproject.toml\nthe sum of the rooms: 21 tokens, 20 in"
    assert capsys.readouterr().out == f"{said} pyproject.toml\n"
