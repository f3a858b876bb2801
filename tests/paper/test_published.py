import re

import numpy as np
import pytest

from rodlib.paper import published


@pytest.mark.parametrize(
    ("printed", "value", "half"),
    [
        ("0.1011", 0.1011, 0.5e-4),
        ("-0.0439", -0.0439, 0.5e-4),
        ("0.320", 0.32, 0.5e-3),
        ("7800", 7800, 0.5),
        ("50", 50, 0.5),
        ("3/8", 0.375, 0.375e-12),
        ("10^-4", 1e-4, 1e-16),
        ("pi", np.pi, np.pi * 1e-12),
    ],
)
def test_printed_numbers_and_their_precision(printed, value, half):
    assert published.value(printed) == pytest.approx(value, rel=1e-15)
    assert published.half_unit(printed) == pytest.approx(half)


def test_digits_after_the_point():
    places = {"0.1011": 4, "-3.50": 2, "50": 0, "3/8": None, "<= gamma": None}
    assert {printed: published.decimals(printed) for printed in places} == places


def test_matrices_have_the_shapes_and_a_few_entries_of_the_paper():
    assert published.matrix("K_s").shape == (2, 10)
    assert published.matrix("K_s")[1, 9] == 0.8236
    assert published.matrix("K_L").shape == (12, 2)
    assert published.matrix("K_L")[11, 1] == 0.9887
    assert published.matrix("N")[0, 1] == -2.4303
    L = published.matrix("L_diagonal")
    assert L.shape == (2, 2, 10)
    assert (L[0, 0, 9], L[1, 1, 0], np.abs(L[0, 1]).max()) == (42.3133, 3.8432, 0)
    L = published.matrix("L_full")
    assert (L[0, 1, 0], L[1, 0, 9], L[1, 1, 9]) == (2.7801, -0.5390, 42.2384)


def test_every_learning_filter_of_the_paper_has_unit_gain_at_rest():
    """The printed filters learn a constant error in about one trial: L(1) is close to I."""
    for name in ("L_diagonal", "L_full"):
        L = published.matrix(name).sum(axis=2)
        np.testing.assert_allclose(L, np.eye(2), atol=0.05)


def test_claims_expand_matrices_and_are_complete():
    claims = published.claims()
    assert sum(key.startswith("K_L[") for key in claims) == 24
    assert sum(key.startswith("L_full[") for key in claims) == 40
    assert sum("K_L1" in key or "K_s K_s'" in key for key in claims) == 10
    for claim in claims.values():
        assert claim.claim and claim.printed
        # not a section alone: an equation, figure, matrix or paragraph of it
        assert claim.place == "Abstract" or re.match(r"(I|II|III|IV|V), \S", claim.place), claim.key
        if not claim.criterion:
            assert np.isfinite(published.value(claim.printed))
