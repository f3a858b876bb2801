import pytest

from rodlib.ilc.units import seconds, understood


@pytest.mark.parametrize("text", ["K", "degC", "l/min", "W/(m K)", "m/s**2", "%", ""])
def test_a_unit_is_what_pint_knows(text):
    understood("level", text)


@pytest.mark.parametrize(
    "text", ["m m (", "2 K", "K +", "import os", "((((", "ｓ", 60 * "a"]
)
def test_what_is_no_unit_is_refused_in_words(text):
    with pytest.raises(
        ValueError, match="of level is not understood: write it as pint does"
    ):
        understood("level", text)


def test_a_unit_of_time_lasts():
    assert [seconds(unit) for unit in ("s", "ms", "min", "hour")] == [1, 1e-3, 60, 3600]
    for unit in ("K", "1/s", "", "fortnite"):
        with pytest.raises(ValueError, match=f"unit {unit!r}"):
            seconds(unit)
