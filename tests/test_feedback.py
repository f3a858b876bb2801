import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rodlib import Rod, current_trial_loop, midr, minimal_realisation, paper_loop, published
from rodlib.feedback import frequency_response, unreachable_modes


def random_plant(rng, n=4, m=2, disturbances=1):
    A = rng.standard_normal((n, n))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    return control.ss(
        A, rng.standard_normal((n, m + disturbances)), rng.standard_normal((m, n)), 0, 1.0
    )


def test_gains_agree_with_python_control(loop):
    n, m = 10, 2
    A, B, C = loop.plant.A, loop.plant.B[:, :m], loop.plant.C
    Ks, _, _ = control.dlqr(A, B, C.T @ C, 0.05 * np.eye(m))
    Aa = np.block([[A, B], [np.zeros((m, n)), np.eye(m)]])
    Ca = np.hstack([C, np.zeros((m, m))])
    KL, _, _ = control.dlqe(Aa, np.eye(n + m), Ca, np.diag([1.0] * n + [2.0] * m), np.eye(m))
    np.testing.assert_allclose(loop.Ks, Ks, atol=1e-8)
    np.testing.assert_allclose(loop.KL, KL, atol=1e-7)


def test_closed_loop_is_the_interconnection_of_plant_observer_and_feedback(loop):
    """(19) against a simulation of (12), (16), (18) written down separately."""
    rng = np.random.default_rng(2)
    w, d = rng.standard_normal((60, 2)), rng.standard_normal((60, 3))
    A, B, E, C = loop.plant.A, loop.plant.B[:, :2], loop.plant.B[:, 2:], loop.plant.C
    KL1, KL2 = loop.KL[:10], loop.KL[10:]
    x, x_hat, delta = np.zeros(10), np.zeros(10), np.zeros(2)
    y = np.empty((60, 2))
    for p in range(60):
        y[p] = C @ x
        u = loop.N @ w[p] - loop.Ks @ x_hat - delta
        innovation = y[p] - C @ x_hat
        x = A @ x + B @ u + E @ d[p]
        x_hat, delta = A @ x_hat + B @ (u + delta) + KL1 @ innovation, delta + KL2 @ innovation
    response = control.forced_response(loop.closed, inputs=np.hstack([w, d]).T)
    np.testing.assert_allclose(response.outputs.T, y, atol=1e-10)


def test_P_does_not_depend_on_the_observer(loop, omega):
    other = current_trial_loop(loop.plant, Qo=100 * np.eye(12), Ro=3 * np.eye(2))
    assert np.abs(other.KL - loop.KL).max() > 0.1
    for same in (loop, other):  # all 22 states of (19), against (31) without the observer
        from_w = frequency_response(same.closed[:, ["w1", "w2"]], omega)
        np.testing.assert_allclose(from_w, loop.frequency_response(omega), atol=1e-9)


def test_P_agrees_with_python_controls_frequency_response(loop, omega):
    theirs = loop.P.frequency_response(omega).complex
    np.testing.assert_allclose(loop.frequency_response(omega), np.moveaxis(theirs, 2, 0), atol=1e-9)


def test_reference_is_met_and_constant_disturbances_are_rejected(loop):
    at_rest = frequency_response(loop.closed, [0.0])[0]
    np.testing.assert_allclose(at_rest, np.hstack([np.eye(2), np.zeros((2, 3))]), atol=1e-9)


def test_printed_gains_up_to_the_coordinates(loop):
    assert np.abs(loop.N - published.matrix("N")).max() <= 0.5e-4
    assert np.abs(loop.KL[10:] - published.matrix("K_L")[10:]).max() <= 0.5e-4
    KL1 = loop.KL[:10]
    computed = {
        "K_s K_s'": loop.Ks @ loop.Ks.T,
        "K_L1' K_L1": KL1.T @ KL1,
        "K_s K_L1": loop.Ks @ KL1,
    }
    for name, product in computed.items():
        claims = [c for key, c in published.claims().items() if key.startswith(f"{name}[")]
        assert len(claims) in (3, 4)
        for claim in claims:
            i, j = (int(index) - 1 for index in claim.key[-4:-1].split(","))
            value, tolerance = (float(part) for part in claim.criterion.split(" +- "))
            assert abs(product[i, j] - value) <= tolerance


def test_the_order_of_the_reduction_matters_for_the_observer(loop):
    """The other order, observable part first, gives an observer that the paper does not print."""
    plant = midr(Rod())
    observable_first = minimal_realisation(
        control.ss(plant.A.T, plant.C.T, plant.B[:, [0, 2]].T, 0, inputs=["y1", "y2"]), ["y1", "y2"]
    )
    B = np.hstack([observable_first.C.T, np.zeros((10, 1))])
    other = control.ss(observable_first.A.T, B, observable_first.B.T, 0)
    gain = current_trial_loop(control.sample_system(other, 1.0, method="zoh")).KL[10:]
    assert np.abs(gain - published.matrix("K_L")[10:]).max() > 0.5e-4


def test_three_modes_are_unreachable_and_two_of_them_unobservable():
    plant = midr(Rod())
    reach, _ = unreachable_modes(plant.A, plant.B[:, [0, 2]])
    observe, _ = unreachable_modes(plant.A.T, plant.C.T)
    np.testing.assert_allclose(np.sort(reach.real), [-0.4501, -0.1612, -0.0297], atol=5e-5)
    np.testing.assert_allclose(np.sort(observe.real), [-0.4501, -0.0297], atol=5e-5)


@pytest.mark.parametrize(("degree", "states"), [(1, 4), (2, 7), (3, 10), (5, 16), (8, 25)])
def test_minimal_realisation_keeps_the_transfer_function(degree, states):
    plant, omega = midr(Rod(), degree), np.geomspace(1e-4, 1, 7)
    minimal = minimal_realisation(plant, ["Q1", "Q3"])
    assert minimal.nstates == states
    np.testing.assert_allclose(
        frequency_response(minimal[:, plant.input_labels], omega),
        frequency_response(plant, omega),
        atol=1e-9,
    )


@given(st.integers(1, 4), st.integers(0, 3), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_hidden_states_of_any_plant_are_removed(n, unreachable, unobservable, seed):
    rng = np.random.default_rng(seed)
    size = n + unreachable + unobservable
    A = np.diag(rng.permutation(np.linspace(-1, -0.1, size)))
    B, C = rng.uniform(0.5, 1, (size, 2)), rng.uniform(0.5, 1, (2, size))
    B[n : n + unreachable] = 0
    C[:, n + unreachable :] = 0
    T = np.linalg.qr(rng.standard_normal((size, size)))[0]
    plant = control.ss(T @ A @ T.T, T @ B, C @ T.T, 0, inputs=["u1", "u2"])
    minimal = minimal_realisation(plant, ["u1", "u2"])
    assert minimal.nstates == n
    np.testing.assert_allclose(
        frequency_response(minimal, [0.3]), frequency_response(plant, [0.3]), atol=1e-8
    )


def test_unreachable_jordan_chain_is_removed():
    A = np.array([[-1.0, 0, 0], [0, -2, 1], [0, 0, -2]])
    B = np.array([[1.0], [0], [0]])
    plant = control.ss(A, B, [[1.0, 1, 0]], 0, inputs=["u"])
    assert minimal_realisation(plant, ["u"]).nstates == 1


@given(st.integers(0, 2**32 - 1))
def test_any_plant_gets_a_stable_loop_without_steady_state_error(seed):
    loop = current_trial_loop(random_plant(np.random.default_rng(seed)))
    assert np.abs(loop.closed.poles()).max() < 1
    np.testing.assert_allclose(loop.frequency_response([0.0])[0], np.eye(2), atol=1e-6)


def unstable_hidden_mode():
    return control.ss(
        np.diag([0.5, 1.2]), [[1.0, 0.0], [0.0, 1.0]], [[1.0, 1.0]], 0, 1.0
    )  # the input that reaches the unstable mode is a disturbance


@pytest.mark.parametrize(
    ("plant", "weights", "message"),
    [
        (control.ss(-1, 1, 1, 0), {}, "plant.dt = 0"),
        (control.ss(0.5, 1, 1, 1, 1.0), {}, "plant.D"),
        (control.ss(0.5, [[1.0]], [[1.0], [1.0]], 0, 1.0), {}, "1 inputs"),
        (unstable_hidden_mode(), {}, r"mode at z = 1.2.* no control reaches"),
        (
            control.ss(0.5, 1, 1, 0, 1.0),
            {"Rs": [[0.0]]},
            "Rs must be symmetric and positive definite",
        ),
        (control.ss(0.5, 1, 1, 0, 1.0), {"Qs": [[-1.0]]}, "Qs must be symmetric and positive semi"),
        (control.ss(0.5, 1, 1, 0, 1.0), {"Qo": np.eye(3)}, r"Qo has shape \(3, 3\)"),
        (control.ss([[0.5, 1], [0, 0.2]], [[-0.5], [0.25]], [[0, 1.0]], 0, 1.0), {}, None),
        (
            control.ss([[0, 1.0], [0, 0.5]], [[0.0], [1.0]], [[-1.0, 1.0]], 0, 1.0),
            {},
            "no output, or none apart from an input disturbance",
        ),
    ],
)
def test_bad_plants_and_weights_are_refused(plant, weights, message):
    if message is None:
        current_trial_loop(plant, **weights)
        return
    with pytest.raises(ValueError, match=message):
        current_trial_loop(plant, **weights)


def test_unknown_control_is_refused():
    with pytest.raises(ValueError, match=r"controls = \['Q1', 'Q9'\] must list"):
        minimal_realisation(midr(Rod()), ["Q1", "Q9"])
    with pytest.raises(ValueError, match=r"controls = \['Q1', 'Q1'\] must list"):
        minimal_realisation(midr(Rod()), ["Q1", "Q1"])


def test_controls_that_reach_nothing_are_refused():
    plant = control.ss(-1, [[0.0, 1.0]], 1, 0, inputs=["u", "d"])
    with pytest.raises(ValueError, match=r"controls = \['u'\] reach no state"):
        minimal_realisation(plant, ["u"])


def test_a_system_has_no_response_at_its_pole_or_without_a_sampling_period():
    with pytest.raises(ValueError, match="omega has the frequency of a pole"):
        frequency_response(control.ss(0, 1, 1, 0), [1.0, 0.0])
    for dt in (None, True):
        with pytest.raises(ValueError, match=f"system.dt = {dt} must be 0, or a sampling period"):
            frequency_response(control.ss(0.5, 1, 1, 0, dt), [1.0])


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ({"Qo": np.zeros((12, 12))}, "Qo and Ro give a loop with a pole of modulus 1,"),
        ({"Qo": 1e-30 * np.eye(12)}, "Qo and Ro"),
        ({"Ro": 1e30 * np.eye(2)}, "Qo and Ro"),
        ({"Qs": 1e30 * np.eye(10)}, "Qs and Rs leave the Riccati equation .* without a solution"),
    ],
)
def test_weights_that_do_not_stabilise_are_refused(loop, weights, message):
    with pytest.raises(ValueError, match=message):
        current_trial_loop(loop.plant, **weights)


def test_a_weight_may_be_symmetric_up_to_rounding(loop):
    Rs = 0.05 * np.eye(2)
    Rs[0, 1] = 1e-9
    found = current_trial_loop(loop.plant, Rs=Rs)
    np.testing.assert_allclose(found.Ks, loop.Ks, atol=1e-5)


def test_a_slow_observer_is_still_an_observer(loop):
    slow = current_trial_loop(loop.plant, Qo=1e-12 * np.eye(12))
    assert 0 < 1 - np.abs(slow.closed.poles()).max() < 1e-6


def test_a_rod_that_is_not_the_papers_is_sent_elsewhere():
    for rod in (Rod(sections=3), Rod(sections=5), Rod(sensors=(0.1,))):
        with pytest.raises(ValueError, match=r"rod has . sections and . sensors.*Q1 to Q4"):
            paper_loop(rod)
    for Ts in (1e-6, 1e4, np.inf):
        with pytest.raises(ValueError, match=r"Ts = .* must be a sampling period between"):
            paper_loop(Ts=Ts)
    assert paper_loop(Ts=np.int64(2)).Ts == 2
    assert (paper_loop(Ts=1.05e-6).Ts, paper_loop(Ts=9.9e3).Ts) == (1.05e-6, 9.9e3)


def test_paper_loop_takes_another_rod_degree_and_period():
    loop = paper_loop(Rod(conductivity=100.0), degree=2, Ts=2.0)
    assert (loop.Ts, loop.plant.nstates, loop.closed.nstates) == (2.0, 7, 16)
    assert loop.plant.input_labels == ["Q1", "Q3", "theta_a", "Q2", "Q4"]
