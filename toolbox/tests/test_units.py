import pytest

from ilctools.units import labels


def test_a_unit_is_any_text():
    units = labels({"level": "fathoms"}, ["level", "flow"])
    assert units == {"level": "fathoms", "flow": ""}
    for wrong in ({"level": 3}, {"depth": "m"}):
        with pytest.raises(ValueError, match="units"):
            labels(wrong, ["level"])
