"""Default band, grid and gain follow Q, Ts and P: for the rod they are the paper's."""

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rodlib import measured_response, zero_phase_butterworth
from rodlib.case import BAND, L_MAX
from rodlib.ilc.problem import defaults
from rodlib.ilc.problem.pose import pose


def test_of_the_papers_loop_they_are_the_papers(loop, Q, omega):
    chosen, paper = pose(loop, Q), pose(loop, Q, omega, band=BAND, L_max=L_MAX)
    np.testing.assert_allclose(chosen.omega, omega, rtol=1e-12)
    assert chosen.band == pytest.approx(BAND, rel=1e-12) and chosen.L_max == L_MAX
    names = [text.split(" = ")[0] for text in chosen.basis]
    assert names == ["chosen: band", "chosen: L_max"] and not paper.basis


@given(factor=st.floats(1e-6, 1e6), unit=st.floats(1e-6, 1e6))
def test_time_and_unit_may_be_others(factor, unit):
    """A lag 0.1 / (z - 0.9), ten times faster: all frequencies move along, and the gain stays."""
    slow, fast = (
        pose(control.ss(0.9, size, 0.1, 0, Ts), zero_phase_butterworth(2, 0.1 / Ts, Ts))
        for Ts, size in ((1.0, 1.0), (factor, unit))
    )
    np.testing.assert_allclose(fast.omega * factor, slow.omega, rtol=1e-9)
    np.testing.assert_allclose(np.array(fast.band) * factor, slow.band, rtol=1e-9)
    exact = abs(np.exp(0.1j) - 0.9) / 0.1 / unit  # 1 / |P| at the cut-off
    assert exact <= fast.L_max * (1 + 1e-3) and fast.L_max < 2.001 * exact


def test_of_several_channels_the_gain_inverts_the_weakest_direction():
    omega = np.geomspace(1e-3, np.pi, 60)
    for factor, gain in ((1.0, 4.0), (0.99, 5.0), (1e5, 4e-5)):
        P = factor * np.tile(np.diag([4.0, 0.25]), (60, 1, 1))
        assert pose(P, zero_phase_butterworth(2, 0.3), omega).L_max == gain


def test_cutoff_and_band_of_samples(Q):
    omega = np.geomspace(1e-4, np.pi, 100)
    samples = Q.frequency_response(omega)
    assert defaults.cutoff(None, samples, omega) == pytest.approx(0.1, rel=0.01)
    assert defaults.cutoff(None, samples / 3, omega) == omega[-1]
    few = np.array([0.0, 1.0, 2.0, 3.0])
    for cutoff, end in ((100.0, 3.0), (0.1, 2.0), (12.5, 2.5), (2.5, 2.5)):
        assert defaults.band(cutoff, few) == (1.0, end)


def test_samples_bring_their_frequencies_or_need_them(loop, Q):
    grid = np.geomspace(1e-3, np.pi, 60)
    P = loop.frequency_response(grid)
    frd = control.frd(np.moveaxis(P, 0, -1), grid)
    np.testing.assert_array_equal(pose(frd, Q).omega, grid)
    assert pose(measured_response(frd), Q, Ts=1.0).omega[0] == pytest.approx(1e-3)
    with pytest.raises(ValueError, match="omega must be given: P is an array"):
        pose(P, Q, Ts=1.0)
    with pytest.raises(ValueError, match="omega must be given, as Q"):
        pose(loop, np.ones(60), Ts=1.0)
