"""The grid of frequencies that is chosen for a plant which is known everywhere."""

import control
import numpy as np
import pytest
from plants import lag, sigma_of_M

from ilctools import measured_response, synthesise, zero_phase_butterworth
from ilctools.signals import dataset


def test_nothing_passes_between_the_frequencies_of_a_measured_response():
    """A mode damped by 0.005, next to which 1000 frequencies are 0.9 % apart."""
    Ts, s = 0.01, control.tf("s")
    mode = 0.0015 * 20.05 * s / (s**2 + 0.01 * 20.05 * s + 20.05**2)
    P = control.ss(1 / (0.02 * s + 1) + mode).sample(Ts)
    Q = zero_phase_butterworth(2, 40.0, Ts)
    table = P(np.exp(1j * Ts * (lines := np.geomspace(0.01, np.pi / Ts, 5000)))).reshape(1, 1, -1)
    measured = measured_response(control.frd(table, lines, Ts))
    design = synthesise(measured, Q, order=15, M_max=0.5, L_max=5.0)
    omega = np.append(np.geomspace(0.05, np.pi / Ts, 5000), np.linspace(19.5, 20.5, 5000))
    M = sigma_of_M(omega, P, Q, design.filter)
    assert M.max() < design.certificate.rate + 1e-3 < 0.5


@pytest.mark.filterwarnings("ignore:sigma_max.M. may reach .* below")
def test_a_record_is_asked_from_where_a_period_fits_into_it():
    rng, logs = np.random.default_rng(0), []
    for samples in (80, 120):
        r = np.cumsum(rng.standard_normal(samples))
        y = control.forced_response(lag(), inputs=r).outputs + 0.01 * rng.standard_normal(samples)
        signals = {"reference": r, "v": 0 * r, "y": y}
        signals = {name: signal[None, :, None] for name, signal in signals.items()}
        logs.append(dataset(1.0, ["T"], [], [], {"T": "K"}, **signals))
    measured, first = measured_response(logs), 2 * np.pi / 120
    assert measured.omega[0] < first / 2
    assert first <= synthesise(measured).omega[0] < 1.05 * first  # the next of 200 frequencies
