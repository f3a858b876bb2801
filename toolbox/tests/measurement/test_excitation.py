"""Excitations: multisines, and what they promise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paper import paper_loop

from ilctools import ClosedLoop, multisine


@settings(max_examples=10)
@given(
    lowest=st.floats(5e-3, 0.05),
    decades=st.floats(0.3, 1.5),
    periods=st.floats(6.1, 20),
    amplitude=st.floats(0.1, 10),
    lines=st.integers(2, 40),
)
def test_any_excitation_keeps_what_it_promises(lowest, decades, periods, amplitude, lines):
    loop = paper_loop()
    hours = 2 * periods * 2 * np.pi / lowest / 3600 * 1.01
    excitation = multisine(loop, lowest, lowest * 10**decades, amplitude, hours, lines)
    w = excitation.signals
    realisations = len(excitation.phases)
    assert w.shape == (2 * realisations, excitation.samples, 2) and excitation.hours <= hours
    peaks = np.abs(w).reshape(realisations, -1).max(axis=1)
    np.testing.assert_allclose(peaks, amplitude)
    np.testing.assert_allclose(w[:, excitation.period :], w[:, : -excitation.period], atol=1e-9)
    W = np.fft.rfft(w[:, -excitation.period :], axis=1).reshape(realisations, 2, -1, 2)
    W = W.transpose(0, 2, 3, 1)  # (realisation, frequency, input, experiment)
    excited = np.flatnonzero(np.abs(W).max(axis=(0, 2, 3)) > 1e-9 * np.abs(W).max())
    np.testing.assert_allclose(
        2 * np.pi * excited / (excitation.period * loop.Ts), excitation.omega
    )
    assert excitation.omega[-1] <= lowest * 10**decades * (1 + 1e-3)
    values = np.linalg.svd(W[:, excited], compute_uv=False)  # all directions alike
    np.testing.assert_allclose(values, values[:, :1, :1] + 0 * values, rtol=1e-6)


def test_peaks_are_low():
    """Random phases have a crest factor of three; of two channels one experiment is enough."""
    excitation = multisine(ClosedLoop(Ts=1.0, outputs=[*"abc"]), 4e-3, 0.3, 2.0, 9)
    assert 2.0 / np.std(excitation.signals) < 2.2


def test_realisations_are_as_many_as_the_time_allows_or_as_asked_and_phases_those_of_a_seed(loop):
    def of(hours, **asked):
        excitation = multisine(loop, 0.02, 0.3, 1.0, hours, 5, **asked)
        return len(excitation.phases), excitation.periods

    hour = 2 * round(2 * np.pi / 0.02) / 3600  # a period of both inputs
    found = [of(n * hour * 1.001) for n in (6, 8, 9, 31)]
    assert found == [(2, 2), (2, 3), (3, 2), (10, 2)]
    assert of(10 * hour * 1.001, realisations=2) == (2, 4)
    one, same, other = (multisine(loop, 0.02, 0.3, 1.0, 1.2, 5, seed=k).phases for k in (0, 0, 1))
    assert one == same != other
    with pytest.raises(
        ValueError, match="in 4 realisations of one experiment for each input: take hours = 2"
    ):
        multisine(loop, 0.02, 0.3, 1.0, 1.2, 5, realisations=4)


ASKED = {"lowest": 0.02, "highest": 0.5, "amplitude": 1.0, "hours": 1.1}


@pytest.mark.parametrize("changes", [{"lowest": 0}, {"highest": 4.0}, {"lines": 1}])
def test_an_excitation_that_cannot_be_is_refused(loop, changes):
    with pytest.raises(ValueError, match=next(iter(changes))):
        multisine(loop, **ASKED | changes)
