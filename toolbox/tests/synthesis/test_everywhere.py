"""Bounds at every frequency: judged on dense grids by singular values, not by the peaks' proof."""

from dataclasses import replace

import control
import numpy as np
import pytest
from paper import paper_choices
from plants import furnace, sigma_of_M
from scipy.interpolate import CubicSpline
from scipy.linalg import block_diag

from ilctools import InfeasibleError, synthesise, zero_phase_butterworth
from ilctools.errors import SolverError
from ilctools.evidence.robustness import NEAR_LEVEL
from ilctools.models import frequency_response
from ilctools.synthesis import everywhere

PROVEN = 1 + 1e-9  # what the bounds may be passed by: rounding
PAPER = paper_choices()
PAPER.pop("M_max")
LEAST = 0.82469474  # M_max of the paper's filter at every frequency, on any grid


def judged(design, P, Q, omega):
    """The largest sigma_max(M) and sigma_max(L) over frequencies that the design does not know."""
    L = design.filter.frequency_response(omega)
    return sigma_of_M(omega, P, Q, L).max(), np.linalg.norm(L, 2, axis=(1, 2)).max()


def dense(design, Ts=1.0):
    """Evenly, by decades, and closely about the frequencies that were added."""
    added = np.setdiff1d(design.certificate.problem_on_grid.omega, design.omega)[:, None]
    about = (added * (1 + np.linspace(-0.01, 0.01, 41))).ravel()
    grids = (np.linspace(0, np.pi, 2001) / Ts, np.geomspace(1e-4, np.pi, 2001) / Ts, about)
    return np.unique(np.concatenate(grids).clip(0, np.pi / Ts))


def test_the_papers_bounds_hold_at_every_frequency(loop, Q, omega):
    on_grid = synthesise(loop, Q, omega, **PAPER)
    design = synthesise(loop, Q, omega, everywhere=True, **PAPER)
    at, value = dense(design), 104.86747377
    assert judged(on_grid, loop, Q, at)[1] > 50.03  # the ledger's 1.0007
    bounds = replace(on_grid.problem.bounds, everywhere=True)
    asked = replace(on_grid.problem, bounds=bounds)
    [found] = replace(on_grid.certificate, problem=asked).failures
    assert (found.code, found.claim.name) == ("everywhere", "L_max")
    M, L = judged(design, loop, Q, at)
    assert M <= 0.9 * PROVEN and 49.99 < L <= 50 * PROVEN
    assert value <= design.value <= value * (1 + 1e-4)  # by a grid for the bounds 1e-5 lower
    certificate = design.certificate
    assert on_grid.value < certificate.lower_bound <= design.value
    assert certificate.gap < 1e-7 and certificate.failures == []
    # what is added is not the user's
    np.testing.assert_array_equal(design.omega, omega)
    assert design.sigma_M.shape == omega.shape


def test_the_least_peak_is_that_of_every_grid(loop, Q):
    choices = PAPER | {"everywhere": True, "objective": "peak"}
    design = synthesise(loop, Q, np.geomspace(1e-4, np.pi, 60), **choices)
    assert design.value == pytest.approx(LEAST, rel=1e-5)


def test_what_only_the_grid_admits_is_infeasible_everywhere(loop, Q):
    """On 40 frequencies 0.8222 can be met."""
    grid = np.geomspace(1e-4, np.pi, 40)
    with pytest.raises(InfeasibleError, match="leave `everywhere` out") as error:
        synthesise(loop, Q, grid, M_max=0.8235, everywhere=True, **PAPER)
    assert error.value.smallest_M_max == pytest.approx(LEAST, rel=3e-5)


def test_a_peak_that_is_rounding_has_no_crests():
    """Behind a delay: with a longer filter nothing need be left of the error."""
    Q, grid = zero_phase_butterworth(2, 0.3, 1.0), np.geomspace(1e-3, np.pi, 400)
    design = synthesise(
        control.ss(furnace(3)), Q, grid, objective="peak", L_max=30.0, everywhere=True
    )
    assert design.value < 1e-12
    assert len(design.certificate.problem_on_grid.omega) < 2 * len(grid)


def test_a_resonance_that_no_sample_shows_is_held():
    s = control.tf("s")
    plant = control.sample_system(control.ss(0.01 / (s**2 + 0.002 * s + 0.01)), 1.0)
    Q, grid = zero_phase_butterworth(2, 0.2, 1.0), np.geomspace(1e-3, np.pi, 40)
    with pytest.raises(SolverError, match="not in omega"):
        synthesise(plant, Q, grid, order=3, L_max=60.0)
    design = synthesise(plant, Q, grid, order=3, L_max=60.0, everywhere=True)
    M, L = judged(design, plant, Q, np.union1d(dense(design), np.linspace(0.09, 0.11, 5000)))
    assert M <= 0.9 * PROVEN and L <= 60 * PROVEN


def test_where_rounds_do_not_suffice_it_says_what_may_help(loop, Q, monkeypatch):
    monkeypatch.setattr(everywhere, "ROUNDS", 1)
    remedy = r"at every frequency\. .* take more frequencies, a shorter"
    with pytest.raises(SolverError, match=remedy):
        synthesise(loop, Q, np.geomspace(1e-4, np.pi, 100), everywhere=True, **PAPER)


def plant(rng, m):
    """Lags and a resonance, coupled, with unit gain or so."""
    poles, r, angle = rng.uniform(0.2, 0.9, m), rng.uniform(0.8, 0.98), rng.uniform(0.5, 2.5)
    turned = r * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    B = np.vstack([np.diag(1 - poles), 0.3 * (1 - r) * rng.standard_normal((2, m))])
    C = np.hstack([np.eye(m) + rng.uniform(-0.2, 0.2, (m, m)), rng.standard_normal((m, 2))])
    return control.ss(block_diag(np.diag(poles), turned), B, C, 0, 1.0)


def drawn(seed):
    """Plants, as models or samples, and as models; what is asked of a design."""
    rng = np.random.default_rng(seed)
    m, n = 1 + seed % 2, int(rng.integers(25, 60))
    omega = rng.choice([np.geomspace(1e-3, np.pi, n), np.linspace(0.01, 2.2, n)])
    first = plant(rng, m)
    off = [np.eye(m), *(np.eye(m) + 0.1 * rng.uniform(-1, 1, (seed % 3, m, m)))]
    truth = [control.ss(first.A, first.B, F @ first.C, 0, 1.0) for F in off]
    plants = [P if rng.random() < 0.5 else frequency_response(P, omega) for P in truth]
    Q = zero_phase_butterworth(2, rng.uniform(0.1, 0.6), 1.0)
    asked = {"M_max": 0.1, "objective": rng.choice(["sum", "peak"])}
    asked |= {"base": 0.1} if rng.random() < 0.4 else {"order": int(rng.integers(3, 12))}
    if m == 1:  # or the worst of all plants within the radius has no formula
        asked["uncertainty"] = rng.uniform(0, 0.1) * (1 + rng.random(n))
    return plants, truth, Q, omega, {"everywhere": True} | asked


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(6))
def test_no_plant_within_radius_and_list_exceeds_a_certificate_anywhere(seed):
    """Models by their response, samples and radius by the interpolation that is stated."""
    plants, truth, Q, omega, asked = drawn(seed)
    try:
        design = synthesise(plants, Q, omega, 1.0, **asked)
    except InfeasibleError as error:
        asked["M_max"] = min(1.02 * error.smallest_M_max, 0.99)
        design = synthesise(plants, Q, omega, 1.0, **asked)
    axis, (first, last) = design.problem.response.samples[0].axis, omega[[0, -1]]
    at = np.concatenate([np.linspace(0, np.pi, 2500), np.geomspace(first, last, 2500)])
    at = np.sort(at.clip(max=np.pi))
    inside = (at >= first) & (at <= last)
    largest, known, rho = design.certificate, at[inside], np.zeros(len(at))
    # crests of samples that are lower are only bounded, see evidence/peak
    most = np.full(len(at), max(largest.all_M, NEAR_LEVEL * asked["M_max"]))
    if "uncertainty" in asked:
        rho[inside] = np.interp(axis(known), axis(omega), asked["uncertainty"])
        most[at < first] = max(
            design.rate, most[0]
        )  # which counts what is assumed below the radius, too
    L = np.linalg.norm(design.filter.frequency_response(at), 2, axis=(1, 2))
    more = Q.frequency_response(at) * rho * L
    for given, model in zip(plants, truth, strict=True):
        M = sigma_of_M(at, model, Q, design.filter) + more
        if isinstance(given, np.ndarray):
            P = CubicSpline(axis(omega), given)(axis(known))
            M[inside] = sigma_of_M(known, P, Q, design.filter) + more[inside]
            M[~inside] = 0
        assert np.all(most * (1 + 1e-6) >= M)
    assert L.max() <= largest.all_L * (1 + 1e-6)
    assert largest.all_M <= asked["M_max"] * (1 + 1e-6)
    assert largest.all_L <= design.problem.L_max * (1 + 1e-6)


def test_a_cut_is_made_at_the_top_of_each_crest():
    """Beside some others: a narrow crest stands between those that are taken anyhow."""
    share = np.full(3000, 1.5)
    share[[700, 1801]] = 1.6
    chosen = everywhere._worst(share)
    assert chosen[[700, 1801]].all() and chosen.sum() < 300
    assert not everywhere._worst(np.full(50, 1.0)).any()
