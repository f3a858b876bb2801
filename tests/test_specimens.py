from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import modal_model, stage

from rodlib import (
    Rod,
    Specimen,
    Spread,
    current_trial_loop,
    draw,
    midr,
    minimal_realisation,
    paper_loop,
    responses,
    sampled_response,
    unstable_poles,
)
from rodlib.ilc.models import frequency_response
from rodlib.specimens import MATERIAL, Points

ALL = Spread.of_all(0.3)


def radius(loop, model):
    """Largest modulus of a pole of the loop around a model, stable or not."""
    names = [*loop.controls, *loop.disturbances]
    Bu = model[:, names].B[:, : len(loop.controls)]
    C = np.hstack([loop.plant.C, np.zeros((len(loop.controls),) * 2)])
    K = np.hstack([loop.Ks, np.eye(len(loop.controls))])
    n, m = loop.plant.nstates, len(loop.controls)
    Ac = np.zeros((n + m, n + m))
    Ac[:n, :n], Ac[n:, n:] = loop.plant.A - loop.plant.B[:, :m] @ loop.Ks, np.eye(m)
    A = np.block([[model.A, -Bu @ K], [loop.KL @ model.C, Ac - loop.KL @ C]])
    return np.abs(np.linalg.eigvals(A))


def test_a_rod_is_drawn_by_its_number_alone():
    first = draw(ALL, 7)
    assert (
        first == draw(ALL, 7)
        and first != draw(ALL, 8)
        and first != draw(ALL, 7, root=1)
    )
    off = np.random.default_rng([7, 0]).uniform(-1, 1, 10)
    nominal = [getattr(Rod(), name) for name in MATERIAL]
    found = [getattr(first.rod, name) for name in MATERIAL]
    np.testing.assert_allclose(found, nominal * (1 + 0.3 * off[:4]), rtol=1e-14)
    np.testing.assert_allclose(first.gains, 1 + 0.3 * off[4:8], rtol=1e-14)
    np.testing.assert_allclose(
        first.rod.sensors, [0.12, 0.28] + 0.012 * off[8:], rtol=1e-14
    )


def test_deviations_name_the_parameters_in_order():
    spread = Spread(0.1, 0.2, 0.3, 0.4, gains=0.5, sensors=0.01)
    heavy = spread.specimen([1, -1, 0.5, 0, 0, 1, 0, 0, -1, 1])
    rod = Rod()
    assert heavy.rod.density == pytest.approx(1.1 * rod.density)
    assert heavy.rod.heat_capacity == pytest.approx(0.8 * rod.heat_capacity)
    assert heavy.rod.heat_transfer == pytest.approx(1.15 * rod.heat_transfer)
    assert heavy.rod.conductivity == rod.conductivity
    assert heavy.gains == (1, 1.5, 1, 1)
    np.testing.assert_allclose(heavy.rod.sensors, [0.11, 0.29], rtol=1e-14)
    assert spread.specimen(np.zeros(10)) == Specimen(rod, (1.0,) * 4)


@pytest.mark.parametrize(
    ("deviations", "message"),
    [(np.zeros(9), "deviations"), ([-1.5, *[0] * 9], "deviations reach 1.5 in size")],
)
def test_deviations_beyond_the_spread_are_refused(deviations, message):
    with pytest.raises(ValueError, match=message):
        ALL.specimen(deviations)


@given(st.integers(0, 10**6), st.floats(1e-6, 0.9), st.floats(1e-6, 0.9))
def test_another_spread_stretches_the_same_deviations(number, one, other):
    far, near = (draw(Spread(conductivity=share), number).rod for share in (one, other))
    nominal = Rod().conductivity
    far, near = far.conductivity / nominal - 1, near.conductivity / nominal - 1
    assert far * other == pytest.approx(near * one, abs=1e-12)
    assert abs(far) <= one + 1e-12


def test_deviations_are_uniform_and_independent():
    drawn = [draw(ALL, number, root=3) for number in range(2000)]
    off = [[getattr(each.rod, name) for name in MATERIAL] for each in drawn]
    off = np.hstack(
        [off, [each.gains for each in drawn], [each.rod.sensors for each in drawn]]
    )
    middle = np.array(
        [getattr(Rod(), name) for name in MATERIAL] + [1] * 4 + [0.12, 0.28]
    )
    share = (off - middle) / ([*0.3 * middle[:8], 0.012, 0.012])
    assert np.abs(share).max() <= 1 + 1e-12
    assert np.abs(share.mean(axis=0)).max() < 4 / np.sqrt(3 * 2000)
    np.testing.assert_allclose(
        (share**2).mean(axis=0), 1 / 3, atol=4 * np.sqrt(4 / 45 / 2000)
    )
    correlation = np.corrcoef(share.T) - np.eye(10)
    assert np.abs(correlation).max() < 4.5 / np.sqrt(2000)


def test_no_spread_is_the_nominal_rod():
    assert draw(Spread(), 5) == Specimen(Rod(), (1.0,) * 4)
    rod = Rod(sections=2, sensors=(0.0, 0.1, 0.32))
    assert draw(Spread(), 5, nominal=rod) == Specimen(rod, (1.0, 1.0))


@given(st.integers(0, 10**6))
def test_responses_are_those_of_the_loop_around_the_sampled_rod(number):
    loop, omega = paper_loop(), np.array([0.0, 1e-4, 0.02, 0.5, np.pi])
    specimen = draw(ALL, number)
    G = sampled_response(specimen.rod, omega, 1.0)[:, :, [0, 2]]
    G *= np.array(specimen.gains)[[0, 2]]
    expected = loop.frequency_response(omega, G)
    np.testing.assert_allclose(
        responses(loop, [specimen], omega)[0], expected, atol=1e-11
    )


def test_modal_model_of_these_tests_is_the_sampled_rod():
    omega = np.array([0.0, 1e-3, 0.1, 3.0])
    model = modal_model(Specimen(Rod(), (1.0,) * 4), 1.0)
    expected = sampled_response(Rod(), omega, 1.0)
    np.testing.assert_allclose(frequency_response(model, omega), expected, atol=1e-13)


def test_unstable_poles_are_those_of_a_model_with_hundreds_of_modes(loop):
    """Among rods so far off, and with elements so strong, that many a loop is not stable."""
    specimens = [draw(Spread.of_all(0.9), number) for number in range(12)]
    specimens += [
        Specimen(Rod(), (gain, 1.0, other, 1.0))
        for gain, other in (
            (3, 3),
            (8, 8),
            (30, 1),
            (1, 30),
            (30, 30),
            (-1, 1),
            (-1, -1),
        )
    ]
    moduli = [radius(loop, modal_model(each, 1.0, 200)) for each in specimens]
    expected = [(each > 1).sum() for each in moduli]
    assert min(abs(abs(each) - 1).min() for each in moduli) > 1e-6
    assert {0, 1, 2} <= {*expected}
    np.testing.assert_array_equal(unstable_poles(loop, specimens), expected)


def test_the_edge_of_stability_is_found_to_a_millionth(loop):
    """Where the model with hundreds of modes has a pole on the unit circle."""

    def largest(gain):
        return radius(loop, modal_model(Specimen(Rod(), (gain,) * 4), 1.0, 200)).max()

    low, high = 1.0, 30.0
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if largest(middle) < 1 else (low, middle)
    below, above = (
        Specimen(Rod(), (low * factor,) * 4) for factor in (1 - 1e-6, 1 + 1e-6)
    )
    stable, unstable = unstable_poles(loop, [below, above])
    assert stable == 0 < unstable


def test_a_grid_too_coarse_to_follow_the_return_difference_is_refined(loop):
    specimen = draw(Spread.of_all(0.9), 1)
    for gain in (1.0, 30.0):
        rod = replace(specimen, gains=(gain,) * 4).held(1.0)
        coarse = Grid(loop, np.array([0.0, 1e-3, 0.05, 1.0, np.pi]))
        assert coarse.unstable_poles(rod) == Grid.whole(loop).unstable_poles(rod)


def test_a_rod_with_other_sections_and_one_sensor():
    rod = Rod(sections=2, sensors=(0.1,))
    model = minimal_realisation(midr(rod), ["Q2"])
    loop = current_trial_loop(control.sample_system(model, 2.0, method="zoh"), ["Q2"])
    specimen, omega = (
        draw(Spread.of_all(0.2, rod), 0, nominal=rod),
        np.array([1e-3, 0.1]),
    )
    G = sampled_response(specimen.rod, omega, 2.0)[:, :, 1:2] * specimen.gains[1]
    expected = loop.frequency_response(omega, G)
    np.testing.assert_allclose(
        responses(loop, [specimen], omega)[0], expected, atol=1e-12
    )
    assert unstable_poles(loop, [specimen]) == [0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Spread(density=1.0), r"density = 1.0 must be from 0 to below 1"),
        (lambda: Spread(gains=-0.1), r"gains = -0.1 must be"),
        (lambda: Spread(sensors=-1e-3), r"sensors = -0.001 must be a length in metres"),
        (lambda: Spread(conductivity="much"), "conductivity = 'much' must be"),
        (lambda: Spread.of_all(1.0), "share = 1.0 must be"),
        (
            lambda: draw(Spread(sensors=0.05), 0),
            r"spread.sensors = 0.05 m .* at most 0.04 m",
        ),
        (lambda: draw(Spread(), -1), "number = -1"),
        (lambda: draw(Spread(), 0, root=0.5), "root = 0.5"),
        (lambda: draw(0.2, 0), "spread = 0.2 must be a Spread"),
        (lambda: draw(Spread(), 0, nominal="paper"), "nominal = 'paper' must be a Rod"),
        (lambda: responses(paper_loop(), [Rod()], [0.1]), "must be a Specimen"),
        (
            lambda: responses(paper_loop(), draw(ALL, 0), [0.1]),
            r"must be a list .* \[specimen\]",
        ),
        (
            lambda: responses(
                paper_loop(), [draw(ALL, 0, nominal=Rod(sections=3))], [0.1]
            ),
            r"outputs \['y1', 'y2'\]; for a rod with others, pass it as nominal",
        ),
        (
            lambda: responses(paper_loop(), [draw(ALL, 0)], ["a"]),
            "omega holds values of type",
        ),
        (lambda: unstable_poles("loop", [draw(ALL, 0)]), "loop = 'loop' must be"),
        (
            lambda: responses(
                current_trial_loop(stage(), ["F"]), [draw(ALL, 0)], [0.1]
            ),
            r"loop has the signals \['F', 'friction', 'x'\], but must be that of a rod",
        ),
    ],
)
def test_what_cannot_be_drawn_or_judged_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
