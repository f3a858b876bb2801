"""The regression behind `transfer`, on regressors drawn at random."""

import numpy as np
import pytest

from ilctools.trials.transfer import ROUNDED_POWER, _Fits

EPS = np.finfo(float).eps


@pytest.mark.parametrize("seed", range(10))
def test_what_a_fit_misses_below_rounding_makes_it_no_more_likely(seed):
    """Targets that the regressors give exactly: all fits that miss less than rounding are level.

    A fit with the weight w misses some w of a target, w^2 of its power, and rounding leaves some
    ten EPS of the power. With a floor of ROUNDED_POWER the logarithm differs by their ratio at most.
    """
    rng = np.random.default_rng(seed)
    Phi, f = rng.standard_normal((3, 200, 4)), rng.standard_normal((4, 1))
    fits = _Fits(Phi, Phi @ f)
    faint = [fits.likelihood(1.0, 1.0, weight)[0] for weight in (1e-9, 1e-10)]
    assert abs(np.diff(faint)) < len(Phi) * 10 * EPS / ROUNDED_POWER
    strong = fits.likelihood(1.0, 1.0, 1e-3)[0]
    assert strong < min(faint) - 10  # which misses 1e-6 of the power, far above rounding
