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


def test_claims_expand_matrices_and_are_complete():
    claims = published.claims()
    assert sum(key.startswith("L_full[") for key in claims) == 40
    for claim in claims.values():
        assert claim.claim and claim.printed
        # not a section alone: an equation, figure, matrix or paragraph of it
        assert claim.place == "Abstract" or re.match(r"(I|II|III|IV|V), \S", claim.place), claim.key
        if not claim.criterion:
            assert np.isfinite(published.value(claim.printed))


def test_derived_numbers_are_products_of_the_printed_gains():
    """No orthogonal change of state coordinates alters them; rounding may add up to so much."""
    Ks, KL1 = published.matrix("K_s"), published.matrix("K_L")[:10].T
    pairs, half = {"K_s K_s'": (Ks, Ks), "K_L1' K_L1": (KL1, KL1), "K_s K_L1": (Ks, KL1)}, 0.5e-4
    derived = [claim for claim in published.claims().values() if claim.kind == "derived"]
    assert len(derived) == 3 + 3 + 4
    for claim in derived:
        name, i, j = re.fullmatch(r"(.*)\[(\d),(\d)\]", claim.key).groups()
        x, y = (X[int(k) - 1] for X, k in zip(pairs[name], (i, j), strict=True))
        tolerance = half * (np.abs(x).sum() + np.abs(y).sum() + len(x) * half)
        assert claim.criterion == f"{x @ y:.8f} +- {tolerance:.8f}"
