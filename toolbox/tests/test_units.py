import pytest

from ilctools.units import labels, seconds


def test_a_unit_of_time_is_known_in_seconds():
    assert [seconds(unit) for unit in ("s", "ms", "min", "h")] == [1, 1e-3, 60, 3600]
    for unit in ("K", "1/s", "", 3):
        with pytest.raises(ValueError, match=f"unit of time = {unit!r}"):
            seconds(unit)


def test_a_unit_is_any_text():
    units = labels({"level": "fathoms"}, ["level", "flow"])
    assert units == {"level": "fathoms", "flow": ""}
    for wrong in ({"level": 3}, {"depth": "m"}):
        with pytest.raises(ValueError, match="units"):
            labels(wrong, ["level"])
