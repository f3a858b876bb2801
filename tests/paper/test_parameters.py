"""The parameters of notebooks: ranges, and what is said of a choice that the text does not know."""

import ast

import pytest
from books import BOOKS, code
from other_parameters import arguments_of_checked

from rodlib.paper import checked


def test_values_in_their_range_come_back_and_others_than_the_texts_are_shown(monkeypatch):
    shown = []
    monkeypatch.setattr("IPython.display.display", lambda text: shown.append(text.data))
    for M_max, trials in ((0.9, 10), (0.1, 2), (1, 50)):
        bound, count = (M_max, 0.9, 0.1, 1.0), (trials, 10, 2, 50)
        values = checked(M_max=bound, trials=count, log=("", ""))
        assert values == {"M_max": M_max, "trials": trials, "log": ""}
        assert bool(shown) == (M_max != 0.9)
    assert "`M_max = 1`, `trials = 50`" in shown[1] and "log" not in shown[1]
    for name, value in (("M_max", 0.09), ("M_max", "0.9"), ("trials", 7.5)):
        with pytest.raises(ValueError, match=f"{name} = .* must be"):
            checked(**{name: (value, 10, *((0.1, 1.0) if name == "M_max" else (2, 50)))})


@pytest.mark.parametrize("name", BOOKS)
def test_each_parameter_of_a_notebook_is_checked_before_it_is_used(name):
    """By its own name and with the default that stands in the cell of the parameters."""
    _, choices, *others = code(name)
    defaults = {s.target.id: s.value for s in ast.parse(choices).body}
    number = next(i for i, cell in enumerate(others) if arguments_of_checked(cell))
    found = arguments_of_checked(others[number])
    before = ast.walk(ast.parse("\n".join(others[:number])))
    assert not {node.id for node in before if isinstance(node, ast.Name)} & {*defaults}
    assert [*found] == [*defaults]
    for parameter, (value, default, *ends) in found.items():
        assert value.id == parameter
        default = ast.literal_eval(default)
        assert default == ast.literal_eval(defaults[parameter]), parameter
        is_number = isinstance(default, int | float) and not isinstance(default, bool)
        assert len(ends) == 2 or not is_number, parameter
