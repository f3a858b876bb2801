"""The problem as it is stated: where P may come from, and in which units."""

import control
import numpy as np
import pytest
from plants import furnace

from rodlib import (
    LearningFilter,
    current_trial_loop,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.ilc.models import frequency_response
from rodlib.ilc.problem.pose import pose
from rodlib.ilc.problem.problem import largest_singular_values

OMEGA = np.geomspace(1e-3, np.pi, 60)
Q = zero_phase_butterworth(2, 0.3)
BAND = (1e-3, 0.1)


def coupled():
    """Two lags with coupling, in discrete time."""
    A = np.array([[0.9, 0.05], [0.02, 0.8]])
    return control.ss(A, [[0.1, 0.02], [0.01, 0.2]], np.eye(2), 0, 1.0)


SAMPLES = frequency_response(coupled(), OMEGA)


def test_samples_frd_and_models_are_the_same_problem():
    model = coupled()
    samples = frequency_response(model, OMEGA)
    frd = control.frd(np.moveaxis(samples, 0, -1), OMEGA)
    for P in (model, frd):
        np.testing.assert_allclose(
            pose(P, Q, OMEGA, 1.0, band=BAND).P, samples, rtol=1e-12
        )
    assert pose(model, Q, OMEGA, 1.0, band=BAND).model is not None
    assert pose(frd, Q, OMEGA, 1.0, band=BAND).model is None


def test_transfer_functions_are_models_if_they_have_one_channel():
    lag = control.tf([0.1], [1, -0.9], 1.0)
    posed = pose(lag, Q, OMEGA, 1.0, band=BAND)
    z = np.exp(1j * OMEGA)
    np.testing.assert_allclose(posed.P[:, 0, 0], 0.1 / (z - 0.9), rtol=1e-12)
    assert posed.model is not None
    two = control.tf(
        [[[0.1], [0.02]], [[0.01], [0.2]]], [[[1, -0.9]] * 2, [[1, -0.8]] * 2], 1.0
    )
    posed = pose(two, Q, OMEGA, 1.0, band=BAND)
    np.testing.assert_allclose(posed.P[:, 0, 1], 0.02 / (z - 0.9), rtol=1e-12)
    np.testing.assert_allclose(posed.P[:, 1, 0], 0.01 / (z - 0.8), rtol=1e-12)


def test_the_sampling_period_is_taken_from_what_knows_it():
    response, q = SAMPLES[::2], Q.frequency_response(OMEGA[::2])
    loop = current_trial_loop(furnace(3, Ts=30.0), sizes={"outlet": 10.0, "valve": 5.0})
    slow = OMEGA[::2] / 30
    for P, filter_Q, grid, Ts in [
        (response, Q, OMEGA[::2], 1.0), (coupled(), q, OMEGA[::2], 1.0), (loop, q, slow, 30.0),
        ([response, coupled()], q, OMEGA[::2], 1.0),
    ]:  # fmt: skip
        assert pose(P, filter_Q, grid, objective="peak").Ts == Ts


@pytest.mark.parametrize("several", [list, tuple])
def test_several_plants_may_be_known_in_several_ways(several):
    """The first as a model; the others are the same plant, as samples in four ways."""
    frd = control.frd(np.moveaxis(SAMPLES, 0, -1), OMEGA)
    given = several([coupled(), SAMPLES, frd, SAMPLES.tolist(), [*SAMPLES]])
    posed = pose(given, Q, OMEGA, 1.0, band=BAND, uncertainty=[0.1] * 60)
    assert posed.plants.shape == (5, 60, 2, 2) and posed.models[1:] == (None,) * 4
    for plant in posed.plants:
        np.testing.assert_allclose(plant, SAMPLES, rtol=1e-12)
    np.testing.assert_array_equal(posed.radius, np.full(60, 0.1))
    in_one = pose(np.stack([SAMPLES] * 3), Q, OMEGA, 1.0, band=BAND)
    assert in_one.plants.shape == (3, 60, 2, 2)


@pytest.mark.parametrize("structure", ["diagonal", "full"])
@pytest.mark.parametrize("as_model", [False, True])
@pytest.mark.parametrize("pascal", [2.0**17, 1e5])
def test_units_do_not_matter_if_scale_says_what_is_equally_large(
    structure, as_model, pascal
):
    """In kelvin and bar, or in kelvin and pascal: the same filter, and the same certificate.

    Where a power of two lies between the units nothing is rounded, and every digit is the same.
    Otherwise the optimum is the same; filters next to it differ by more than their values do.
    """
    designs = []
    for unit in (np.eye(2), np.diag([1.0, pascal])):
        m = coupled()
        model = control.ss(m.A, m.B @ np.linalg.inv(unit), unit @ m.C, 0, 1.0)
        P = model if as_model else frequency_response(model, OMEGA)
        kind = {"structure": structure, "L_max": 3.0, "band": BAND}
        designs.append(synthesise(P, Q, OMEGA, 1.0, scale=2.0 * np.diag(unit), **kind))
    one, other = designs
    units = np.array([1.0, pascal])
    back = other.filter.coefficients * units[:, None] / units[:, None, None]
    if pascal == 2.0**17:
        np.testing.assert_array_equal(back, one.filter.coefficients)
    M = one.problem.M(LearningFilter(back, 1.0).frequency_response(OMEGA))
    assert one.problem.value(largest_singular_values(M)) == pytest.approx(
        one.value, rel=1e-6
    )
    for name in ("value", "lower_bound", "all_M", "all_L", "grid_L"):
        a, b = (getattr(design.certificate, name) for design in designs)
        assert a == pytest.approx(b, rel=1e-6)
    unscaled = synthesise(
        coupled(), Q, OMEGA, 1.0, L_max=3.0, band=BAND, structure=structure
    )
    assert unscaled.value == pytest.approx(
        one.value, rel=1e-9
    )  # twice as large for both
    if as_model:
        assert unscaled.certificate.all_M == pytest.approx(
            one.certificate.all_M, rel=1e-9
        )


def test_scale_weighs_the_channels():
    """What is larger in the second channel by its scale alone counts as less."""
    kind = {"structure": "full", "L_max": 3.0, "band": BAND}
    plain = synthesise(coupled(), Q, OMEGA, 1.0, **kind)
    weighed = synthesise(coupled(), Q, OMEGA, 1.0, scale=[1.0, 10.0], **kind)
    S, L = np.diag([1.0, 10.0]), weighed.filter.frequency_response(OMEGA)
    scaled = np.linalg.inv(S) @ L @ S
    np.testing.assert_allclose(
        np.linalg.norm(scaled, 2, axis=(1, 2)), weighed.sigma_L, rtol=1e-9
    )
    assert np.abs(plain.filter.coefficients - weighed.filter.coefficients).max() > 1e-3


LAG = control.ss(0.5, 1, 1, 0, 2.0)
FEW = control.frd(np.ones((2, 2, 3)), [0.1, 0.2, 0.3])
REFUSED = [  # arguments, and how the message begins
    ({"scale": [1.0]}, "scale has 1 numbers, but P has 2 channels"),
    ({"scale": [1.0, 0.0]}, "scale = "),
    ({"P": FEW}, "P is known at 3 frequencies"),
    ({"P": control.tf([0.1], [1, 0.9])}, "P.dt = 0 differs from Ts"),
    ({"P": control.ss(0.2, 0.8, 1, 0, True)}, "P.dt = True differs from Ts"),
    ({"P": control.frd(LAG, OMEGA / 2)}, "P.dt = 2.0 differs from Ts"),
    ({"P": SAMPLES, "Q": np.ones(60), "Ts": None}, "Ts must be given"),
    ({"P": []}, "P = .* holds no plant"),
    ({"P": (p for p in [SAMPLES])}, "P = <generator"),
    ({"P": [SAMPLES, None]}, r"P\[1\] holds values of type object"),
    ({"P": [coupled(), SAMPLES[:, :1, :1]]}, r"P\[1\] has shape"),
    ({"P": [SAMPLES, LAG]}, r"P\[1\].dt = 2.0 differs from Ts"),
    ({"P": [SAMPLES, FEW]}, r"P\[1\] is known at 3 frequencies"),
    ({"uncertainty": 0.1}, r"uncertainty = 0.1 must .* np.full\(60, r\)"),
    ({"uncertainty": np.ones(7)}, "uncertainty has shape"),
    ({"uncertainty": np.full(60, -0.1)}, "uncertainty reaches -0.1"),
]


@pytest.mark.parametrize(("changes", "message"), REFUSED)
def test_what_does_not_fit_is_refused(changes, message):
    plain = {"P": coupled(), "Q": Q, "omega": OMEGA, "Ts": 1.0, "band": BAND}
    with pytest.raises(ValueError, match=f"^{message}"):
        pose(**plain | changes)


@pytest.mark.parametrize(
    ("dead", "message"),
    [
        (np.s_[:, 1, :], "output 1 does not respond"),
        (np.s_[:, :, 0], "w 0 has no effect"),
    ],
)
def test_a_dead_channel_is_named(dead, message):
    P = SAMPLES.copy()
    P[dead] = 0
    with pytest.raises(
        ValueError, match=f"P is singular at omega = 0.001 rad/s .* {message}"
    ):
        pose(P, Q, OMEGA, 1.0)
