"""What decides a cut-off that is chosen, and what it costs; on records whose plant is known."""

import re
import warnings

import control
import numpy as np
import pytest
from plants import LOOPS, lag

from ilctools import measured_response, synthesise, trial_norm, zero_phase_butterworth
from ilctools.models import impulse_response
from ilctools.response.door import response_of
from ilctools.signals import dataset
from ilctools.synthesis.cutoff import reached

TS = 20.0  # s
HOURS = (1.5, 1.75, 2.0, 2.25, 2.5)  # of batches of different lengths


def oven():
    """A slow thermal plant of 50 minutes in a PI loop, from set point to temperature."""
    s = control.tf("s")
    plant = control.sample_system(control.ss(0.8 / ((3000 * s + 1) * (200 * s + 1))), TS)
    controller = control.sample_system(control.ss(2 * (1 + 1 / (1500 * s))), TS, "tustin")
    return control.ss(control.feedback(plant * controller, 1))


def batches(P, noise=0.06, seed=3):
    """A log of each batch: the set point ramps up and is held; the thermometer is noisy."""
    rng = np.random.default_rng(seed)
    for hours in HOURS:
        samples = round(hours * 3600 / TS)
        start, ramp, height = rng.uniform([0.05, 0.2, 25], [0.15, 0.5, 45])
        ends = [0, start, start + ramp, 99]  # hours
        r = np.interp(TS / 3600 * np.arange(samples), ends, [0, 0, height, height])
        y = control.forced_response(P, TS * np.arange(samples), r).outputs
        y = y + noise * rng.standard_normal(samples)
        r, y = r[None, :, None], y[None, :, None]
        yield dataset(TS, ["T"], [], [], {"T": "K"}, reference=r, v=0 * r, y=y)


@pytest.fixture(scope="module")
def measured():
    return measured_response([*batches(oven())])


SLOW = pytest.mark.filterwarnings("ignore:sigma_max.M. may reach .* below")  # no batch resolves it
RESOLVED = 2 * np.pi / (HOURS[-1] * 3600)  # rad/s, whose period is the longest batch


@SLOW
def test_frequencies_that_no_batch_resolves_decide_no_cutoff(measured):
    """The lowest has a period of ten hours, and its radius is nearly as large as P."""
    P = oven()
    radius, size = measured.radius(0.99, jointly=True), abs(measured.response[:, 0, 0])
    assert measured.omega[0] < RESOLVED / 3.9 and radius[0] > 0.8 * size[0]
    known = (measured.omega > RESOLVED) & (measured.omega < 3e-3)
    assert np.all(radius[known] < 0.1 * size[known])
    design = synthesise(measured)
    assert RESOLVED <= design.omega[0] < 1.05 * RESOLVED  # the next of 200 frequencies
    # where P itself is a tenth of what it is at rest, by its formula
    omega = np.geomspace(1e-4, 0.1, 10**5)
    gain = abs(P(np.exp(1j * omega * TS)))
    assert design.Q.cutoff == pytest.approx(omega[np.argmax(gain < 0.1)], rel=0.25)
    assert design.check(P).gamma < 0.2


def trials(P, design, r, count=5):
    """RMS of the error in trials of the plant itself, by convolution."""
    h, v = impulse_response(P, len(r))[:, 0, 0], 0 * r
    for _ in range(count):
        e = r - np.convolve(h, (r + v)[:, 0])[: len(r), None]
        yield np.sqrt(np.mean(e**2))
        v = design.Q.apply(v + design.filter.apply(e))


@SLOW
def test_the_batches_teach_as_much_as_the_plant_itself_would(measured):
    """Against a design from the exact model with the same Q: what both leave is what Q stops."""
    P, (*_, log) = oven(), batches(oven())
    design = synthesise(measured)
    *_, exact = trials(P, synthesise(P, design.Q), log.reference.values[0])
    first, *_, last = trials(P, design, log.reference.values[0])
    assert last < 1.2 * exact and last < first / 10


@SLOW
def test_a_frequency_that_decides_is_named_with_its_price(measured):
    """All frequencies are asked for, so the lowest ones count; without them, the cut-off."""
    omega = np.geomspace(measured.omega[0], np.pi / TS, 1000)
    with warnings.catch_warnings(record=True, action="always") as caught:
        design = synthesise(measured, omega=omega)
    [said] = [str(w.message) for w in caught if "decides" in str(w.message)]
    numbers = r"from \S+ to (\S+) rad/s decides .* would be (\S+) rad/s instead of (\S+) rad/s"
    last, without, cutoff = map(float, re.search(numbers, said).groups())
    assert last < 1.2 * omega[0]
    assert cutoff == pytest.approx(design.Q.cutoff, rel=0.05)
    kept = synthesise(measured, omega=omega[omega > 1.05 * last])
    assert without == pytest.approx(kept.Q.cutoff, rel=0.05) and without > 5 * cutoff
    assert said in str(design) and f"without it {without:.2g} rad/s" in str(design)


def test_an_antiresonance_that_ends_the_reach_is_named():
    """P falls below a tenth of its gain at rest at 1 rad/s only, and again where it ends."""
    s = control.tf("s")
    P = (s**2 + 0.02 * s + 1) / (s + 1) ** 2 / (0.02 * s + 1)
    P = control.sample_system(control.ss(P), 2e-3)
    with pytest.warns(match=r"that P passes little from 0\.\d+ to 1\.\d* rad/s decides"):
        design = synthesise(P)
    assert design.Q.cutoff == pytest.approx(0.9, abs=0.1)
    text = design.problem.chosen[0]
    without = float(re.search(r"without it (\S+) rad/s", text)[1])
    # |P| is a tenth again where 1 / |0.02 j omega + 1| is, but for the zeros and poles at 1 rad/s
    assert without == pytest.approx(np.sqrt(99) / 0.02, rel=0.1)


def test_a_plant_that_just_ends_has_no_range_to_name():
    """Nor have two plants that differ from some frequency on."""
    late = lag() * control.tf([1], [1, 0, 0], 1.0)
    omega = np.geomspace(1e-3, np.pi, 400)
    for P, reason in ((lag(), "how far P reaches"), ([lag(), control.ss(late)], "plants agree")):
        limit = reached(response_of(P, omega), 0.3)
        assert reason in limit.reason and not limit.decisive and not limit.costly


def test_a_cutoff_that_is_halved_says_why_and_how_to_avoid_it():
    """B cut off to 60 samples: what the text offers has the norm that it states."""
    loop = LOOPS["stage"]()
    whole = synthesise(loop)
    with pytest.warns(match="half of what P admits, because there the norm") as caught:
        half = synthesise(loop, reach=60)
    text = str(caught[0].message)
    assert half.Q.cutoff == pytest.approx(whole.Q.cutoff / 2, rel=0.05)
    numbers = r"trial of (\d+) samples is (\S+): .*butterworth\(2, (\S+), (\S+)\).*rest=(\d+)\) "
    samples, norm, cutoff, Ts, rest, mended = map(
        float, re.search(numbers + r".* norm is (\S+)$", text).groups()
    )
    design = synthesise(loop, zero_phase_butterworth(2, cutoff, Ts), reach=60)
    for held, stated in ((0, norm), (int(rest), mended)):
        found = trial_norm(loop.P, design.Q, design.filter, int(samples), rest=held)[0]
        assert found == pytest.approx(stated, rel=0.05)
    assert mended < 1 <= norm and cutoff == whole.Q.cutoff
    assert "where the norm of a trial is" in str(half)


@pytest.mark.parametrize("M_max", [0.9, 0.5])
def test_without_a_decisive_range_the_cutoff_is_the_least_of_all_limits(M_max):
    """Against the rule written out, for plants that differ by their gain at a resonance."""
    omega = np.geomspace(1e-3, np.pi, 400)
    resonant = control.ss(control.tf([0.02, 0], [1, -1.96, 0.98], 1.0))
    plants = [lag(), control.ss(lag() + 0.05 * resonant)]
    limit = reached(response_of(plants, omega), M_max)
    P = np.array([plant(np.exp(1j * omega)) for plant in plants])
    b = abs(P[:, 0]).min() / 40
    B = P.mean(axis=0).conj() / (np.mean(abs(P) ** 2, axis=0) + b**2)
    d = abs(1 - P * B).max(axis=0) / (0.9 * M_max)
    weak = omega[abs(P).min(axis=0) < 0.1 * abs(P[:, 0]).min()][0]
    apart = (d > 1) & (omega > omega[0]) & (omega <= 2 * weak) & (omega < 3)
    x = (d[apart] - 1) ** 0.25
    least = min([weak, *(2 * np.arctan(np.tan(omega[apart] / 2) / x))])
    assert limit.omega == pytest.approx(least, rel=1e-12)
