"""Margins against plants that change by a little less and a little more, on dense grids."""

import control
import numpy as np
import pytest
from plants import STAGE_WITH_MODES as STAGE

from ilctools import frequency_response, synthesise, zero_phase_butterworth
from ilctools.evidence.margins import inwards
from ilctools.evidence.robustness import within_radius

S, TS, CUTOFF = control.tf("s"), 0.01, 40.0
LOWPASS = zero_phase_butterworth(2, CUTOFF, TS)
# The exact limit is within so much of the distance: splines of P and L miss M by 1e-3 of its crest
# at most, and M rises from its least to one, at a margin, over the distance
NEAR = 0.02


def resonant(zero, mode, of_zero=0.005, of_mode=0.02):
    """A lag of second order with a lightly damped mode, and an antiresonance beside it."""
    G = 1600 / (S**2 + 48 * S + 1600) * (S**2 / zero**2 + 2 * of_zero / zero * S + 1)
    G = control.ss(G / (S**2 / mode**2 + 2 * of_mode / mode * S + 1))
    return control.sample_system(G, TS)


def coupled(of_zero):
    """Two of them, which share their outputs."""
    both = control.append(resonant(15, 22, of_zero), resonant(60, 35, of_zero))
    return control.ss(both * np.array([[1.0, 0.3], [-0.2, 1.0]]))


PLANTS = {  # with a radius, and whether P is a table
    "a model": (resonant(15, 22), None, False),
    "a mode above the cut-off": (resonant(150, 90, of_mode=0.001), None, False),
    "a mode below its antiresonance": (resonant(60, 25, of_mode=0.001), None, False),
    "with a radius": (resonant(30, 50), 0.15, False),
    "two channels": (coupled(0.005), None, False),
    "two channels, with a radius": (coupled(0.1), 0.02, False),
    "a table": (resonant(30, 50, 0.03), None, True),
    "a table with a radius": (resonant(30, 50, 0.03), 0.1, True),
}


def designed(P, radius, is_table):
    """With the default L = B; a table begins at 0.04 rad/s and is dense enough for its modes."""
    if not is_table:
        return synthesise(P, LOWPASS, uncertainty=radius)
    omega = np.union1d(np.geomspace(0.04, 300, 150), np.linspace(5, 100, 1500))
    return synthesise(frequency_response(P, omega), LOWPASS, omega, TS, uncertainty=radius)


def peak_of(design, model):
    """The largest worst case of M of a plant that changes, by the book, beside modes very dense."""
    response, sampled = design.problem.response, design.problem.response.sampled
    around = 1 + np.append(0, np.outer([-1, 1], np.geomspace(1e-5, 0.05, 40)))
    angles = np.abs(np.angle(np.append(model.poles(), design.filter.poles)))
    crests = np.outer(angles[angles > 1e-4] / TS, around).ravel()
    first, last = design.omega[[0, -1]] if sampled else (0, np.pi / TS)

    def peak(gain=1.0, delay=0.0, slower=1.0, radius=0.0):
        omega = np.unique([*np.linspace(0, np.pi / TS, 3000), *crests, *crests / slower])
        end = min(last, last / slower) if sampled else last
        omega = omega[(omega >= first) & (omega <= end)]
        Q, L = design.Q.frequency_response(omega), design.filter.frequency_response(omega)
        P, own = response.anywhere(0, np.clip(slower * omega, first, last))
        P = gain * np.exp(-1j * omega * delay * TS)[:, None, None] * P
        return within_radius(P, Q, L, gain * own + radius, level=1).max()

    return peak


@pytest.mark.parametrize("name", PLANTS)
def test_margins_hold_just_inside_and_no_farther(name):
    design = designed(*PLANTS[name])
    margins, peak = design.margins, peak_of(design, PLANTS[name][0])
    (none, more), (sooner, later), (faster, slower) = margins.gain, margins.delay, margins.time
    P, _ = design.problem.response.anywhere(0, np.array([CUTOFF]))
    radius = margins.radius * np.linalg.norm(P[0], 2)
    assert none == 0
    for what, nominal, limit in [
        ("gain", 1, more), ("delay", 0, -sooner), ("delay", 0, later),
        ("slower", 1, 1 / faster), ("slower", 1, slower), ("radius", 0, radius),
    ]:  # fmt: skip
        inside, outside = (nominal + (1 + x) * (limit - nominal) for x in (-NEAR, NEAR))
        assert peak(**{what: inside}) < 1 < peak(**{what: outside})


def test_a_list_has_the_least_margins_of_its_plants_and_print_says_them():
    lowpass = zero_phase_butterworth(2, 60.0, STAGE.dt)
    plants = [STAGE, 1.2 * STAGE, 0.9 * STAGE]
    design = synthesise(plants, lowpass)
    more = design.margins.gain[1] - 1
    assert design.check([(1 + 0.99 * more) * P for P in plants]).converges
    assert not design.check([(1 + 1.01 * more) * P for P in plants]).converges
    assert f"gain 100 % lower to {np.floor(100 * more):g} % higher, delay " in repr(design)


@pytest.mark.parametrize(
    ("distance", "expected"),
    [(0.00563, 0.0056), (0.29, 0.29), (57.99, 57), (699, 690), (0.0, 0), (-1e-9, 0)],
)
def test_what_is_printed_is_rounded_inwards_to_two_digits(distance, expected):
    assert inwards(distance) == pytest.approx(expected, rel=1e-14)
