"""The grid of frequencies that is chosen for a plant which is known everywhere."""

import control
import numpy as np
import pytest
from plants import lag, sigma_of_M

from ilctools import ClosedLoop, measured_response, synthesise, zero_phase_butterworth
from ilctools.models import frequency_response
from ilctools.response.measured import Measured
from ilctools.signals import dataset

Ts, RADIUS = 0.01, 1e-4


class Estimate(Measured):
    """A response that is known everywhere, of a model."""

    def __init__(self, P):
        self.P, self.loop = P, ClosedLoop(None, Ts, ["y"])
        self.omega = np.geomspace(0.01, np.pi / Ts, 200)
        self.response = frequency_response(P, self.omega)

    def _anywhere(self, omega, confidence):
        return frequency_response(self.P, omega), np.full(len(omega), RADIUS)

    def _scaled(self, scale):
        return self

    def _basis(self, omega, confidence):
        return ()


def test_nothing_passes_between_the_frequencies_of_an_estimate():
    """A mode damped by 0.005, next to which 1000 frequencies are 0.9 % apart."""
    mode = control.tf([0.00075 * 20.05, 0], [1, 0.01 * 20.05, 20.05**2])
    P = control.ss(control.tf([1], [0.02, 1]) + mode * 2).sample(Ts)
    Q = zero_phase_butterworth(2, 40.0, Ts)
    design = synthesise(Estimate(P), Q, order=15, M_max=0.5, L_max=5.0)
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
