"""Findings are numbers until they are printed."""

import pytest

from ilctools.findings import FINDINGS, Finding
from ilctools.problem.bounds import Claim


@pytest.mark.parametrize("code", FINDINGS)
def test_a_finding_has_its_numbers_and_its_place_in_words(code):
    claim = Claim("M_max", "M", 0.25, 0.0)
    said = str(Finding(code, 0.4321, 0.25, "at 3 rad/s", "; lower it", claim))
    numbers = {"0.43", "0.432", "0.4321", "43%", "4.3e-01", "0.25"}
    asked = {key for key in ("value", "limit", "place") if f"{{{key}" in FINDINGS[code]}
    assert any(number in said for number in numbers) or not asked & {"value", "limit"}
    assert ("at 3 rad/s" in said) == ("place" in asked) and "{" not in said
