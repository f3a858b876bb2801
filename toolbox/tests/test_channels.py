"""Other numbers of outputs than of learned inputs, from the design to the trials on a rig.

What is expected is dense algebra: singular values on grids, the lifted law, CVXPY.
"""

import control
import cvxpy as cp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from plants import RestartingModel, as_matrix, bump, complex_normal, frequencies, lifted, sigma_of_M
from problems import posed, statement

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    frequency_response,
    load_law,
    load_log,
    measured_response,
    multisine,
    record,
    replay,
    run_trials,
    save_law,
    save_log,
    shake,
    synthesise,
    transfer,
    trial_norm,
    zero_phase_butterworth,
)
from ilctools.evidence.worst_trial import largest_trial_norm

Q = zero_phase_butterworth(2, 0.3, 1.0)
SHAPES = [(1, 2), (3, 2), (2, 4)]


def plant(p, m):
    """With four modes, p outputs and m inputs, each with a name of its own."""
    rng = np.random.default_rng(0)
    A, B, C = np.diag(rng.uniform(0.3, 0.9, 4)), rng.normal(size=(4, m)), rng.normal(size=(p, 4))
    return named(control.ss(A, B, C, 0, 1.0))


def named(P):
    """The same model, with names of its inputs and outputs."""
    inputs, outputs = [f"q{j}" for j in range(P.ninputs)], [f"T{i}" for i in range(P.noutputs)]
    return control.ss(P, inputs=inputs, outputs=outputs)


def learned_at_all(P):
    """A loop whose inputs are learned, and take no reference."""
    return ClosedLoop(P, references={}, learned=P.input_labels)


def largest_sigma(P, L, omega):
    """Of Q (I - P L), or of Q (I - L P) where there are fewer inputs."""
    tall = L.rows < L.columns
    return sigma_of_M(omega, *((L, Q, P) if tall else (P, Q, L))).max()


@pytest.mark.parametrize(("p", "m"), SHAPES)
def test_the_rate_is_the_peak_on_the_smaller_side(p, m):
    """By the formula and by the convex problem; of a model, of two, and of one within a radius."""
    P, dense = plant(p, m), np.linspace(0, np.pi, 1001)
    other, random = P * 1.15, np.random.default_rng(0)
    for options in ({}, {"order": 7}, {"reference": bump(90, np.ones(p))}):
        design = synthesise(P, Q, **options)
        peak = largest_sigma(P, design.filter, dense)
        # a grid of steps h in the phase of some 60 poles misses less than h^2 / 8 of a peak
        assert peak <= design.rate * (1 + 1e-9) and design.rate <= peak * 1.01
    both = synthesise([P, other], Q)
    peaks = [largest_sigma(plant, both.filter, dense) for plant in (P, other)]
    assert max(peaks) <= both.rate * (1 + 1e-9) and both.rate <= max(peaks) * 1.01
    within = synthesise(P, Q, uncertainty=0.05)
    omega = within.omega[::100]
    nominal, L = frequency_response(P, omega), within.filter.frequency_response(omega)
    radius = within.problem.radius[::100]
    Delta = complex_normal(random, 12, len(omega), p, m)
    Delta *= (radius / np.linalg.norm(Delta, 2, axis=(2, 3)))[..., None, None]
    for changed in nominal + Delta:
        sides = (L, Q, changed) if p > m else (changed, Q, L)
        assert sigma_of_M(omega, *sides).max() <= within.rate


@pytest.mark.parametrize(("p", "m"), [(3, 2), (2, 3)])
def test_a_worst_case_is_reached_within_the_radius(p, m):
    """By a Delta of rank one that is searched for, at each of some frequencies."""
    design = synthesise(plant(p, m), Q, frequencies(1.0, 12), uncertainty=0.1, order=3)
    problem, L = design.problem, design.filter.frequency_response(design.omega)
    P, worst = problem.P, design.certificate.worst.sigma
    if m < p:  # sigma_max(I - L P) is that of I - P' L'
        P, L = P.swapaxes(1, 2), L.swapaxes(1, 2)
    random = np.random.default_rng(0)
    for i, r in enumerate(problem.radius):
        best = 0
        for _ in range(20):
            u, v = (complex_normal(random, n) for n in P[i].shape)
            for _ in range(50):  # each of both turned towards the largest M in turn
                changed = P[i] + r * np.outer(u, v.conj()) / np.linalg.norm(u) / np.linalg.norm(v)
                M = problem.Q[i] * (np.eye(len(u)) - changed @ L[i])
                left, sigma, right = np.linalg.svd(M)
                best = max(best, sigma[0])
                u, v = -left[:, 0], L[i] @ right[0].conj()  # d sigma = -Q Re(x* du (v* L y))
        assert 0.97 * worst[i] <= best <= worst[i] * (1 + 1e-9)


@pytest.mark.parametrize(("p", "m"), [(3, 2), (2, 3), (2, 2)])
def test_the_optimum_of_K_is_that_of_another_solver(p, m):
    """(39) for the square plant P B, or (B P)', whose filter is K."""
    omega, choices = np.linspace(0.02, np.pi, 16), {"order": 4, "M_max": 0.8, "band": (0.02, 0.5)}
    design = synthesise(plant(p, m), Q, omega, base=0.2, **choices)
    problem = posed(plant(p, m), Q, omega, base=0.2, **choices)
    P, B = frequency_response(plant(p, m), omega), problem.base.frequency_response(omega)
    square = P @ B if m >= p else (B @ P).swapaxes(1, 2)
    square = square * np.exp(1j * (problem.first_sample - 1) * omega)[:, None, None]
    # a bound of 4 on K, as sigma_max(B) does not bind
    _, value = statement(square, problem.Q, omega, 1.0, L_max=4.0, **choices)
    assert design.value == pytest.approx(value, abs=2e-6)  # Clarabel's accuracy
    assert f"order = 4 of K in L = {'B K' if m >= p else 'K B'}" in repr(design)


@pytest.mark.parametrize(("p", "m"), [(1, 3), (4, 2), (3, 4), (2, 2)])
def test_trials_are_those_of_the_lifted_law(p, m):
    """v' = Q_N (v + L_N (r - P_r r - P_N v)), with a reference for the first input alone."""
    P, samples = plant(p, m), 40
    loop = ClosedLoop(P, references={"q0": "T0"}, learned=P.input_labels)
    law, r = synthesise(P, Q).law(), bump(samples, np.arange(1, p + 1))
    trials = run_trials(loop, law, r, trials=4)
    P_N, v = lifted(P, samples), np.zeros(samples * m)
    L_N, Q_N = as_matrix(law.L.apply, samples, p), as_matrix(Q.apply, samples, m)
    free = r.ravel() - lifted(P[:, ["q0"]], samples) @ r[:, 0]
    for k in range(4):
        e = free - P_N @ v
        assert_allclose(trials.v[k].values.ravel(), v, rtol=0, atol=1e-11)
        assert_allclose(trials.e[k].values.ravel(), e, rtol=0, atol=1e-11)
        v = Q_N @ (v + L_N @ e)
    w = loop.w(trials.reference, trials.v)
    assert_allclose(w[..., 0], trials.reference[..., 0] + trials.v[..., 0], rtol=0, atol=1e-15)


@pytest.mark.parametrize(("p", "m"), SHAPES)
def test_what_stays_is_what_trials_leave(p, m):
    P, r = plant(p, m), bump(600, np.arange(1, p + 1))
    design = synthesise(P, Q, reference=r)
    trials = run_trials(learned_at_all(P), design.law(), r, trials=10)
    left = np.sqrt(np.mean(trials.e[-1].values ** 2, axis=0))
    predicted = design.certificate.predicted[10]
    # of a trial without ends; here they are 600 samples apart
    assert np.linalg.norm(left) == pytest.approx(predicted, rel=0.02, abs=2e-3)
    [line] = [line for line in str(design).splitlines() if f"{p} output" in line]
    if p > m:
        said = [float(part.split()[0]) for part in line.split("RMS of ")[1].split(", ")]
        assert_allclose(said, left, rtol=0.02, atol=2e-3)


@pytest.mark.parametrize(("p", "m"), [(1, 2), (2, 3)])
def test_the_norm_of_a_trial_is_over_what_errors_lead_to(p, m):
    P, samples = plant(p, m), 60
    L = synthesise(P, Q).filter
    L_N, Q_N = as_matrix(L.apply, samples, p), as_matrix(Q.apply, samples, m)
    T = Q_N @ (np.eye(samples * m) - L_N @ lifted(P, samples))
    U, S, _ = np.linalg.svd(Q_N @ L_N, full_matrices=False)
    norm, before, after = trial_norm(P, Q, L, samples)
    assert norm == pytest.approx(np.linalg.norm(T @ U[:, 1e-10 * S[0] < S], 2), rel=1e-7)
    assert_allclose(after.ravel(), T @ before.ravel(), rtol=0, atol=1e-10)
    plants = [P, P * 1.1, P * 0.8]
    each = [trial_norm(other, Q, L, samples)[0] for other in plants]
    basis = U[:, 1e-10 * S[0] < S]
    assert largest_trial_norm(plants, Q, L, samples, basis) == pytest.approx(max(each), rel=1e-6)
    with pytest.raises(ValueError, match=r"samples = 5000, .* take a shorter trial"):
        trial_norm(P, Q, L, 5000)


SAME_PLACE = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])  # two sensors


@pytest.mark.parametrize("order", [None, 5])
@pytest.mark.parametrize(
    ("P", "words"),
    [
        (SAME_PLACE * plant(2, 3), "no input moves the combination 0.89 T0 -0.45 T1 of"),
        (plant(3, 2) * np.array([[2.0], [0.0]]) * np.array([[1.0, 1.0]]), "0.71 .* moves no out"),
        (SAME_PLACE[:2] * plant(2, 2), "0.89 T0 -0.45 T1 .* directions that remain is 1"),
    ],
)
def test_directions_that_a_plant_never_passes_are_left_out_and_named(P, words, order):
    P, r = named(P), bump(300, np.arange(1, P.noutputs + 1))
    with pytest.warns(UserWarning, match=words):
        design = synthesise(P, Q, order=order, scale={"T0": 2.0}, reference=r)
    trials = run_trials(learned_at_all(P), design.law(), r, trials=6)
    # what no input reaches stays: the least squares of whole trials, in units of `scale`
    weights = np.tile([0.5, *[1.0] * (P.noutputs - 1)], 300)
    P_N = weights[:, None] * lifted(P, 300)
    target = weights * r.ravel()
    left = target - P_N @ np.linalg.lstsq(P_N, target, rcond=1e-8)[0]
    found = weights * trials.e[-1].values.ravel()
    assert np.linalg.norm(found) <= np.linalg.norm(left) + 0.02 * np.linalg.norm(target)
    changed = design.check(P * 1.05)
    assert changed.rate < 1 and design.law().region.P.shape[2:] == P.shape


def test_sensors_that_are_nearly_the_same_are_noticed():
    nearly = np.array([[1.0, 0.0], [1.0, 1e-3], [0.0, 1e-3]]) * plant(2, 2)
    with pytest.warns(UserWarning, match=r"weakest direction of P has 0\.00"):
        synthesise(nearly, Q)


@pytest.mark.parametrize(("p", "m"), [(2, 1), (1, 2)])
def test_within_limits_v_is_the_nearest_that_can_be_applied(p, m):
    P, samples = plant(p, m), 25
    loop = learned_at_all(P)
    law = Law(Q, synthesise(P, Q).filter, limits={"q0": (-0.05, 0.06)}, loop=loop)
    r = bump(samples, np.ones(p))
    v, e = np.zeros((samples, m)), r
    free = Law(Q, law.L, loop=loop).next(v, e)
    z = cp.Variable((samples, m))
    weight = 1e-2
    P_N = lifted(P, samples)
    cost = cp.sum_squares(P_N @ cp.vec(z, order="C")) + weight * cp.sum_squares(z)
    within = [free[:, 0] + z[:, 0] >= -0.05, free[:, 0] + z[:, 0] <= 0.06]
    cp.Problem(cp.Minimize(cost), within).solve(solver=cp.CLARABEL)
    found = law.next(v, e, u=loop.w(r, v))
    assert found[:, 0].min() >= -0.05 and found[:, 0].max() <= 0.06 and free[:, 0].max() > 0.07
    assert_allclose(found, free + z.value, rtol=0, atol=1e-4)
    # without a model commands are cut off
    no_model = ClosedLoop(Ts=1.0, outputs=loop.outputs, references={}, learned=loop.learned)
    cut = Law(Q, law.L, limits={"q0": (-0.05, 0.06)}, loop=no_model).next(v, e, u=v)
    assert_allclose(cut[:, 0], free[:, 0].clip(-0.05, 0.06), rtol=0, atol=1e-15)


@pytest.mark.parametrize(("p", "m", "references"), [(3, 2, {}), (2, 3, {"q2": "T0"}), (1, 2, {})])
def test_a_rig_is_recorded_stopped_gone_on_with_and_replayed(tmp_path, p, m, references):
    P, path = plant(p, m), tmp_path / "log.csv"
    learned = [name for name in P.input_labels if name not in references]
    loop = ClosedLoop(P, references=references, learned=learned)
    law, r = synthesise(loop, Q).law(), bump(120, np.ones(p))
    record(RestartingModel(P), loop, law, r, trials=2, path=path)
    trials = record(RestartingModel(P), loop, law, r, trials=4, path=path)
    simulated = run_trials(loop, law, r, trials=4)
    assert_allclose(trials.e, simulated.e, rtol=0, atol=1e-12)
    assert trials.v.dims == ("trial", "time", "input")
    assert trials.input.values.tolist() == learned
    text = str(replay(load_log(path)))
    assert "the recorded v agrees with the law in every trial" in text
    assert "fit of the prediction by the model, mean of all trials: T0 100 %" in text
    save_log(simulated, path)
    assert_allclose(load_log(path).v, simulated.v, rtol=0, atol=0)
    save_law(tmp_path / "law.json", law)
    v, e = simulated.v[1].values, simulated.e[1].values
    assert_allclose(load_law(tmp_path / "law.json").next(v, e), law.next(v, e), rtol=0, atol=1e-13)
    with pytest.raises(ValueError, match=r"v of .*, but transfer needs"):
        transfer(simulated, r)


@pytest.mark.parametrize(("p", "m"), [(3, 2), (2, 3)])
def test_P_is_measured_from_v_by_shaking_and_from_trials(p, m):
    P = plant(p, m)
    loop = ClosedLoop(Ts=1.0, outputs=P.output_labels, references={}, learned=P.input_labels)
    shaking = multisine(loop, 0.1, 3.0, 1.0, hours=0.5)
    log = shake(RestartingModel(P, noise=0.01), loop, shaking)
    omega = np.linspace(0.11, 2.9, 30)
    measured = measured_response(log)
    found, radius = measured.on(omega, 0.9999)
    off = np.linalg.norm(found - frequency_response(P, omega), 2, axis=(1, 2))
    assert np.all(off <= radius) and np.median(radius) < 0.3
    design = synthesise(measured, Q)
    assert (design.filter.rows, design.filter.columns) == (m, p) and design.rate < 1


def test_an_input_with_a_reference_alone_is_a_known_cause_of_y():
    """P is from v alone, though the reference moves y by another input."""
    P = plant(1, 2)
    loop = ClosedLoop(P, references={"q1": "T0"}, learned=["q0"])
    random = np.random.default_rng(1)
    reference = random.normal(size=(6, 300, 1))
    reference[:, 0] = 0
    v, noise = random.normal(size=(300, 1)), 0.01 * random.normal(size=(6, 300, 1))
    law = Law(Q, LearningFilter([[[0.3]]], 1.0))
    trials = run_trials(loop, law, reference, trials=6, v=v, noise=noise)
    omega = np.linspace(0.05, 3.0, 30)
    found, radius = measured_response(trials).on(omega, 0.9999)
    off = np.abs(found - frequency_response(P[:, [0]], omega))[:, 0, 0]
    assert np.all(off <= radius) and np.median(radius) < 0.1


def test_a_law_for_another_place_is_refused():
    """The names of both places are in the error."""
    P = plant(1, 2)
    at = {
        name: ClosedLoop(P, references={"q0": "T0", "q1": "T0"}, learned=[name])
        for name in ("q0", "q1")
    }
    law = synthesise(at["q0"], Q).law()
    with pytest.raises(ValueError, match=r"law.learned = \['q0'\], but loop.learned = \['q1'\]"):
        run_trials(at["q1"], law, bump(50, [1.0]), trials=1)
    with pytest.raises(ValueError, match="L has 1 learned inputs, but loop has 2"):
        run_trials(learned_at_all(P), law, bump(50, [1.0]), trials=1)
    with pytest.raises(ValueError, match=r"v holds .* must hold \['q0'\]"):
        v = run_trials(at["q0"], law, bump(50, [1.0]), trials=1).v[0]
        run_trials(at["q0"], law, bump(50, [1.0]), v=v.assign_coords(input=["T0"]))


def test_a_table_of_any_shape_is_a_measured_response():
    P, omega = plant(3, 2), np.linspace(0.01, np.pi, 150)
    names = {"inputs": P.input_labels, "outputs": P.output_labels}
    table = control.frd(np.moveaxis(frequency_response(P, omega), 0, -1), omega, 1.0, **names)
    measured = measured_response(table, uncertainty=np.full(150, 0.01))
    assert measured.names == (P.input_labels, P.output_labels)
    assert len(measured.plot().axes) == 12
    design = synthesise(measured, Q, scale={"T0": 2.0})
    with pytest.raises(ValueError, match="P has 2 outputs and 2 inputs, but the design has 3 and"):
        design.check(plant(2, 2))
