"""What python-control's users get back is called as theirs; what they pass: test_mistakes."""

import control
import numpy as np

from ilctools import LearningFilter

OMEGA = np.geomspace(1e-3, np.pi, 60)


def test_a_filter_is_called_at_z_as_their_systems_are():
    L = LearningFilter(np.random.default_rng(0).standard_normal((2, 2, 10)), 1.0)
    z = np.exp(1j * OMEGA)
    polynomials = [
        [[*c[::-1].tolist(), 0.0] for c in row] for row in L.coefficients
    ]  # their polynomials begin with the highest power
    theirs = control.TransferFunction(polynomials, [[[1.0]] * 2] * 2, 1.0)
    for points in (z[3], z, [0.5, 2.0j]):
        np.testing.assert_allclose(L(points), theirs(points), rtol=1e-10)
        assert np.shape(L(points)) == np.shape(theirs(points))
