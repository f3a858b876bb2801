"""A program, against finite differences of what it bounds."""

import numpy as np
import pytest
from plants import complex_normal, random_response
from problems import posed

from ilctools.synthesis.formulate import formulate


@pytest.mark.parametrize("structure", ["full", "diagonal"])
def test_the_derivative_with_respect_to_x_is_that_of_finite_differences(structure):
    """Of sum Re tr(W G), with bounds on M, on L and within a radius."""
    P, Q, omega = random_response(0, 2, 7)
    choices = {"order": 3, "L_max": 8.0, "uncertainty": 0.1, "structure": structure}
    program = formulate(posed(P, Q, omega, 1.0, **choices)).program
    rng, bounds = np.random.default_rng(0), program.bounds
    W = [complex_normal(rng, *bound.T.swapaxes(0, 1).shape) for bound in bounds]
    x = rng.standard_normal((len(program.rows), 3))

    def value(x):
        pairs = zip(W, program.matrices(x), strict=True)
        return sum(np.einsum("ijc,jic->", *pair).real for pair in pairs)

    of_L = [program.of_entries(*pair) for pair in zip(bounds, W, strict=True)]
    assert 2 * (program.onto_x(of_L) * x).sum() == pytest.approx(value(x) - value(-x), rel=1e-9)
