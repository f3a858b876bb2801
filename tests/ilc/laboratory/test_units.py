import numpy as np
import pytest

from rodlib.ilc.laboratory.units import conversion, unit


@pytest.mark.parametrize(
    ("source", "target", "difference", "values", "expected"),
    [  # from tables of units, not from pint
        ("kW", "W", False, [0, 1.5], [0, 1500]),
        ("mK", "K", False, [250.0], [0.25]),
        ("degC", "degF", False, [-40, 0, 100], [-40, 32, 212]),
        ("degC", "degF", True, [-40, 0, 100], [-72, 0, 180]),
        ("degF", "°C", False, [212], [100]),
        ("delta_degC", "K", False, [3], [3]),
        ("K", "delta_degC", True, [3], [3]),
        ("l/min", "m**3/s", False, [60], [1e-3]),
        ("rpm", "rad/s", False, [60], [2 * np.pi]),
        ("%", "", False, [50], [0.5]),
        ("µm", "um", False, [7], [7]),
        ("degC", "degC", False, [0.1 + 0.2], [0.1 + 0.2]),
        ("W/(m K)", "mW/(m*K)", False, [2], [2000]),
        ("kg/m³", "g / cm^3", False, [7800], [7.8]),
        ("m/s**2", "mm·s⁻¹/s", False, [1], [1000]),
        ("1/min", "Hz", False, [30], [0.5]),
    ],
)
def test_numbers_are_converted(source, target, difference, values, expected):
    factor, offset = conversion("x", source, target, difference)
    np.testing.assert_allclose(np.multiply(values, factor) + offset, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("source", "target", "message"),
    [
        ("W", "K", "unit 'W' of level cannot be converted to 'K'"),
        ("K", "degC", "one counts from a zero of its own"),
        ("degF", "mK", "one counts from a zero of its own"),
        ("dBm", "mW", "one counts from a zero of its own"),
        ("K", "kelvins per fortnite", "unit 'kelvins per fortnite' of level is not understood"),
        (3, "K", "unit of level = 3 must be a str"),
    ],
)
def test_what_cannot_be_converted_is_refused(source, target, message):
    with pytest.raises(ValueError, match=message):
        conversion("level", source, target, False)


@pytest.mark.parametrize(
    "text",
    [
        "m m m (", "2 K", "K +", "1e999", "import os", "((((", "$", "ｓ", "s**２", 60 * "a" + "!",
        # and what pint passes over
        "s*1", "1.0*s", "1", "+s", "s%1", "s**1_0", "s**1e0", "s**99", "$s$", "s#x", "s.", " ",
    ],
)  # fmt: skip
def test_what_is_no_unit_is_refused_in_words(text):
    with pytest.raises(ValueError, match="of level is not understood: write it as pint does"):
        unit("level", text)
