"""The gains of the rod's loop against the printed ones."""

import numpy as np

from rodlib.paper import published


def test_printed_gains_up_to_the_coordinates(loop):
    assert np.abs(loop.N - published.matrix("N")).max() <= 0.5e-4
    assert np.abs(loop.KL[10:] - published.matrix("K_L")[10:]).max() <= 0.5e-4
    KL1 = loop.KL[:10]
    products = {
        "K_s K_s'": loop.Ks @ loop.Ks.T,
        "K_L1' K_L1": KL1.T @ KL1,
        "K_s K_L1": loop.Ks @ KL1,
    }
    claims = [c for c in published.claims().values() if c.key[:-5] in products]
    assert len(claims) >= 9
    for claim in claims:
        i, j = (int(index) - 1 for index in claim.key[-4:-1].split(","))
        value, tolerance = (float(part) for part in claim.criterion.split(" +- "))
        assert abs(products[claim.key[:-5]][i, j] - value) <= tolerance
