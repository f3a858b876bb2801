"""What a design says of itself, against numpy; and what it does to another plant."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from plants import lags, sigma_of_M

from ilctools import synthesise, zero_phase_butterworth
from ilctools.models import frequency_response


def test_singular_values_are_those_of_numpy_in_units_of_scale():
    """And a table without frequencies is judged on those of the design."""
    Q, scale = zero_phase_butterworth(2, 0.3, 1.0), np.array([1.0, 5.0])
    design, units = synthesise(lags(), Q, order=6, scale=scale), scale / scale[:, None]
    P = frequency_response(lags(), design.omega)
    L = design.filter.frequency_response(design.omega)
    sigma_M = sigma_of_M(design.omega, P * units, Q, L * units)
    assert_allclose(design.sigma_M, sigma_M, rtol=1e-9)
    assert_allclose(design.sigma_L, np.linalg.matrix_norm(L * units, ord=2))
    assert design.check(P).rate == pytest.approx(sigma_M.max(), rel=1e-3)
