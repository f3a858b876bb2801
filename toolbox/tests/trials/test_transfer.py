"""The regression behind `transfer`, on regressors drawn at random."""

import numpy as np

from ilctools.trials.transfer import ROUNDING, _Fits


def test_what_a_fit_misses_below_rounding_makes_it_no_more_likely():
    """Targets that the regressors give exactly: weights below the root of rounding are level.

    A fit with the weight w misses some w of a target, w^2 of its power. Where that is less than
    ROUNDING, the logarithm differs by less than the share w^2 / ROUNDING.
    """
    rng = np.random.default_rng(1)
    Phi, f = rng.standard_normal((3, 200, 4)), rng.standard_normal((4, 1))
    fits = _Fits(Phi, Phi @ f)
    faint, fainter = (fits.likelihood(1.0, 1.0, weight)[0] for weight in (1e-9, 1e-10))
    shares = len(Phi) * 1e-9**2 / ROUNDING
    assert abs(faint - fainter) < shares
    strong = fits.likelihood(1.0, 1.0, 1e-3)[0]
    assert strong < faint - 10  # which misses 1e-6 of the power, far above rounding
