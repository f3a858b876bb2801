"""Margins against plants that are off by a little less and a little more, on dense grids."""

import numpy as np
import pytest
from plants import STAGE_WITH_MODES as STAGE
from plants import random_stable

from ilctools import frequency_response, synthesise, zero_phase_butterworth
from ilctools.evidence.margins import GAINS, RADII, TIMES, TURN

LOWPASS = zero_phase_butterworth(2, 60.0, STAGE.dt)


def peak_of(design, plant, share=0.0):
    """The largest |M| of a plant of one channel within a share of it, and with what is off."""
    first, last = design.omega[0], np.pi / design.problem.Ts
    omega = np.linspace(first, last, 20_000)
    Q, L = (f.frequency_response(omega).ravel() for f in (design.Q, design.filter))

    def peak(gain=1.0, delay=0.0, slower=1.0, radius=0.0):
        P = frequency_response(plant, np.clip(slower * omega, first, last)).ravel()
        turned = gain * np.exp(-1j * omega * delay * design.problem.Ts)
        radius = radius + share * np.abs(turned * P)
        return np.max(np.abs(Q * (1 - turned * P * L)) + Q * radius * np.abs(L))

    return peak


@pytest.mark.parametrize("seed", [None, 1])
@pytest.mark.parametrize("choices", [{}, {"base": None}, {"uncertainty": 0.3}])
def test_a_plant_that_is_off_by_less_converges_and_one_that_is_off_by_more_does_not(seed, choices):
    P, cutoff = STAGE, 150.0
    if seed is not None:
        P, cutoff = random_stable(seed, m=1, distance=0.2), 0.6
        P = P / np.abs(P(1))
    design = synthesise(P, zero_phase_butterworth(2, cutoff, P.dt), **choices)
    peak = peak_of(design, P, choices.get("uncertainty", 0.0))
    margins, checked = design.margins, 0
    (none, more), (sooner, later), (faster, slower) = margins.gain, margins.delay, margins.time
    size, turn = np.abs(P(np.exp(1j * cutoff * P.dt))), TURN[-1] / (cutoff * P.dt)
    for kind, design_value, limit, end in [
        ("gain", 1, more, GAINS[-1]),
        ("delay", 0, -sooner, turn),
        ("delay", 0, later, turn),
        ("slower", 1, 1 / faster, 1 / TIMES[-1]),
        ("slower", 1, slower, TIMES[-1]),
        ("radius", 0, margins.radius * size, RADII[-1] * size),
    ]:
        step = np.copysign(0.07 * abs(limit), limit - design_value)  # two digits
        inside, outside = limit - step, limit + step
        assert peak(**{kind: inside}) < 1
        if abs(limit - design_value) < 0.999 * abs(end - design_value):
            assert peak(**{kind: outside}) > 1
            checked += 1
    assert checked >= 3 and none == 0


def test_a_list_has_the_least_margins_of_its_plants_and_print_says_them():
    design = synthesise([STAGE, 1.2 * STAGE], LOWPASS)
    gain, peak = design.margins.gain[1], peak_of(design, 1.2 * STAGE)
    assert peak(gain=0.05 + 0.95 * gain) < 1 < peak(gain=1.05 * gain - 0.05)
    assert f"gain 0 to {gain:.3g} times" in repr(design)
