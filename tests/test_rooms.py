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
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "module.py").write_text(MODULE)
    for most in (9, 10):
        (tmp_path / "pyproject.toml").write_text(f'[tool.rooms]\n"room" = {most}\n')
        assert rooms.main(tmp_path) == (most < 10)
    assert capsys.readouterr().out == "room: 10 tokens, 9 in pyproject.toml\n"
