"""Margins against plants that are off by a little less and a little more, on dense grids."""

import control
import numpy as np
import pytest
from plants import random_stable

from ilctools import frequency_response, synthesise, zero_phase_butterworth
from ilctools.evidence.margins import RADII, TIMES, TURN

S = control.tf("s")
STAGE = control.sample_system(
    control.ss(1e4 / (S**2 + 120 * S + 1e4) * (0.9 + 0.1 * 4e4 / (S**2 + 4 * S + 4e4))), 1e-3
)
DENSE = 10**5


def peak(design, at=lambda omega: omega, factor=lambda omega: 1.0, radius=0.0):
    """The largest sigma_max(M) of P(at(omega)) times a factor, within a radius of one channel."""
    P, Q, L, Ts = design.problem.response.models[0], design.Q, design.filter, design.Ts
    omega = np.linspace(design.omega[0], np.pi / Ts, DENSE)
    P = frequency_response(P, np.clip(at(omega), design.omega[0], np.pi / Ts))
    P = P * np.broadcast_to(factor(omega), omega.shape)[:, None, None]
    L, Q = L.frequency_response(omega), Q.frequency_response(omega)
    M = np.linalg.norm(Q[:, None, None] * (np.eye(len(P[0])) - P @ L), 2, axis=(1, 2))
    return (M + Q * radius * np.linalg.norm(L, 2, axis=(1, 2))).max()


@pytest.mark.parametrize("seed", [None, 1])
@pytest.mark.parametrize("choices", [{}, {"base": None}])
def test_a_plant_that_is_off_by_less_converges_and_one_that_is_off_by_more_does_not(seed, choices):
    if seed is None:
        P, cutoff = STAGE, 150.0
    else:
        P, cutoff = random_stable(seed, m=1, distance=0.2), 0.6
        P = P / np.abs(P(1))
    design = synthesise(P, zero_phase_butterworth(2, cutoff, P.dt), **choices)
    margins, Ts, checked = design.margins, design.Ts, 0
    size = np.abs(P(np.exp(1j * cutoff * Ts)))
    kinds = [
        (margins.gain[1] - 1, 9, lambda x: {"factor": lambda omega: 1 + x}),
        *(
            (d, TURN[-1] / cutoff / Ts,
             lambda x, sign=sign: {"factor": lambda omega: np.exp(sign * 1j * omega * x * Ts)})
            for d, sign in zip(margins.delay, (1, -1), strict=True)
        ),
        (margins.time[0], TIMES[-1], lambda x: {"at": lambda omega: omega / x}),
        (margins.time[1], TIMES[-1], lambda x: {"at": lambda omega: omega * x}),
        (margins.radius, RADII[-1], lambda x: {"radius": x * size}),
    ]  # fmt: skip
    for margin, end, changed in kinds:
        stretched = "at" in changed(1.0)
        less, more = ((margin - stretched) * share + stretched for share in (0.99, 1.01))
        assert peak(design, **changed(less)) < 1
        if margin < 0.999 * end:
            assert peak(design, **changed(more)) > 1
            checked += 1
    assert checked >= 3 and margins.gain[0] == 0


def test_a_list_has_the_least_margins_of_its_plants_and_print_says_them():
    plants = [STAGE, 1.2 * STAGE]
    design = synthesise(plants, zero_phase_butterworth(2, 60.0, 1e-3))
    gain = design.margins.gain[1]
    omega = np.linspace(design.omega[0], np.pi / 1e-3, DENSE)
    L, Q = design.filter.frequency_response(omega)[:, 0, 0], design.Q.frequency_response(omega)
    P = frequency_response(1.2 * STAGE, omega)[:, 0, 0]
    for share, above in ((0.99, False), (1.01, True)):
        M = np.abs(Q * (1 - (1 + (gain - 1) * share) * P * L)).max()
        assert (M > 1) == above
    assert f"gain 0 to {gain:.3g} times" in repr(design)


def test_of_a_table_only_its_own_frequencies_count():
    omega = np.geomspace(0.1, 400, 300)
    P = frequency_response(STAGE, omega)
    design = synthesise(P, zero_phase_butterworth(2, 60.0, 1e-3), omega, 1e-3)
    model = synthesise(STAGE, zero_phase_butterworth(2, 60.0, 1e-3))
    np.testing.assert_allclose(design.margins.gain, model.margins.gain, rtol=0.05)
    np.testing.assert_allclose(design.margins.delay, model.margins.delay, rtol=0.05)
