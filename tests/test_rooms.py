import pytest
import rooms

MODULE = '''"""What it is,
in two lines."""

def f(x):  # as it is
    """Twice."""
    return 2 * x
'''


@pytest.mark.parametrize(("most", "passed"), [(20, False), (19, True)])
def test_a_limit_that_is_passed_is_named(most, passed, tmp_path, capsys):
    """The tokens of ``def f ( x ) : return 2 * x`` are ten, and two modules have them."""
    for folder in ("house", "house/room"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "module.py").write_text(MODULE)
    limit = f'[tool.rooms]\ncode = {{ folders = ["house"], most = {most} }}\n'
    (tmp_path / "pyproject.toml").write_text(limit)
    assert rooms.main(tmp_path) == passed
    said = "code: 20 tokens, at most 19 in pyproject.toml\n" if passed else ""
    assert capsys.readouterr().out == said


@pytest.mark.parametrize(("third", "passed"), [("LONGEST = 3", True), ("LONGEST = 2", False)])
def test_a_constant_of_three_values_is_named(third, passed, tmp_path, capsys):
    """Two are admitted, as are names within a function, and the registry of each package."""
    within = "def f():\n    LONGEST = 4\n    return LONGEST\n"
    for number, text in enumerate(["LONGEST = 1", "LONGEST = 2", third]):
        content = f"{text}\nMODULES = {{{number}: 0}}\nroom = {number}\n{within}"
        (tmp_path / f"module_{number}.py").write_text(content)
    limit = '[tool.rooms]\ncode = { folders = ["."], most = 1000 }\n'
    (tmp_path / "pyproject.toml").write_text(limit)
    assert rooms.main(tmp_path) == passed
    assert capsys.readouterr().out.startswith("LONGEST has more than two values") == passed
