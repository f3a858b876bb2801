"""Margins against plants that change by a little less and a little more, on dense grids."""

import re
from functools import cache

import control
import numpy as np
import pytest
from plants import STAGE_WITH_MODES as STAGE
from plants import lag

from ilctools import frequency_response, synthesise, zero_phase_butterworth
from ilctools.evidence.margins import GAINS, RADII, TIMES, TURN, highest, inwards

S, TS = control.tf("s"), 0.01
CUTOFF = 40.0
LOWPASS = zero_phase_butterworth(2, CUTOFF, TS)
SEEDS = range(36)
# The exact limit is within so much of the distance: splines of P and L miss M by 1e-3 of its crest
# at most, and M rises from its least to one, at a margin, over the distance
NEAR = 0.02
# of two tables, whose samples show too little of a mode; margins are those of the splines
COARSE = pytest.mark.filterwarnings("ignore:sigma_max.* between the frequencies omega")


def resonant(seed, channels=1, modes=1, delay=0):
    """A lag of second order with lightly damped modes, each beside an antiresonance."""
    random, entries = np.random.default_rng(seed), []
    for _ in range(channels):
        corner = random.uniform(25, 60)
        G = corner**2 / (S**2 + 1.2 * corner * S + corner**2)
        for _ in range(modes):
            mode = random.uniform(10, 80)
            zero = mode * random.choice([random.uniform(0.5, 0.95), random.uniform(1.05, 2)])
            of_zero, of_mode = 10 ** random.uniform(-2.6, -1, 2)
            G *= (S**2 / zero**2 + 2 * of_zero / zero * S + 1) / (
                S**2 / mode**2 + 2 * of_mode / mode * S + 1
            )
        entries.append(control.ss(G))
    model = control.append(*entries)
    mixed = np.eye(channels) + 0.3 * random.standard_normal((channels, channels))
    mixed = mixed if channels > 1 else np.eye(1)
    model = control.ss(model.A, model.B, mixed @ model.C, mixed @ model.D)
    model = control.sample_system(model, TS)
    if delay:
        register = control.ss(
            np.eye(delay, k=-1), np.eye(delay, 1), np.eye(1, delay, delay - 1), 0, TS
        )
        model = model * control.append(*[register] * channels)
    return model


@cache
def designed(seed):
    """A plant and its design: models, delays, two channels, radii, tables; None if infeasible."""
    kind = seed % 6
    P = resonant(seed, 2 if kind == 3 else 1, 1 + seed % 2, 7 if kind == 2 else 0)
    if kind < 4:
        return P, synthesise(P, LOWPASS)
    if kind == 4:
        return P, synthesise(P, LOWPASS, uncertainty=0.15)
    omega = np.union1d(np.geomspace(0.04, 300, 150), np.linspace(5, 100, 500))
    table, radius = frequency_response(P, omega), None if seed % 12 == 5 else 0.1
    return P, synthesise(table, LOWPASS, omega, TS, uncertainty=radius)


def dense(design, P):
    """Frequencies, and many more beside each mode and antiresonance."""
    omega = [np.linspace(0, np.pi / TS, 20_000), design.omega]
    features = [P.poles(), control.zeros(P) if P.ninputs == 1 else [], design.filter.poles]
    around = 1 + np.append(0, np.outer([-1, 1], np.geomspace(1e-5, 0.05, 40)))
    angles = np.abs(np.angle(np.concatenate(features)))
    omega.append(np.outer(angles[angles > 1e-4][:200] / TS, around).ravel())
    omega = np.unique(np.concatenate(omega))
    sampled = design.problem.response.sampled
    first, last = design.omega[[0, -1]] if sampled else (0, np.pi / TS)
    return omega[(omega >= first) & (omega <= last)]


def worst(M, r, L):
    """max over unit x of |M x| + r |L x|, by Cauchy and Schwarz over shares alpha; (n,)."""
    if M.shape[1] == 1 or not np.any(r):
        return np.linalg.norm(M, 2, axis=(1, 2)) + r * np.linalg.norm(L, 2, axis=(1, 2))
    bounds = []
    for alpha in np.linspace(0.02, 0.98, 49):
        rows = [M / np.sqrt(alpha), (r / np.sqrt(1 - alpha))[:, None, None] * L]
        bounds.append(np.linalg.norm(np.concatenate(rows, axis=1), 2, axis=(1, 2)))
    return np.min(bounds, axis=0)


def peak_of(design, model):
    """The largest worst case of M of a plant that changes, by the book."""
    omega, response = dense(design, model), design.problem.response
    Q, L = design.Q.frequency_response(omega), design.filter.frequency_response(omega)

    def peak(gain=1.0, delay=0.0, slower=1.0, radius=0.0):
        there = slower * omega
        known = there <= (omega[-1] if response.sampled else np.inf)
        P, own = response.anywhere(0, np.clip(there[known], omega[0], omega[-1]))
        P = gain * np.exp(-1j * omega[known] * delay * TS)[:, None, None] * P
        M = Q[known, None, None] * (np.eye(P.shape[1]) - P @ L[known])
        return worst(M, Q[known] * (gain * own + radius), L[known]).max()

    return peak


@COARSE
@pytest.mark.parametrize("seed", SEEDS)
def test_margins_of_plants_with_antiresonances_hold_just_inside_and_no_farther(seed):
    model, design = designed(seed)
    if design.rate >= 1:
        pytest.skip("the samples do not resolve its modes")
    margins, peak = design.margins, peak_of(design, model)
    (none, more), (sooner, later), (faster, slower) = margins.gain, margins.delay, margins.time
    P, _ = design.problem.response.anywhere(0, np.array([CUTOFF]))
    size, turn = np.linalg.norm(P[0], 2), TURN[-1] / (CUTOFF * TS)
    checked = 0
    for kind, design_value, limit, end in [
        ("gain", 1, more, GAINS[-1]),
        ("delay", 0, -sooner, -turn),
        ("delay", 0, later, turn),
        ("slower", 1, 1 / faster, 1 / TIMES[-1]),
        ("slower", 1, slower, TIMES[-1]),
        ("radius", 0, margins.radius * size, RADII[-1] * size),
    ]:
        inside, outside = (design_value + (1 + x) * (limit - design_value) for x in (-NEAR, NEAR))
        assert peak(**{kind: inside}) < 1
        if abs(limit - design_value) < 0.999 * abs(end - design_value):
            assert peak(**{kind: outside}) > 1
            checked += 1
    assert checked >= 3 and none == 0


@COARSE
@pytest.mark.parametrize("seed", SEEDS)
def test_design_check_says_the_same_of_gain_and_radius(seed):
    model, design = designed(seed)
    if design.rate >= 1:
        pytest.skip("the samples do not resolve its modes")
    problem, margins = design.problem, design.margins
    gain, sampled = margins.gain[1], problem.response.sampled
    size = np.linalg.norm(problem.response.anywhere(0, np.array([CUTOFF]))[0][0], 2)
    radius = 0 * problem.omega if problem.radius is None else problem.radius
    for share, inside in ((1 - NEAR, True), (1 + NEAR, False)):
        g, r = 1 + share * (gain - 1), share * margins.radius * size
        P = problem.P if sampled else model
        for changed, more in ((g * P, g * radius), (P, radius + r)):
            found = design.check(changed, problem.omega, uncertainty=more)
            assert (found.gamma < 1) == inside or (not inside and gain == GAINS[-1])


def antiresonance(slower=1.0):
    """A zero at 15 rad/s with a damping of 0.005, a mode at 22 with 0.02, behind 30 rad/s."""
    G = 900 / (S**2 + 36 * S + 900) * (S**2 / 225 + 0.01 / 15 * S + 1)
    G = control.ss(G / (S**2 / 484 + 0.04 / 22 * S + 1))
    return control.sample_system(control.ss(G.A / slower, G.B / slower, G.C, G.D), TS)


def test_a_plant_as_slow_as_is_printed_converges_and_one_a_tenth_slower_does_not():
    """A slower plant, sampled anew, differs from P(a omega) by less than 1e-3 of the distance."""
    design = synthesise(antiresonance(), LOWPASS)
    found = re.search(r"([\d.]+) % faster to ([\d.]+) % slower", repr(design))
    faster, slower = map(float, found.groups())
    assert design.check(antiresonance(1 + slower / 100)).gamma < 1
    assert design.check(antiresonance(1 / (1 + faster / 100))).gamma < 1
    assert design.check(antiresonance(1 + 1.1 * slower / 100)).gamma > 1
    assert design.check(antiresonance(1 / (1 + 1.1 * faster / 100))).gamma > 1


@pytest.mark.parametrize("base", [None, "auto"])
def test_the_radius_is_that_of_the_slower_plant_at_its_frequency(base):
    """A slower plant brings a radius from above the cut-off to where Q passes it."""
    P, Q = lag(0.7, Ts=0.5), zero_phase_butterworth(2, 0.6, 0.5)
    omega = np.linspace(1e-3, 2 * np.pi, 4000)
    size = np.abs(frequency_response(P, omega)[:, 0, 0])
    radius = 0.7 * size * np.exp(-(((omega - 0.9) / 0.04) ** 2))
    design = synthesise(P, Q, omega, uncertainty=radius, base=base)
    low, L = (f.frequency_response(omega).ravel() for f in (Q, design.filter))

    def peak(slower, r):
        there = np.minimum(slower * omega, omega[-1])
        M = low * (1 - frequency_response(P, there).ravel() * L)
        return np.max(np.abs(M) + low * np.interp(r * omega, omega, radius) * np.abs(L))

    limit = design.margins.time[1]
    near = 0.01 * (limit - 1)  # the grid has 10 frequencies for the width of the moved radius
    assert peak(limit - near, limit - near) < 1 < peak(limit + near, limit + near)
    assert peak(limit + near, 1.0) < 0.9  # with the radius of the nominal plant at omega


def test_a_list_has_the_least_margins_of_its_plants_and_print_says_them():
    lowpass = zero_phase_butterworth(2, 60.0, STAGE.dt)
    plants = [STAGE, 1.2 * STAGE, 0.9 * STAGE]
    design = synthesise(plants, lowpass)
    gain = design.margins.gain[1]
    assert design.check([(1 + 0.99 * (gain - 1)) * P for P in plants]).gamma < 1
    assert design.check([(1 + 1.01 * (gain - 1)) * P for P in plants]).gamma > 1
    higher = f"gain 100 % lower to {np.floor(100 * (gain - 1)):g} % higher, delay "
    assert higher in repr(design)


@pytest.mark.parametrize(
    ("distance", "expected"),
    [(0.00563, 0.0056), (0.29, 0.29), (0.3, 0.3), (57.99, 57), (7.0, 7), (700, 700), (699, 690),
     (0.0, 0), (-1e-9, 0), (9.99e-5, 9.9e-5), (100.0, 100)],
)  # fmt: skip
def test_what_is_printed_is_rounded_inwards_to_two_digits(distance, expected):
    assert inwards(distance) == pytest.approx(expected, rel=1e-14)


def test_the_height_of_a_crest_is_that_of_its_parabola_but_not_over_a_jump():
    omega = np.array([0.0, 0.7, 1.3, 2.0])
    sigma = 1.01 - 0.05 * (omega - 1) ** 2
    assert highest(omega, sigma, np.array([])) == pytest.approx(1.01, abs=1e-14)
    assert highest(omega, sigma, np.array([1.0])) == sigma.max()
