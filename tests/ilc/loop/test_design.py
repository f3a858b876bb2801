import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import furnace, random_plant, stage, tanks
from scipy.signal import ss2tf

from rodlib import Rod, current_trial_loop, midr, minimal_realisation, sampled_response
from rodlib.ilc.models import frequency_response
from rodlib.paper import published


def test_gains_agree_with_python_control(loop):
    n, m = 10, 2
    A, B, C = loop.plant.A, loop.plant.B[:, :m], loop.plant.C
    Ks, _, _ = control.dlqr(A, B, C.T @ C, 0.05 * np.eye(m))
    Aa = np.block([[A, B], [np.zeros((m, n)), np.eye(m)]])
    Ca = np.hstack([C, np.zeros((m, m))])
    KL, _, _ = control.dlqe(
        Aa, np.eye(n + m), Ca, np.diag([1.0] * n + [2.0] * m), np.eye(m)
    )
    np.testing.assert_allclose(loop.Ks, Ks, atol=1e-8)
    np.testing.assert_allclose(loop.KL, KL, atol=1e-7)


def test_reference_is_met_and_constant_disturbances_are_rejected(loop):
    at_rest = frequency_response(loop.closed, [0.0])[0]
    np.testing.assert_allclose(
        at_rest, np.hstack([np.eye(2), np.zeros((2, 3))]), atol=1e-9
    )


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
        claims = [
            c for key, c in published.claims().items() if key.startswith(f"{name}[")
        ]
        assert len(claims) in (3, 4)
        for claim in claims:
            i, j = (int(index) - 1 for index in claim.key[-4:-1].split(","))
            value, tolerance = (float(part) for part in claim.criterion.split(" +- "))
            assert abs(product[i, j] - value) <= tolerance


def test_the_order_of_the_reduction_matters_for_the_observer(loop):
    """The other order, observable part first, gives an observer that the paper does not print."""
    plant = midr(Rod())
    observable_first = minimal_realisation(
        control.ss(plant.A.T, plant.C.T, plant.B[:, [0, 2]].T, 0, inputs=["y1", "y2"]),
        ["y1", "y2"],
    )
    B = np.hstack([observable_first.C.T, np.zeros((10, 1))])
    other = control.ss(observable_first.A.T, B, observable_first.B.T, 0)
    sampled = control.sample_system(other, 1.0, method="zoh")
    gain = current_trial_loop(sampled, sampled.input_labels[:2]).KL[10:]
    assert np.abs(gain - published.matrix("K_L")[10:]).max() > 0.5e-4


@given(st.integers(0, 2**32 - 1))
def test_any_plant_gets_a_stable_loop_without_steady_state_error(seed):
    loop = current_trial_loop(random_plant(np.random.default_rng(seed)), ["u1", "u2"])
    assert np.abs(loop.closed.poles()).max() < 1
    at_rest = frequency_response(loop.closed, [0.0])[0]
    np.testing.assert_allclose(at_rest, np.eye(2, 3), atol=1e-6)
    np.testing.assert_allclose(loop.frequency_response([0.0])[0], np.eye(2), atol=1e-6)


def transfer(plant):
    """The same plant as python-control's transfer function, by scipy."""
    of_inputs = [
        ss2tf(plant.A, plant.B, plant.C, plant.D, j) for j in range(plant.ninputs)
    ]
    numerators = [[rows[i] for rows, _ in of_inputs] for i in range(plant.noutputs)]
    denominators = [[row for _, row in of_inputs] for _ in range(plant.noutputs)]
    return control.tf(
        numerators, denominators, plant.dt,
        inputs=plant.input_labels, outputs=plant.output_labels,
    )  # fmt: skip


def turned(plant):
    """The same plant with its two states in other coordinates."""
    T = np.array([[1.0, 3.0], [-20.0, 0.1]])
    back = np.linalg.inv(T)
    return control.ss(
        T @ plant.A @ back, T @ plant.B, plant.C @ back, plant.D, plant.dt,
        inputs=plant.input_labels, outputs=plant.output_labels,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("plant", "unit"),
    [
        (stage(length=1.0, force=1e3), 1e-3),  # in m and kN
        (transfer(stage(length=1.0, force=1e3)), 1e-3),
        (transfer(stage()), 1.0),
        (turned(stage()), 1.0),
    ],
    ids=["units", "units and transfer function", "transfer function", "coordinates"],
)
def test_with_sizes_the_loop_depends_on_neither_units_nor_coordinates(plant, unit):
    """Against the stage in mm and N: the same loop from w and friction to x, physically."""
    ours = current_trial_loop(stage(), ["F"], {"x": 5.0, "F": 20.0})
    theirs = current_trial_loop(plant, ["F"], {"x": 5.0 * unit, "F": 20.0 * unit})
    grid = np.append(0.0, np.geomspace(1e-2, np.pi / 1e-3, 40))
    expected = frequency_response(ours.closed, grid)
    found = frequency_response(
        theirs.closed, grid
    )  # both units change by the same factor
    scale = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-9)
    np.testing.assert_allclose(theirs.N, ours.N, rtol=1e-9)
    poles = [np.sort_complex(loop.closed.poles()) for loop in (theirs, ours)]
    np.testing.assert_allclose(*poles, rtol=0, atol=1e-9)


@pytest.mark.parametrize("rates", [(1.0, 1.0, 1.0), (500.0, 2000.0), (0.1, 0.3, 1.0)])
@pytest.mark.parametrize("Ts", [1e-3, 0.02])
def test_a_plant_may_be_slow_beside_its_sampling_period(rates, Ts):
    """Of which the coefficients of a transfer function hold few digits."""
    row = control.series(*(control.ss(-rate, rate, 1, 0) for rate in rates))
    polynomials = np.prod([control.tf([rate], [1, rate]) for rate in rates])
    loops = []
    for model in (row, control.tf2ss(polynomials), polynomials):
        model = control.sample_system(model, Ts, "zoh")
        names = model.input_labels + model.output_labels
        loops.append(
            current_trial_loop(model, sizes=dict(zip(names, (10.0, 1.0), strict=True)))
        )
    expected, canonical, transfer_function = (
        loop.frequency_response(np.geomspace(0.01, 10, 5)) for loop in loops
    )
    np.testing.assert_allclose(canonical, expected, atol=1e-8)
    np.testing.assert_allclose(transfer_function, expected, atol=1e-4)


def test_a_resonant_stage_in_the_coordinates_of_its_polynomials():
    """In which the states differ by eight powers of ten; its modes have unit size."""
    Ts, w, zeta = 1e-3, 2 * np.pi * 40, 0.02
    s = control.tf("s")
    G = 1e3 / (2 * s**2 + 8 * s) + 150 / (s**2 + 2 * zeta * w * s + w**2)  # mm/N
    A = [[0, 1, 0, 0], [0, -4, 0, 0], [0, 0, 0, w], [0, 0, -w, -2 * zeta * w]]
    modes = control.ss(A, [[0], [500], [0], [150 / w]], [[1, 0, 1, 0]], 0)
    loops = []
    for model in (control.tf2ss(G), modes):
        model = control.ss(model.A, model.B, model.C, 0, inputs=["F"], outputs=["x"])
        model = control.sample_system(model, Ts, "zoh")
        loops.append(current_trial_loop(model, sizes={"x": 1.0, "F": 10.0}))
    found, expected = (
        loop.frequency_response(np.geomspace(0.1, 3000, 20)) for loop in loops
    )
    np.testing.assert_allclose(found, expected, atol=1e-8)


def test_sizes_are_what_counts_as_large():
    """More force makes the stage faster; what is not named is one."""
    poles = [
        np.abs(np.linalg.eigvals(loop.plant.A - loop.plant.B[:, :1] @ loop.Ks)).max()
        for loop in (
            current_trial_loop(stage(), ["F"], {"x": 1.0, "F": force})
            for force in (1.0, 100.0)
        )
    ]
    assert poles[1] < 1 - 2 * (1 - poles[0])
    named, silent = (
        current_trial_loop(stage(), ["F"], size) for size in ({"F": 1.0}, {})
    )
    assert np.array_equal(named.KL, silent.KL) and np.array_equal(named.Ks, silent.Ks)


def test_without_sizes_the_weights_are_the_papers(loop):
    """Sizes of one give (24) of the paper, too, but Q_o holds in the paper's coordinates only."""
    again = current_trial_loop(loop.plant, ["Q1", "Q3"])
    weights = {
        "Rs": 0.05 * np.eye(2),
        "Qo": np.diag([1.0] * 10 + [2.0] * 2),
        "Ro": np.eye(2),
    }
    written = current_trial_loop(loop.plant, ["Q1", "Q3"], **weights)
    sized = current_trial_loop(loop.plant, ["Q1", "Q3"], dict.fromkeys(["y1", "Q1"], 1))
    for other in (again, written):
        for name in ("Ks", "KL", "N"):
            # Other rounding moves the gains by up to 6e-12 (seeds 1 to 5): the realisation does.
            np.testing.assert_allclose(
                getattr(other, name), getattr(loop, name), atol=5e-11
            )
    np.testing.assert_allclose(sized.Ks, loop.Ks, atol=1e-11)  # in other coordinates
    assert np.abs(sized.KL - loop.KL).max() > 1e-3


def test_names_and_units_are_those_of_the_plant(loop):
    assert loop.units == {
        "y1": "K", "y2": "K", "Q1": "W", "Q3": "W", "theta_a": "K", "Q2": "W", "Q4": "W",
    }  # fmt: skip
    pumps = ["pump B", "pump C", "pump A"]
    level = current_trial_loop(tanks(), pumps, units={"left": "cm", "pump A": "ml/s"})
    assert (level.controls, level.disturbances) == (pumps, ["leak"])
    assert level.outputs == ["left", "middle", "right"]
    assert level.closed.input_labels == ["w1", "w2", "w3", "leak"]
    assert level.units == dict.fromkeys([*level.outputs, *pumps, "leak"], "") | {
        "left": "cm", "pump A": "ml/s",
    }  # fmt: skip


def test_without_names_all_inputs_are_controls():
    square = tanks()[:, ["pump A", "pump B", "pump C"]]
    loop = current_trial_loop(square)
    assert loop.controls == square.input_labels and not loop.disturbances
    np.testing.assert_allclose(loop.frequency_response([0.0])[0], np.eye(3), atol=1e-9)


@pytest.mark.parametrize(
    ("plant", "controls"),
    [
        (stage(), ["F"]),
        (tanks(), ["pump C", "pump A", "pump B"]),
        (random_plant(np.random.default_rng(5)), ["u1", "u2"]),
    ],
    ids=["stage", "tanks", "random"],
)
def test_a_transfer_function_is_realised_with_no_more_states_than_it_needs(
    plant, controls
):
    """Entry by entry the tanks would have 36."""
    loop = current_trial_loop(transfer(plant), controls)
    assert loop.plant.nstates == plant.nstates
    grid = np.geomspace(1e-3, np.pi, 20) / plant.dt
    expected = frequency_response(plant[:, loop.plant.input_labels], grid)
    found = frequency_response(loop.plant, grid)
    # What rounding of the coefficients of a denominator does to it where it is least.
    denominators = [a for row in transfer(plant).den_list for a in row]
    z = np.exp(1j * grid * plant.dt)
    lost = max(np.abs(a).sum() / np.abs(np.polyval(a, z)).min() for a in denominators)
    atol = 100 * np.finfo(float).eps * lost * np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=atol)


def test_a_long_delay_is_thirty_states_more():
    loop = current_trial_loop(furnace(30), sizes={"valve": 0.1})
    assert loop.plant.nstates == 31 and not np.any(loop.plant.D)
    grid = np.append(0.0, np.geomspace(1e-3, np.pi, 30))
    z = np.exp(1j * grid)
    response = frequency_response(loop.plant, grid)[:, 0, 0]
    np.testing.assert_allclose(response, 0.2 / (z - 0.95) / z**30, rtol=1e-9)
    for samples in (29, 31):
        assert np.abs(loop.around(furnace(samples)).poles()).max() < 0.97
    with pytest.raises(
        ValueError, match=r"plant makes the loop unstable: a pole at z = 0.99.*, of"
    ):
        loop.frequency_response(grid, plant=furnace(40))


def test_any_rod_gets_a_loop():
    """Six sections of aluminium, three controlled outputs, from its parameters to P."""
    rod = Rod(length=0.6, density=2700.0, heat_capacity=900.0, conductivity=200.0, sections=6,
              sensors=(0.05, 0.3, 0.55))  # fmt: skip
    controls = ["Q1", "Q3", "Q6"]
    model = control.sample_system(
        minimal_realisation(midr(rod), controls), 2.0, method="zoh"
    )
    loop = current_trial_loop(model, controls=controls)
    assert loop.controls == controls and loop.disturbances == [
        "Q2",
        "Q4",
        "Q5",
        "theta_a",
    ]
    assert np.abs(loop.closed.poles()).max() < 1
    at_rest = frequency_response(loop.closed, [0.0])[0]
    np.testing.assert_allclose(at_rest, np.eye(3, 7), atol=1e-8)
    grid = np.geomspace(1e-4, 0.1, 20)
    columns = [rod.inputs.index(name) for name in controls]
    itself = loop.frequency_response(
        grid, sampled_response(rod, grid, 2.0)[:, :, columns]
    )
    np.testing.assert_allclose(itself, loop.frequency_response(grid), rtol=0, atol=0.01)


PUMPS = ["pump A", "pump B", "pump C"]


def unstable_hidden_mode():
    return control.ss(
        np.diag([0.5, 1.2]), np.eye(2), [[1.0, 1.0]], 0, 1.0, inputs=["u", "d"]
    )  # the input that reaches the unstable mode is a disturbance


@pytest.mark.parametrize(
    ("plant", "weights", "message"),
    [
        (control.ss(-1, 1, 1, 0), {}, "plant.dt = 0"),
        (control.ss(0.5, 1, 1, 1, 1.0), {}, "plant.D"),
        (control.ss(0.5, [[1.0]], [[1.0], [1.0]], 0, 1.0), {}, "1 inputs"),
        (
            unstable_hidden_mode(),
            {"controls": ["u"]},
            r"mode at z = 1.2.* no control reaches",
        ),
        (
            control.ss(0.5, 1, 1, 0, 1.0),
            {"Rs": [[0.0]]},
            "Rs must be symmetric and positive definite",
        ),
        (
            control.ss(0.5, 1, 1, 0, 1.0),
            {"Qs": [[-1.0]]},
            "Qs must be symmetric and positive semi",
        ),
        (control.ss(0.5, 1, 1, 0, 1.0), {"Qo": np.eye(3)}, r"Qo has shape \(3, 3\)"),
        (
            control.ss(
                [[1.9, 1.0], [-0.9, 0.0]], [[1.0], [-1.0]], [[1.0, 0.0]], 0, 1.0
            ),
            {},
            "mode at z = 1 that no control reaches",  # but for rounding, which puts it inside
        ),
        (
            control.ss([[0.5, 1], [0, 0.2]], [[-0.5], [0.25]], [[0, 1.0]], 0, 1.0),
            {},
            None,
        ),
        (
            control.ss([[0, 1.0], [0, 0.5]], [[0.0], [1.0]], [[-1.0, 1.0]], 0, 1.0),
            {},
            "a zero at z = 1: some constant input leaves no trace in the outputs",
        ),
        (
            tanks(),
            {},
            r"plant has 4 inputs for 3 outputs: name the controls among \['leak', 'pu",
        ),
        (
            tanks(),
            {"controls": ["leak"]},
            r"controls = \['leak'\] are 1 inputs, but each of the 3",
        ),
        (
            tanks(),
            {"controls": ["pump A", "pump B", "pump D"]},
            "controls = .* different inputs",
        ),
        (
            tanks(),
            {"controls": PUMPS, "sizes": {"leak": 1}},
            r"sizes is about \['leak'\], but must",
        ),
        (
            tanks(),
            {"controls": PUMPS, "sizes": {"left": 0}},
            r"sizes\['left'\] = 0 must be a posi",
        ),
        (
            tanks(),
            {"controls": PUMPS, "units": {"h1": "cm"}},
            r"units is about \['h1'\]",
        ),
        (
            tanks(),
            {"controls": PUMPS, "units": {"left": 2}},
            r"units\['left'\] = 2 must be a str",
        ),
        (
            control.tf([1, 0, 0], [1, 0.5], 1.0),
            {},
            "plant has more zeros than poles from u",
        ),
        (
            control.tf([1, 0], [1, 0.5], 1.0),
            {},
            r"plant.D must be zero for the controls \['u",
        ),
        (
            control.tf(1, [1, 0.5]),
            {},
            "plant.dt = 0 must be a sampling period .* sample the plant",
        ),
        (control.tf(1, [1, 0.5], True), {}, "plant.dt = True"),
        (
            control.ss(0.5, 1, 1, 0, 1.0, inputs="a", outputs="a"),
            {},
            "each needs a name of its own",
        ),
    ],
)
def test_bad_plants_and_weights_are_refused(plant, weights, message):
    if message is None:
        current_trial_loop(plant, **weights)
        return
    with pytest.raises(ValueError, match=message):
        current_trial_loop(plant, **weights)


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ({"Qo": np.zeros((12, 12))}, "Qo and Ro give a loop with a pole of modulus 1,"),
        ({"Qo": 1e-30 * np.eye(12)}, "Qo and Ro"),
        ({"Ro": 1e30 * np.eye(2)}, "Qo and Ro"),
        (
            {"Qs": 1e30 * np.eye(10)},
            "Qs and Rs leave the Riccati equation .* without a solution",
        ),
    ],
)
def test_weights_that_do_not_stabilise_are_refused(loop, weights, message):
    with pytest.raises(ValueError, match=message):
        current_trial_loop(loop.plant, loop.controls, **weights)


def test_a_weight_may_be_symmetric_up_to_rounding(loop):
    Rs = 0.05 * np.eye(2)
    Rs[0, 1] = 1e-9
    found = current_trial_loop(loop.plant, loop.controls, Rs=Rs)
    np.testing.assert_allclose(found.Ks, loop.Ks, atol=1e-5)


def test_a_slow_observer_is_still_an_observer(loop):
    slow = current_trial_loop(loop.plant, loop.controls, Qo=1e-12 * np.eye(12))
    assert 0 < 1 - np.abs(slow.closed.poles()).max() < 1e-6
