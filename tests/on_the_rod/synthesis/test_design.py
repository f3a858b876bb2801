"""The designs of the paper against its printed filters."""

import numpy as np
import pytest
from plants import sigma_of_M

from ilctools import LearningFilter, synthesise
from rodlib import paper_choices
from rodlib.paper import published


def judged(L, loop, Q, omega):
    """Largest singular values of M and L by numpy's SVD, not by what synthesise uses."""
    gain = np.linalg.matrix_norm(L.frequency_response(omega), ord=2)
    return sigma_of_M(omega, loop.frequency_response(omega), Q, L), gain


def test_no_design_is_worse_than_the_printed_one(loop, Q, omega):
    for structure, value, rate, gain in (
        ("diagonal", 104.865787, 0.8999993, 50.00004),
        ("full", 69.961958, 0.883, 50.00007),
    ):
        design = synthesise(loop, Q, omega, **paper_choices(structure=structure))
        printed = LearningFilter(published.matrix(f"L_{structure}"), 1.0)
        sigma_M, sigma_L = judged(printed, loop, Q, omega)
        objective = sigma_M[omega <= 0.02].sum()
        assert objective == pytest.approx(value, abs=1e-6)  # from another program
        assert sigma_M.max() == pytest.approx(rate, abs=5e-5)
        assert sigma_L.max() == pytest.approx(gain, abs=5e-6)
        assert objective * (1 - 1e-5) < design.value < objective
        sigma_M, sigma_L = judged(design.filter, loop, Q, omega)
        assert design.value == pytest.approx(sigma_M[omega <= 0.02].sum(), rel=1e-12)
        for sigma, bound in ((sigma_M, 0.9), (sigma_L, 50)):
            assert bound * 0.98 < sigma.max() <= bound * (1 + 1e-6)
