"""What a certificate says in print, word for word; its numbers are judged by other tests."""

import numpy as np
import pytest
from paper import paper_choices
from plants import lags

from ilctools import frequency_response, synthesise, zero_phase_butterworth

BUTTERWORTH = zero_phase_butterworth(2, 0.3, 1.0)
ASKED = {"order": 4, "M_max": 0.99, "L_max": 5.0, "band": (1e-2, 0.1), "structure": "full"}


def test_of_one_plant(loop, Q, omega):
    """Which lags by the zeros of the loop, see notebook 7."""
    good = synthesise(loop, Q, omega[::5], 1.0, **paper_choices(band=(1e-4, 0.01))).certificate
    assert good.failures == good.warnings == []
    trial = good.settled_trial
    expected = f"""\
rate at most {good.rate:.4f}, at all frequencies, proven; largest near 0.041 rad/s
{good.margins}
P is diag(1, 1) at zero frequency; the cut-off of Q is 0.1 rad/s; P has a delay of 17 samples \
there; sigma_max(L) is {good.all_L:.3g}; the norm of a trial of {trial.samples} samples \
is {trial.norm:.3g}
limited by M_max = 0.9, L_max = 50, order = 10; \
mean of sigma_max(M) over the band: {good.mean_M:.4f}, from 0.0001 to 0.01 rad/s"""
    assert f"{good}" == expected


def test_of_tables_that_end_early():
    omega = np.geomspace(1e-2, 2.0, 50)
    models = lags(), lags(1.3), lags(0.8, 0.93)
    P = np.stack([frequency_response(model, omega) for model in models])
    design = synthesise(P, BUTTERWORTH, omega, 1.0, **ASKED)
    tables = design.certificate
    between, above = tables.peaks["estimated"], tables.peaks["assumed"]
    below = tables.peaks["assumed below the first sample"]
    moves = max(samples.moves for samples in tables.problem.response.samples)
    assert f"{design}".endswith("\nassumptions: see .certificate.details")
    assert f"{design}".startswith(f"rate at most {design.rate:.4f} for each of 3 plants, at all")
    expected = f"""\
0.99       M_max
{tables.grid_M:<11.5g}sigma_max(M), on the grid, of plant 1 at 0.01 rad/s
{between.sigma:<11.5g}sigma_max(M), estimated, of plant {between.plant} at {between.omega:.4g} rad/s
{below.sigma:<11.5g}sigma_max(M), assumed below the first sample, of plant {below.plant} at \
{below.omega:.4g} rad/s
{above.sigma:<11.5g}sigma_max(M), assumed, of plant 0 at 2 rad/s
5          L_max
{tables.sigma_L.max():<11.5g}sigma_max(L), on the grid
{tables.all_L:<11.5g}sigma_max(L), at all frequencies
{tables.value:<11.5g}objective
{tables.lower_bound:<11.5g}lower bound of the objective
mean of sigma_max(M) of the nominal plant over the band: {tables.mean_M:.4f}, from 0.01 to 0.1 rad/s
assumed: below 0.01 rad/s, P is within {100 * moves:.2g} % of a straight line from P there to its \
real part at zero frequency
assumed: above 2 rad/s, where P is not known, sigma_max(P) is at most 0.1714, at any phase
assumed: between the frequencies omega, the error of the cubic splines of P is not larger than at \
samples that are left out, over log omega"""
    assert tables.details == expected
    high = BUTTERWORTH.frequency_response([2.0])[0]
    assert high < design.rate == pytest.approx(design.check(P, omega).rate, rel=1e-12)
