"""The cost of noise in the objective: against CVXPY, against its definition, and its effect."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import half, stage, tanks

from rodlib import (
    LearningFilter,
    current_trial_loop,
    largest_cutoff,
    noise_on_trial,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.ilc import converged_noise, trial_noise, trial_operators
from rodlib.ilc.evidence.finite_trial import switched_on
from rodlib.ilc.evidence.optimality import lower_bound
from rodlib.ilc.problem.pose import pose
from rodlib.ilc.synthesis.solver.program import formulate
from rodlib.ilc.trials.run import rms
from tests.ilc.synthesis.solver.test_interior_point import random_plant

CHOICES = {"order": 3, "M_max": 0.97, "L_max": 20.0, "band": (0.01, 0.3)}


def density(m, n, seed=0):
    """Of coloured noise, another for each output."""
    return (
        np.random.default_rng(seed).uniform(0.5, 2, (n, m))
        * np.linspace(2, 1, n)[:, None]
    )


@given(st.integers(1, 4), st.sampled_from(["diagonal", "full"]), st.integers(0, 99))
def test_the_cost_is_that_of_white_noise_through_Q_P_L(m, structure, seed):
    """x'Hx / 2 of the program is the definition; and the mean over all frequencies of a constant
    is that constant."""
    P, Q, omega = random_plant(seed, m, 20)
    noise = density(m, 20, seed)
    problem = pose(P, Q, omega, 1.0, **CHOICES, structure=structure, noise=noise)
    program = formulate(problem)
    x = np.random.default_rng(seed).standard_normal((program.entries, 3))
    C = np.zeros((m, m, 3))
    first = program.bounds[0]
    C[first.rows, first.cols] = np.linalg.solve(program.R.astype(float), x.T).T
    L = LearningFilter(C, 1.0).frequency_response(omega)
    G = Q[:, None, None] * P @ L
    edges = np.concatenate([[0], (omega[1:] + omega[:-1]) / 2, [np.pi]])
    power = np.einsum("nij,nj,nij->n", G.conj(), noise, G).real
    expected = power @ np.diff(edges) / np.pi / (1 - 0.97**2)
    assert problem.cost_of_noise(L) == pytest.approx(expected, rel=1e-12)
    assert program.quadratic(x) == pytest.approx(expected, rel=1e-8)
    np.testing.assert_allclose(program.slope(x), program.H @ x.ravel())
    assert problem.noise.sum() == pytest.approx(
        (noise * np.diff(edges)[:, None]).sum() / np.pi / (1 - 0.97**2)
    )


@pytest.mark.filterwarnings("ignore:the samples are too coarse")
@pytest.mark.parametrize(
    ("shape", "objective", "size"),
    half([(1, "full"), (2, "full"), (2, "diagonal")], ["sum", "peak"], [1e-3, 1.0]),
)
def test_structured_and_cvxpy_find_the_same_optimum(shape, objective, size):
    m, structure = shape
    P, Q, omega = random_plant(m, m, 20)
    choices = CHOICES | {"structure": structure, "objective": objective}
    choices["noise"] = size * density(m, 20)
    ours = synthesise(P, Q, omega, 1.0, **choices)
    theirs = synthesise(P, Q, omega, 1.0, solver="cvxpy", **choices)
    assert ours.value == pytest.approx(theirs.value, rel=1e-5)
    assert ours.certificate.gap < 1e-6
    start = synthesise(P, Q, omega, 1.0, **choices | {"L_max": 15.0})
    again = synthesise(P, Q, omega, 1.0, **choices, start=start)
    assert again.value == pytest.approx(ours.value, rel=1e-7)


@pytest.mark.parametrize(
    ("build", "controls"), [(stage, ["F"]), (tanks, ["pump A", "pump B", "pump C"])]
)
def test_the_variance_of_the_error_grows_by_no_more_than_the_cost(build, controls):
    """By the evidence, which solves for the converged error; at sampling periods far from one."""
    loop = current_trial_loop(build(), controls)
    omega = np.geomspace(1e-3, np.pi, 300) / loop.Ts
    Q = zero_phase_butterworth(2, 0.1 / loop.Ts, loop.Ts)
    new = trial_noise(loop, omega, noise=0.01**2)
    noise = np.einsum("nii->ni", new.measured.density).real
    band = (omega[0], 0.02 / loop.Ts)
    design = synthesise(loop, Q, omega, loop.Ts, band=band, noise=noise)
    grown = converged_noise(new, Q, design.filter).learned.total ** 2
    cost = design.certificate.noise
    assert 0 < grown <= cost < 20 * grown
    assert f"of which the cost of noise: {cost:.4g}" in str(design)
    alone = replace(new.measured, density=noise[..., None] * np.eye(noise.shape[1]))
    apart = converged_noise(replace(new, measured=alone), Q, design.filter)
    assert design.certificate.learned == pytest.approx(apart.learned.total, rel=1e-9)
    assert design.certificate.new == pytest.approx(new.measured.total, rel=1e-12)
    assert f"{design.certificate.learned:.4g} are learned" in str(design)


@pytest.mark.filterwarnings("ignore:the samples are too coarse")
@pytest.mark.parametrize("objective", ["sum", "peak"])
def test_no_multipliers_prove_too_much(objective):
    """The bound holds whatever they are, and wherever the cost is linearised."""
    P, Q, omega = random_plant(2, 2, 15)
    choices = CHOICES | {
        "objective": objective,
        "structure": "full",
        "noise": density(2, 15),
    }
    design = synthesise(P, Q, omega, 1.0, **choices)
    problem, solution = design.certificate.problem, design.solution
    L = problem.response(solution)
    proven = lower_bound(problem, solution.U, solution.V, None, L)
    assert proven == pytest.approx(design.value, rel=1e-6)
    rng = np.random.default_rng(0)
    for size in (1e-3, 0.1, 1.0, 10.0):
        for _ in range(10):
            U, V, other = (
                X + size * np.abs(X).max() * rng.standard_normal(X.shape)
                for X in (solution.U, solution.V, L)
            )
            for found in ((solution.U, solution.V, other), (U, V, L), (U, V, None)):
                U_, V_, L_ = found
                bound = lower_bound(problem, U_, V_, None, L_)
                assert bound <= design.value * (1 + 1e-9)


@pytest.mark.filterwarnings("ignore:the filter leaves")
def test_more_noise_makes_learning_slower_and_quieter():
    P, Q, omega = random_plant(3, 2, 40)
    speed, cost = [], []
    for size in (0, 1e-2, 1.0, 100.0):
        design = synthesise(P, Q, omega, 1.0, **CHOICES, noise=np.full(40, size))
        problem = pose(P, Q, omega, 1.0, **CHOICES, noise=np.ones(40))
        speed.append(design.sigma_M[design.problem.in_band].sum())
        cost.append(problem.cost_of_noise(design.filter.frequency_response(omega)))
    assert speed == sorted(speed) and cost == sorted(cost, reverse=True)
    assert speed[-1] > 1.05 * speed[0] and cost[-1] < 0.95 * cost[0]
    silent = synthesise(P, Q, omega, 1.0, **CHOICES)
    assert silent.value == pytest.approx(speed[0], rel=1e-12)


def test_in_other_units_the_filter_is_worth_the_same():
    P, Q, omega = random_plant(3, 2, 40)
    units = np.array([1.0, 2.0**17])
    noise = density(2, 40)
    here = synthesise(P, Q, omega, 1.0, **CHOICES, noise=noise)
    there = synthesise(
        P * units[:, None] / units,
        Q,
        omega,
        1.0,
        **CHOICES,
        scale=units,
        noise=noise * units**2,
    )
    assert there.value == here.value


@pytest.mark.parametrize(
    ("noise", "message"),
    [(-np.ones(30), "noise reaches -1"), (np.ones(7), "noise"), (np.full(30, np.nan), "noise"),
     (np.ones((30, 3)), "noise"), ("loud", "noise")],
)  # fmt: skip
def test_what_is_no_spectral_density_is_refused(noise, message):
    with pytest.raises(ValueError, match=message):
        synthesise(*random_plant(1, 2), 1.0, **CHOICES, noise=noise)


def test_with_other_searches_it_goes_along():
    P, _, omega = random_plant(2, 1, 20)
    choices = CHOICES | {"M_max": 0.6}
    Q, design = largest_cutoff(
        P, zero_phase_butterworth(2, 0.5), omega, 1.0, **choices, noise=np.ones(20)
    )
    assert design.certificate.failures == [] and 0 < Q.cutoff < np.pi


def loop_of(build, controls):
    loop = current_trial_loop(build(), controls)
    omega = np.geomspace(1e-3, np.pi, 300) / loop.Ts
    return loop, zero_phase_butterworth(2, 0.1 / loop.Ts, loop.Ts), omega


@pytest.mark.parametrize(
    ("samples", "rest", "ends"), [(60, 0, "zero"), (90, 20, "hold")]
)
@pytest.mark.parametrize(
    ("build", "controls", "structure"),
    [(stage, ["F"], "full"), (tanks, ["pump A", "pump B", "pump C"], "diagonal")],
)
def test_on_a_trial_the_cost_is_what_one_trial_makes_of_noise(
    build, controls, structure, samples, rest, ends
):
    """By matrices of the trial: of white noise in it, and in the few samples that L looks beyond
    it, the energy that Q and P leave of L times it. The program and the proof see the same."""
    loop, Q, omega = loop_of(build, controls)
    Q, m = replace(Q, ends=ends), len(controls)
    variance = np.linspace(1, 2, m) * 0.01**2
    choices = {"band": (omega[0], 0.02 / loop.Ts), "structure": structure}
    choices |= {"samples": samples, "rest": rest, "noise": np.tile(variance, (300, 1))}
    design = synthesise(loop, Q, omega, **choices)
    L = design.filter
    P_N, Q_N, _ = trial_operators(loop.P, Q, L, samples)
    ahead = np.zeros((samples, m, samples + L.order, m))
    for p, k in np.ndindex(samples, L.order):
        ahead[p, :, p + k + 1] = L.coefficients[:, :, k]
    v = Q_N @ ahead.reshape(samples * m, -1)
    v[(samples - rest) * m :] = 0
    energy = ((P_N @ v) ** 2).sum(axis=0).reshape(-1, m).sum(axis=0) @ variance
    expected = energy / samples / (1 - 0.9**2)
    assert design.certificate.noise == pytest.approx(
        expected, rel=1e-2
    )  # by 300 frequencies
    assert design.certificate.gap < 1e-6
    program = formulate(design.problem)
    x = program.unknowns(design.solution.coefficients)
    assert program.quadratic(x) == pytest.approx(design.certificate.noise, rel=1e-8)
    endless = replace(design.problem, switched=None)
    response = L.frequency_response(omega)
    assert endless.cost_of_noise(response) != pytest.approx(expected, rel=0.02)
    assert f"the cost of noise, on a trial of {samples} samples: " in str(design)
    if not rest:
        theirs = synthesise(loop, Q, omega, **choices, solver="cvxpy")
        assert theirs.value == pytest.approx(design.value, rel=1e-5)


def test_of_a_long_trial_it_is_that_without_ends():
    loop, Q, omega = loop_of(stage, ["F"])
    omega = omega[::50]
    R = switched_on(loop.P, Q, omega, 50_000)[:, 0, 0]
    QP = Q.frequency_response(omega) * loop.frequency_response(omega)[:, 0, 0]
    np.testing.assert_allclose(np.abs(R), np.abs(QP), atol=1e-3 * np.abs(QP).max())


def test_the_start_counts_only_if_there_is_noise_and_a_trial():
    loop, Q, omega = loop_of(stage, ["F"])
    choices = {"band": (omega[0], 0.02 / loop.Ts)}
    noise = np.full(300, 1e-4)
    assert synthesise(loop, Q, omega, **choices, noise=noise).problem.switched is None
    assert synthesise(loop, Q, omega, **choices, samples=50).problem.switched is None
    with pytest.raises(ValueError, match="samples = 50 asks for the norm of a trial"):
        responses = loop.frequency_response(omega)
        synthesise(responses, Q, omega, **choices, noise=noise, samples=50)


def test_with_the_start_in_the_objective_a_loud_filter_is_not_chosen(loop, Q):
    """The paper's loop, of whose gain nothing else is said; with a bound of 400, it is reached."""
    omega = np.geomspace(1e-4, np.pi, 250)
    noise = np.full(250, 3e5 * 0.02**2)
    designs = {
        "endless": synthesise(loop, Q, omega, L_max=400, noise=noise),
        "start": synthesise(loop, Q, omega, L_max=None, noise=noise, samples=2500),
    }
    found = {
        name: 1e3
        * float(rms(noise_on_trial(loop, Q, design.filter, 2500, 0.02**2).true))
        for name, design in designs.items()
    }
    assert found["start"] < 0.8 * found["endless"]
    assert designs["start"].sigma_L.max() < 150 < designs["endless"].sigma_L.max()
