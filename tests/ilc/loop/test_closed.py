import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import random_plant, tanks

from rodlib import Rod, current_trial_loop, midr, paper_loop, sampled_response
from rodlib.ilc.models import frequency_response


def simulated(loop, plant, w, d):
    """The plant, (16) and (18) written down separately; signals in the loop's order."""
    n, m = loop.plant.nstates, loop.plant.noutputs
    A, B, C = loop.plant.A, loop.plant.B[:, :m], loop.plant.C
    KL1, KL2 = loop.KL[:n], loop.KL[n:]
    x, x_hat, delta = np.zeros(plant.nstates), np.zeros(n), np.zeros(m)
    y = np.empty(w.shape)
    for p in range(len(w)):
        u = loop.N @ w[p] - loop.Ks @ x_hat - delta
        inputs = np.concatenate([u, d[p]])
        y[p] = plant.C @ x + plant.D @ inputs
        innovation = y[p] - C @ x_hat
        x = plant.A @ x + plant.B @ inputs
        x_hat, delta = (
            A @ x_hat + B @ (u + delta) + KL1 @ innovation,
            delta + KL2 @ innovation,
        )
    return y


def test_closed_loop_is_the_interconnection_of_plant_observer_and_feedback(loop):
    rng = np.random.default_rng(2)
    w, d = rng.standard_normal((60, 2)), rng.standard_normal((60, 3))
    response = control.forced_response(loop.closed, inputs=np.hstack([w, d]).T)
    np.testing.assert_allclose(
        response.outputs.T, simulated(loop, loop.plant, w, d), rtol=0, atol=1e-10
    )


def mixed(plant, rng):
    """The same plant with its inputs and outputs in another order, and with some more of them."""
    B = np.hstack([rng.standard_normal((plant.nstates, 1)), plant.B[:, ::-1]])
    C = np.vstack([np.ones((1, plant.nstates)), plant.C[::-1]])
    D = np.zeros((len(C), B.shape[1]))
    D[1:, 1:] = plant.D[::-1, ::-1]
    inputs, outputs = (
        ["draught", *plant.input_labels[::-1]],
        ["spare", *plant.output_labels[::-1]],
    )
    return control.ss(plant.A, B, C, D, plant.dt, inputs=inputs, outputs=outputs)


@given(st.integers(0, 2**32 - 1))
def test_the_controller_around_another_plant(seed):
    """Of another order, with feedthrough, and with its signals in another order."""
    rng = np.random.default_rng(seed)
    loop = current_trial_loop(random_plant(rng), ["u1", "u2"])
    design = loop.plant
    D = 0.01 * rng.standard_normal(design.D.shape)
    other = control.ss(
        np.block([[0.99 * design.A, np.zeros((4, 1))], [np.ones((1, 4)), 0.3]]),
        np.vstack([design.B, np.ones((1, 3))]), np.hstack([design.C, 0.01 * np.ones((2, 1))]),
        D, 1.0, inputs=design.input_labels, outputs=design.output_labels,
    )  # fmt: skip
    try:
        closed = loop.around(mixed(other, rng))
    except ValueError as error:
        assert "unstable" in str(error)
        w, d = np.tile(rng.standard_normal(2), (3000, 1)), np.zeros((3000, 1))
        y = simulated(loop, other, w, d)
        assert np.abs(y[-100:] - w[-100:]).max() > 1e-6  # a stable one has settled
        return
    w, d = rng.standard_normal((40, 2)), rng.standard_normal((40, 1))
    expected = simulated(loop, other, w, d)
    response = control.forced_response(closed, inputs=np.hstack([w, d]).T).outputs.T
    np.testing.assert_allclose(
        response, expected, rtol=0, atol=1e-9 * np.abs(expected).max()
    )
    grid = np.append(0.0, np.geomspace(1e-3, np.pi, 20))
    samples = frequency_response(other[:, ["u1", "u2"]], grid)
    from_model = loop.frequency_response(grid, plant=other)
    np.testing.assert_allclose(
        from_model, frequency_response(closed[:, :2], grid), atol=1e-12
    )
    np.testing.assert_allclose(
        loop.frequency_response(grid, plant=samples),
        from_model,
        rtol=0,
        atol=1e-9 * np.abs(from_model).max(),
    )


@pytest.mark.parametrize("Ts", [0.5, 1.0, 5.0])
def test_around_the_plant_of_the_design_the_observer_drops_out(Ts):
    loop = paper_loop(Ts=Ts)
    grid = np.append(0.0, np.geomspace(1e-4, np.pi / Ts, 50))
    samples = frequency_response(loop.plant[:, loop.controls], grid)
    for plant in (loop.plant, samples):
        np.testing.assert_allclose(
            loop.frequency_response(grid, plant),
            loop.frequency_response(grid),
            rtol=0,
            atol=1e-12,
        )


def test_the_papers_controller_around_the_rod_itself(loop):
    """Models of rising degree approach what the controller does with the equation (1)-(4)."""
    grid = np.geomspace(1e-4, 1.0, 30)
    controls = sampled_response(Rod(), grid, 1.0)[:, :, [0, 2]]
    rod = loop.frequency_response(grid, plant=controls)
    errors = []
    for degree in (3, 6, 12):
        model = control.sample_system(midr(Rod(), degree), 1.0, method="zoh")
        errors.append(np.abs(loop.frequency_response(grid, plant=model) - rod).max())
    assert errors[1] < errors[0] / 10 and errors[2] < errors[1] / 10
    assert errors[2] < 1e-5
    # The paper's model itself is good enough where the loop learns, and not beyond.
    difference = np.abs(loop.frequency_response(grid) - rod).max(axis=(1, 2))
    assert difference[grid < 0.01].max() < 0.01 < difference.max()


def test_P_does_not_depend_on_the_observer(loop, omega):
    other = current_trial_loop(
        loop.plant, loop.controls, Qo=100 * np.eye(12), Ro=3 * np.eye(2)
    )
    assert np.abs(other.KL - loop.KL).max() > 0.1
    for same in (
        loop,
        other,
    ):  # all 22 states of (19), against (31) without the observer
        from_w = frequency_response(same.closed[:, ["w1", "w2"]], omega)
        np.testing.assert_allclose(from_w, loop.frequency_response(omega), atol=1e-9)


def test_P_agrees_with_python_controls_frequency_response(loop, omega):
    theirs = loop.P.frequency_response(omega).complex
    np.testing.assert_allclose(
        loop.frequency_response(omega), np.moveaxis(theirs, 2, 0), atol=1e-9
    )


@pytest.mark.parametrize(
    ("plant", "message"),
    [
        (
            midr(Rod()),
            "plant.dt = 0 must be a sampling period in seconds: sample the plant first",
        ),
        (
            control.sample_system(midr(Rod()), 2.0),
            "loop.Ts = 1.0, plant.Ts = 2.0",
        ),
        (
            tanks(1.0),
            r"plant has the signals .* but lacks \['Q1', 'Q3', 'y1', 'y2'\] of the loop",
        ),
        (
            np.ones((3, 2, 1)),
            r"plant has shape \(3, 2, 1\), but must have shape \(3, 2, 2\)",
        ),
        (np.full((3, 2, 2), np.nan), "plant has 12 values that are not finite"),
        (
            control.sample_system(midr(Rod(sensors=(0.28, 0.12))), 1.0),
            "plant makes the loop unstable: a pole at z",
        ),
    ],
)
def test_other_plants_that_do_not_fit_are_refused(loop, plant, message):
    with pytest.raises(ValueError, match=message):
        loop.frequency_response([0.1, 0.2, 0.3], plant=plant)
