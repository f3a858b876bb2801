from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paper import paper_loop

from ilctools import multisine
from ilctools.measurement.excitation import Excitation


@settings(max_examples=10)
@given(
    lowest=st.floats(5e-3, 0.05),
    decades=st.floats(0.3, 1.5),
    periods=st.floats(3.3, 9),
    amplitude=st.floats(0.1, 10),
    lines=st.integers(2, 40),
)
def test_any_excitation_keeps_what_it_promises(lowest, decades, periods, amplitude, lines):
    loop = paper_loop()
    hours = 2 * periods * 2 * np.pi / lowest / 3600 * 1.01
    excitation = multisine(loop, lowest, lowest * 10**decades, amplitude, hours, lines)
    w = excitation.signals
    assert w.shape == (2, excitation.samples, 2) and excitation.hours <= hours
    assert np.abs(w).max() == pytest.approx(amplitude)
    np.testing.assert_allclose(w[:, excitation.period :], w[:, : -excitation.period], atol=1e-9)
    W = np.fft.rfft(w[:, -excitation.period :], axis=1).transpose(1, 2, 0)
    excited = np.flatnonzero(np.abs(W).max(axis=(1, 2)) > 1e-9 * np.abs(W).max())
    np.testing.assert_allclose(
        2 * np.pi * excited / (excitation.period * loop.Ts), excitation.omega
    )
    assert excitation.omega[-1] <= lowest * 10**decades * (1 + 1e-3)
    values = np.linalg.svd(W[excited], compute_uv=False)  # all directions alike
    np.testing.assert_allclose(values, values[0, 0], rtol=1e-6)


def test_peaks_are_low(loop):
    excitation = multisine(loop, 2e-3, 0.3, 2.0, 6)
    rng = np.random.default_rng(0)
    n = len(excitation.harmonics)
    phases = rng.uniform(0, 2 * np.pi, (50, n))
    others = [replace(excitation, phases=row).crest for row in phases]
    assert excitation.crest < 0.85 * min(others) and excitation.crest < 2


GOOD = Excitation(1.0, 100, 4, harmonics=[1, 3], phases=[0, 1.0], amplitude=[2.0])


@pytest.mark.parametrize(
    ("name", "value"), [("lowest", 0), ("highest", 4.0), ("hours", 0.1), ("lines", 1)]
)
def test_an_excitation_that_cannot_be_is_refused(loop, name, value):
    asked = {"lowest": 0.02, "highest": 0.5, "amplitude": 1.0, "hours": 1.0}
    with pytest.raises(ValueError, match=name):
        multisine(loop, **asked | {name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [("harmonics", [3, 1]), ("harmonics", [1, 50]), ("phases", [0.0]), ("periods", 2)],
)
def test_a_note_of_an_excitation_that_cannot_be_is_refused(name, value):
    with pytest.raises(ValueError, match=name):
        replace(GOOD, **{name: value})
