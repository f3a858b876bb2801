"""The problem as it is stated: where P may come from, in which units, and what is refused."""

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from plants import bump, furnace, lag, lags
from problems import posed

from ilctools import current_trial_loop, synthesise, zero_phase_butterworth
from ilctools.models import frequency_response

OMEGA = np.geomspace(1e-3, np.pi, 60)
Q = zero_phase_butterworth(2, 0.3, 1.0)
BAND = (1e-3, 0.1)
COUPLED = lags()
SAMPLES = frequency_response(COUPLED, OMEGA)
FRD = control.frd(np.moveaxis(SAMPLES, 0, -1), OMEGA)
LAG = control.ss(0.5, 1, 1, 0, 2.0)
OF_TASK = {"band": None, "reference": np.ones((9, 2))}
FEW = control.frd(np.ones((2, 2, 3)), [0.1, 0.2, 0.3])


def test_the_sampling_period_is_taken_from_what_knows_it():
    q = Q.frequency_response(OMEGA)
    loop = current_trial_loop(furnace(3, Ts=30.0), sizes={"outlet": 10.0, "valve": 5.0})
    for P, filter_Q, grid, Ts in [
        (SAMPLES, Q, OMEGA, 1.0),
        (loop, q, OMEGA / 30, 30.0),
        ([SAMPLES, COUPLED], q, OMEGA, 1.0),
    ]:
        assert posed(P, filter_Q, grid, objective="peak").Ts == Ts


def test_several_plants_may_be_known_in_several_ways():
    """The first as a model; the others are the same plant, as samples in four ways."""
    plants = (COUPLED, SAMPLES, FRD, SAMPLES.tolist(), [*SAMPLES])
    problem = posed(plants, Q, OMEGA, 1.0, band=BAND, uncertainty=[0.1] * 60)
    assert problem.plants.shape == (5, 60, 2, 2) and problem.response.models[1:] == (None,) * 4
    for plant in problem.plants:
        assert_allclose(plant, SAMPLES, rtol=1e-12)
    np.testing.assert_array_equal(problem.radius, np.full(60, 0.1))


@pytest.mark.parametrize(("structure", "as_model"), [("full", True), ("diagonal", False)])
def test_units_do_not_matter_if_scale_says_what_is_equally_large(structure, as_model):
    """In kelvin and bar, or in kelvin and pascal: the same optimum, and the same certificate."""
    designs, weights = [], []
    for unit in (np.ones(2), np.array([1.0, 1e5])):
        model = control.ss(COUPLED.A, COUPLED.B / unit, np.diag(unit) @ COUPLED.C, 0, 1.0)
        P = model if as_model else frequency_response(model, OMEGA)
        kind = {"structure": structure, "L_max": 3.0, "band": BAND, "order": 6}
        designs.append(synthesise(P, Q, OMEGA, 1.0, scale=2.0 * unit, **kind))
        reference = unit * bump(60, [1.0, 3.0])
        weights.append(
            posed(model, Q, OMEGA, 1.0, scale=unit, reference=reference).objective.weights
        )
    one, other = designs
    for name in ("value", "lower_bound", "all_M", "all_L"):
        a, b = (getattr(design.certificate, name) for design in designs)
        assert a == pytest.approx(b, rel=1e-6)
    assert other.check([P, P]).rate == pytest.approx(one.certificate.rate, rel=1e-5)
    assert_allclose(*weights, rtol=1e-9)


def singular(dead):
    P = SAMPLES.copy()
    P[dead] = 0
    return P


REFUSED = [  # arguments, and how the message begins
    ({"scale": [1.0, 0.0]}, "scale = "),
    ({"P": FEW}, "P is known at 3 frequencies"),
    ({"P": control.ss(0.2, 0.8, 1, 0, True)}, "P.dt = True must be Ts"),
    ({"P": control.frd(np.moveaxis(SAMPLES, 0, -1), OMEGA, 2.0)}, "P.dt = 2.0 must be Ts"),
    ({"P": SAMPLES, "Q": np.ones(60), "Ts": None}, "Ts must be given"),
    ({"P": []}, "P = .* holds no plant"),
    ({"P": control.ss(1.1, 1, 1, 0, 1.0)}, "P is unstable"),
    ({"P": control.ss([[0.5]], [[np.nan]], 1, 0, 1.0)}, "P.B has 1 values"),
    ({"uncertainty": np.full(60, -0.1)}, "uncertainty has the value -0.1"),
    ({"Q": np.zeros(60), "objective": "peak"}, "Q has a gain of at most 0"),
    ({"order": 301}, "order = 301 is more than 300"),
    ({"band": (1e-4, 0.5)}, "band = .* within omega"),
    ({"band": (0.051, 0.052)}, "band = .* contains none"),
    ({"reference": np.ones((9, 2))}, "reference replaces .* band = .0.001, 0.1. and"),
    (OF_TASK | {"reference": np.zeros((9, 2))}, "reference leaves no error"),
]


@pytest.mark.parametrize(("changes", "message"), REFUSED)
def test_what_does_not_fit_is_refused(changes, message):
    plain = {"P": COUPLED, "Q": Q, "omega": OMEGA, "Ts": 1.0, "band": BAND}
    with pytest.raises(ValueError, match=f"^{message}"):
        posed(**plain | changes)


@pytest.mark.parametrize("Q", [None, zero_phase_butterworth(2, 0.3, 1.0)])
def test_no_bound_on_M_is_taken_before_it_is_checked(Q):
    """Without Q, the cut-off follows from it."""
    with pytest.raises(ValueError, match=r"^M_max = '1' must be in \(0, 1\)"):
        synthesise(lag(), Q, M_max="1")
