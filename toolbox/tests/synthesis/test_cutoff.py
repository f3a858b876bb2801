"""What decides a cut-off that is chosen, and what it costs."""

import re

import control
import numpy as np
import pytest
from plants import LOOPS, lag

from ilctools import measured_response, synthesise, trial_norm, zero_phase_butterworth
from ilctools.models import frequency_response
from ilctools.response.door import response_of
from ilctools.synthesis.cutoff import choose_cutoff

LAG, SLOW = lag(0.5), lag()
LINES = np.geomspace(0.01, 2, 40)
RESPONSE = LAG(np.exp(1j * LINES)).reshape(1, 1, -1)


def test_frequencies_with_a_large_radius_are_named_with_their_price():
    """A table whose lowest frequencies are hardly known: without them, the cut-off."""
    omega = np.geomspace(1e-3, np.pi, 200)
    P, known = frequency_response(lag(), omega), omega > 2e-3
    radius = np.where(known, 0.01, 0.86) * abs(P[:, 0, 0])
    with pytest.warns(UserWarning, match="decides") as caught:
        design = synthesise(P, omega=omega, Ts=1.0, uncertainty=radius, M_max=0.95)
    [said] = [str(w.message) for w in caught if "decides" in str(w.message)]
    numbers = r"from 0.001 to (\S+) rad/s decides .* is (\S+) rad/s; .* would be (\S+) rad/s"
    last, cutoff, without = map(float, re.search(numbers, said).groups())
    assert last == pytest.approx(omega[~known][-1], rel=0.05)
    assert cutoff == pytest.approx(design.Q.cutoff, rel=0.05)
    kept = synthesise(P[known], omega=omega[known], Ts=1.0, uncertainty=radius[known], M_max=0.95)
    assert without == pytest.approx(kept.Q.cutoff, rel=0.05) and without > 5 * cutoff
    assert said in str(design) and f"the cut-off would be {without:.2g} rad/s" in str(design)


def test_an_antiresonance_that_ends_the_reach_is_named():
    """P falls below a tenth of its gain at rest at 1 rad/s only, and again where it ends."""
    s = control.tf("s")
    P = (s**2 + 0.02 * s + 1) / (s + 1) ** 2 / (0.02 * s + 1)
    P = control.sample_system(control.ss(P), 2e-3)
    with pytest.warns(match=r"the small gain of P from 0\.\d+ to 1\.\d* rad/s decides"):
        design = synthesise(P)
    assert design.Q.cutoff == pytest.approx(0.9, abs=0.1)
    text = design.problem.defaults_chosen[0]
    without = float(re.search(r"would be (\S+) rad/s", text)[1])
    # |P| is a tenth again where 1 / |0.02 j omega + 1| is, but for the zeros and poles at 1 rad/s
    assert without == pytest.approx(np.sqrt(99) / 0.02, rel=0.1)


def test_a_plant_that_just_ends_has_no_range_to_name():
    """Nor have two plants that differ from some frequency on."""
    late = lag() * control.tf([1], [1, 0, 0], 1.0)
    omega = np.geomspace(1e-3, np.pi, 400)
    two = [lag(), control.ss(late)]
    for P, reason in ((lag(), "the small gain of P"), (two, "differences between the plants")):
        limit = choose_cutoff(response_of(P, omega), 0.3)
        assert reason in limit.reason and not limit.decisive and not limit.costly


def test_a_cutoff_that_is_halved_says_why_and_how_to_avoid_it():
    """B cut off to 60 samples: what the text offers has the norm that it states."""
    loop = LOOPS["stage"]()
    whole = synthesise(loop)
    with pytest.warns(
        match="half of what P admits, because with the full cut-off trial_norm"
    ) as caught:
        half = synthesise(loop, reach=60)
    numbers = r"is (\S+) for a trial of (\d+) samples: .*\(2, (\S+), .*rest=(\d+)\) .* is (\S+)$"
    said = re.search(numbers, str(caught[0].message))
    norm, samples, cutoff, rest, mended = map(float, said.groups())
    assert half.Q.cutoff == pytest.approx(whole.Q.cutoff / 2, rel=0.05)
    assert mended < 1 <= norm and cutoff == whole.Q.cutoff
    design = synthesise(loop, zero_phase_butterworth(2, cutoff, loop.Ts), reach=60)
    for held, stated in ((0, norm), (int(rest), mended)):
        found = trial_norm(loop.P, design.Q, design.filter, int(samples), rest=held)[0]
        assert found == pytest.approx(stated, rel=0.05)


def test_without_a_decisive_range_the_cutoff_is_the_least_of_all_limits():
    """Against the rule written out, for plants that differ by their gain at a resonance."""
    omega = np.geomspace(1e-3, np.pi, 400)
    resonant = control.tf([0.02, 0], [1, -1.96, 0.98], 1.0)
    plants = [lag(), control.ss(lag() + 0.2 * resonant)]
    P = np.array([plant(np.exp(1j * omega)) for plant in plants])
    rest = abs(P[:, 0]).min()
    B = P.mean(axis=0).conj() / (np.mean(abs(P) ** 2, axis=0) + (rest / 40) ** 2)
    d = abs(1 - P * B).max(axis=0) / (0.9 * 0.5)  # M_max is 0.5
    weak = omega[abs(P).min(axis=0) < 0.1 * rest][0]
    apart = (d > 1) & (omega > omega[0]) & (omega <= 2 * weak) & (omega < 3)
    each = 2 * np.arctan(np.tan(omega[apart] / 2) / (d[apart] - 1) ** 0.25)
    limit = choose_cutoff(response_of(plants, omega), 0.5)
    assert limit.omega == pytest.approx(each.min(), rel=1e-12) and each.min() < weak


def test_without_Q_the_cutoff_is_where_P_ends():
    """Of a lag a tenth of what it is at rest, by its formula; L inverts no more than that."""
    design = synthesise(SLOW)
    ends = 2 * np.arcsin(np.sqrt((1 - 0.1**2) / 0.1**2 * 0.01 / (4 * 0.9)))  # |P| = 0.1
    assert design.problem.lowpass.cutoff == pytest.approx(ends, rel=0.05)
    low = np.exp(1j * design.Q.cutoff / 30)  # up to there L may be 20 times what inverts P
    assert design.problem.L_max == pytest.approx(20 / abs(SLOW(low)), rel=1e-3)
    assert design.sigma_L.max() <= design.problem.L_max * (1 + 1e-4)


def test_what_is_too_uncertain_to_learn_is_said():
    radius = 2 * abs(RESPONSE.ravel())
    below = r"sigma_max\(M\) may reach .* below 0.01 rad/s"  # where Q is above one half
    with (
        pytest.warns(match=r"cut-off of Q is only 0.01 rad/s, .* almost nothing is learned"),
        pytest.warns(match=below),
    ):
        synthesise(control.frd(RESPONSE, LINES, 1.0), uncertainty=radius)


def test_a_table_alone_is_enough():
    """Its radius, or where it ends, limits the cut-off; the filter does for the plant itself."""
    table = control.frd(RESPONSE, LINES, 1.0)
    for P in (table, measured_response(table, uncertainty=0.02 + 0.1 * LINES)):
        design = synthesise(P)
        assert 0.3 < design.problem.lowpass.cutoff < 3 and design.certificate.failures == []
        assert design.check(LAG).rate < 0.9
