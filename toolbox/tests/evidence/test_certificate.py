"""What a certificate says, of one plant, of several, of a radius and of another plant."""

from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paper import paper_choices
from plants import invertible, lag, lags, sigma_of_M

from ilctools import InfeasibleError, convergence, rate, synthesise, zero_phase_butterworth
from ilctools.errors import SolverError
from ilctools.evidence.certificate import certify, check
from ilctools.evidence.peak import peak_of_M
from ilctools.models import frequency_response
from ilctools.problem.pose import pose
from ilctools.problem.problem import Bounds, Solution

OMEGA = np.geomspace(1e-3, np.pi, 64)  # one round is enough for four samples, see problem.grid
BUTTERWORTH = zero_phase_butterworth(2, 0.3, 1.0)
ASKED = {"order": 4, "M_max": 0.6, "L_max": 5.0, "band": (1e-3, 0.1), "structure": "diagonal"}
FINE = np.geomspace(1e-3, np.pi, 250)
SHOWN = pytest.mark.filterwarnings("ignore:.*they show too little of P")


MODELS = [lags(), lags(1.3), lags(0.8, 0.93)]


def of_lags(plants, omega=OMEGA, Q=BUTTERWORTH, **changes):
    return synthesise(plants, Q, omega, 1.0, **ASKED | changes)


@pytest.fixture(scope="module")
def good(loop, Q, omega):
    return synthesise(loop, Q, omega[::5], 1.0, **paper_choices(band=(1e-4, 0.01))).certificate


def codes(findings):
    return [found.code for found in findings]


def test_a_certificate_in_print(good):
    """Of one plant, which lags by the zeros of the loop, see notebook 7; of tables that end early.

    Digits are those of the numbers, which other tests judge.
    """
    assert good.failures == good.warnings == []
    expected = f"""\
rate at most {good.rate:.4f}, at all frequencies, proven; largest near 0.041 rad/s
{good.margins}
Q's cut-off 0.1 rad/s, sigma_max(L) {good.all_L:.3g}, norm of a trial of 500 samples {good.norm:.3g}
limited by M_max = 0.9, L_max = 50, order = 10 (P lags by 17 samples at the cut-off), diagonal; \
mean of sigma_max(M) over the band: {good.mean_M:.4f}, from 0.0001 to 0.01 rad/s"""
    assert f"{good}" == expected
    omega = np.geomspace(1e-2, 2.0, 50)
    P = np.stack([frequency_response(model, omega) for model in MODELS])
    design = of_lags(P, omega, band=(1e-2, 0.1), structure="full", M_max=0.99)
    tables, sigma = design.certificate, design.sigma_M.max()
    assert f"{design}".startswith(f"rate at most {design.rate:.4f} for each of 3 plants, at all")
    expected = f"""\
0.99       M_max
{tables.grid_M:<11.7g}sigma_max(M) for each of 3 plants, on the design grid: of plant 1 at \
0.01 rad/s
{sigma:<11.7g}the same of the nominal plant
{tables.all_M:<11.7g}sigma_max(M) for each of 3 plants, from 0.01 to 2 rad/s, on a dense grid, \
estimated
{tables.beyond.sigma:<11.7g}sigma_max(M) for each of 3 plants, above 2 rad/s at most, assumed
5          L_max
{tables.grid_L:<11.7g}sigma_max(L) on the design grid
{tables.all_L:<11.7g}sigma_max(L) at all frequencies
{tables.value:<11.7g}objective
{tables.lower_bound:<11.7g}lower bound of the objective, of any full filter of order 4, of those \
whose bounds are kept lower at omega for what lies between and above
unknown: below 0.01 rad/s, at resonances that no sample shows
mean of sigma_max(M) of the nominal plant over the band: {tables.mean_M:.4f}, from 0.01 to 0.1 rad/s
assumed: above 2 rad/s, where P is not known, sigma_max(P) is 0.1714 at most, at any phase
assumed: between omega, cubic splines miss P by no more than they miss samples that are left out, \
over log omega"""
    assert tables.details == expected
    high = BUTTERWORTH.frequency_response([2.0])[0]
    assert high < design.rate == pytest.approx(design.check(P, omega).gamma, rel=1e-12)


def test_what_does_not_limit_is_not_named(good):
    looser = replace(good.problem, bounds=Bounds(0.999, 1e4))
    free = replace(good, problem=looser, grid=looser)
    assert "\nlimited by order = 10 (P lags" in f"{free}"


def test_a_design_says_its_rate_filter_and_period_and_convergence_needs_no_grid():
    """That of the synthesis by default; the door's gamma there is the certificate's on it."""
    design = synthesise(MODELS[0], BUTTERWORTH, M_max=0.9, order=10)
    assert (design.Q, design.Ts, design.rate) == (BUTTERWORTH, 1.0, design.certificate.rate)
    found = convergence(MODELS[0], BUTTERWORTH, design.filter)
    np.testing.assert_array_equal(found.omega, design.omega)
    assert found.gamma == pytest.approx(design.certificate.grid_M, rel=1e-9)
    assert rate(MODELS[0], BUTTERWORTH, design.filter).gamma == found.gamma


def test_a_bound_that_holds_on_the_grid_only_warns(good):
    for sigma, expected in ((0.92, []), (0.93, ["between"])):  # a quarter of the room above M_max
        found = replace(good, exact=[replace(good.peak, sigma=sigma)]).warnings
        assert codes(found) == expected
    assert "reaches 0.93, where" in str(found[0])


def test_a_certificate_fails_from_the_tolerance_on_and_warns_from_a_quarter_of_the_margin(good):
    """A gap of 1e-6, a bound on the grid passed by 1e-9, relative; M from one on anywhere."""

    def failures(sigma_M=0.9, all_M=0.9, **changes):
        worst = replace(good.worst, sigma=np.full(good.grid.omega.shape, sigma_M))
        peak = replace(good.peak, sigma=all_M, omega=0.25)
        changed = replace(good, worst=worst, exact=[peak], **changes)
        # else margins are computed for the print
        assert changed.rate < 1 or str(changed).count("FAILS: ") == len(changed.failures)
        return changed.failures

    bound = good.value * (1 - 1e-6)
    unit = good.value * 1e-8
    assert not failures(lower_bound=bound + unit)
    assert codes(failures(lower_bound=bound - unit)) == ["gap"]
    assert not failures(0.9 * (1 + 0.99e-9), grid_L=50 * (1 + 0.99e-9))
    assert codes(failures(0.9 * (1 + 1.01e-9))) == ["M"]
    assert codes(failures(grid_L=50 * (1 + 1.01e-9))) == ["L"]
    assert not failures(all_M=np.nextafter(1, 0))
    [found] = failures(all_M=1.0)
    assert (found.code, found.value, found.place) == ("one or more", 1.0, "at 0.25 rad/s")
    assert codes(failures(1.0, 1.0, lower_bound=bound / 2)) == ["gap", "M", "one or more"]
    perfect = replace(good, value=1e-9 * good.problem.idle, lower_bound=0.0)
    assert perfect.gap == pytest.approx(1e-7)  # relative to a hundredth of the idle
    for sigma, expected in ((0.924, []), (0.926, [("samples", 0.926, "at 0.3 rad/s")])):
        peak = replace(good.peak, sigma=sigma, omega=0.3)
        estimate = replace(good, exact=[], estimated=[peak])
        found = [(found.code, found.value, found.place) for found in estimate.warnings]
        assert found == expected and estimate.failures == []


def peak_around(plant, design, angle):
    """Largest sigma_max(M) on a grid so fine around an angle that nothing hides there."""
    omega = angle * (1 + np.linspace(-0.3, 0.3, 60001))
    return sigma_of_M(omega, plant, design.Q, design.filter).max()


@SHOWN
@pytest.mark.parametrize(("distance", "shown"), [(1e-5, False), (1e-3, True)])
def test_a_resonance_between_measured_samples_may_show_on_its_flanks(Q, distance, shown):
    """It has four times the gain of the lag beneath it."""
    omega = np.geomspace(1e-3, np.pi, 60)
    angle, pole = np.sqrt(omega[33] * omega[34]), 1 - distance
    height = 8 * abs(lag()(np.exp(1j * angle))) * distance * np.sin(angle)
    denominator = [1, -2 * pole * np.cos(angle), pole**2]
    plant = lag() + control.tf([height], denominator, 1.0)
    P = frequency_response(plant, omega)
    design = synthesise(P, Q, omega, 1.0, order=3, band=(1e-3, 0.02))
    assert peak_around(plant, design, angle) > 1
    assert (codes(design.certificate.warnings) == ["samples"]) == shown
    assert "at resonances that no sample shows" in design.certificate.details


def test_what_lies_below_the_first_measured_frequency(Q):
    """The gain of the plant is 1, but -1 below 1e-4 rad/s."""
    omega = np.geomspace(1e-2, np.pi, 100)
    plant, asked = lag() + lag(1 - 1e-4, -2.0), {"order": 10, "band": (1e-2, 0.02)}
    design = synthesise(frequency_response(plant, omega), Q, omega, 1.0, **asked)
    certificate = design.certificate
    assert certificate.all_M < 1 < peak_around(plant, design, 1e-5)
    assert certificate.warnings == certificate.failures == []
    with pytest.raises(SolverError, match=r"at 0 rad/s, not in omega, reaches 2.00"):
        synthesise(plant, Q, omega, 1.0, **asked)


@SHOWN
@pytest.mark.parametrize("grid", [np.geomspace(1e-3, np.pi, 60), np.linspace(0.01, np.pi, 300)])
def test_the_truth_between_samples_is_below_the_estimate(loop, Q, grid):
    asked = paper_choices(band=(grid[0], 0.03), M_max=0.99)
    design = synthesise(loop.frequency_response(grid), Q, grid, 1.0, **asked)
    truth = sigma_of_M(np.geomspace(grid[0], np.pi, 5001), loop, Q, design.filter).max()
    assert design.certificate.grid_M < truth <= design.rate < 1.1 * truth


@given(st.integers(0, 999), st.integers(1, 2))
def test_the_truth_between_samples_of_random_plants_is_below_the_estimate(seed, m):
    """Where samples are close enough to show all of them."""
    model, Q = invertible(seed, m), zero_phase_butterworth(2, 0.5, 1.0)
    omega = np.geomspace(0.01, np.pi, 120)
    design = synthesise(frequency_response(model, omega), Q, omega, 1.0)
    truth = sigma_of_M(np.geomspace(0.01, np.pi, 5001), model, Q, design.filter)
    assert truth.max() <= design.rate * (1 + 1e-6)


def test_learning_that_does_nothing_is_named():
    problem = pose(lags(), BUTTERWORTH, OMEGA, 1.0, order=10)
    none = np.zeros((64, 2, 2))
    nothing = Solution(np.zeros((2, 2, 10)), none, none, 1, 0)
    [found] = certify(problem, problem, nothing).warnings
    assert (found.code, found.value) == ("idle", 1)


def test_models_have_a_proof_each_and_the_worst_is_named():
    design = of_lags(MODELS)
    certificate = design.certificate
    peaks = [peak_of_M(P, design.filter, BUTTERWORTH) for P in MODELS]
    worst = int(np.argmax(peaks, axis=0)[0])
    assert (certificate.all_M, certificate.peak.omega) == peaks[worst]
    assert certificate.peak.plant == worst > 0
    assert certificate.proven and certificate.failures == certificate.warnings == []
    assert certificate.grid_M == pytest.approx(0.6, rel=1e-9)
    problem = replace(certificate.problem, bounds=Bounds(0.1, None))
    peak = replace(certificate.peak, sigma=1.1)
    broken = replace(certificate, problem=problem, exact=[peak]).failures
    assert codes(broken) == ["M", "one or more"] and broken[1].value == 1.1
    assert all(found.place.startswith(f"of plant {worst} at ") for found in broken)


@pytest.mark.parametrize("model", [False, True])
def test_between_the_samples_the_radius_is_interpolated(model):
    """Judged on a dense grid by the exact bound; a model alone keeps its proof."""
    P = frequency_response(MODELS[0], OMEGA)
    radius = 0.1 * np.linalg.norm(P, 2, axis=(1, 2))
    design = of_lags(MODELS[0] if model else P, uncertainty=radius)
    certificate = design.certificate
    assert certificate.failures == [] and not certificate.proven
    near = certificate.peak.omega * np.linspace(0.99, 1.01, 201)
    dense = np.union1d(np.geomspace(1e-3, np.pi, 2001)[1:-1], near.clip(2e-3, 3.14))
    wide = np.interp(np.log(dense), np.log(OMEGA), radius)
    worst = design.check(MODELS[0], dense, uncertainty=wide).sigma.max()
    assert certificate.rate == pytest.approx(max(worst, certificate.grid_M), rel=1e-6)
    assert certificate.all_M > design.sigma_M.max()
    assert len(certificate.exact) == model
    assert ("at resonances that no sample shows" in certificate.details) != model


def test_a_worst_case_above_one_between_the_lines_warns_and_everywhere_mends_it():
    """The model alone keeps 0.64 between 12 lines, and 0.97 at each of them with the radius."""
    omega, Q = np.geomspace(1e-3, np.pi, 12), zero_phase_butterworth(2, 1.0, 1.0)
    P = frequency_response(MODELS[0], omega)
    asked = {"uncertainty": 0.2 * np.linalg.norm(P, 2, axis=(1, 2)), "L_max": 50.0, "order": 6}
    asked |= {"M_max": 0.97, "band": (1e-3, 0.1)}
    with pytest.warns(match="between the frequencies omega, may reach .* show too little"):
        design = synthesise(MODELS[0], Q, omega, **asked)
    certificate = design.certificate
    assert certificate.exact[0].sigma < 0.9 and certificate.grid_M < 0.971 < 1 < certificate.rate
    found = design.check(MODELS[0], omega, uncertainty=asked["uncertainty"])
    assert found.gamma == pytest.approx(certificate.rate, rel=1e-9) and not found.monotone
    mended = synthesise(MODELS[0], Q, omega, everywhere=True, **asked)
    assert mended.certificate.rate <= 0.97 * (1 + 1e-7) and mended.certificate.warnings == []


@pytest.mark.parametrize("radius", [None, 0.05 + 0 * OMEGA], ids=["plants", "radius"])
@pytest.mark.parametrize("unit", [-1e-13, 1e-13])
def test_of_those_that_are_tied_the_first_is_named_whatever_the_rounding(unit, radius):
    """The third plant is the second but for rounding."""
    P = [frequency_response(model, OMEGA) for model in (MODELS[0], MODELS[1], MODELS[1])]
    P[2] = P[2] * (1 + unit)
    design = of_lags(P, objective="peak", M_max=0.99, L_max=None, uncertainty=radius)
    tied = design.certificate.worst.tied
    if radius is None:
        sigma = convergence(P, BUTTERWORTH, design.filter, OMEGA).sigma
        frequency, plant = np.nonzero(sigma.T / sigma.max() > 1 - 1e-7)
        assert tied == tuple(zip(plant.tolist(), frequency.tolist(), strict=True))
    assert {k for plant, k in tied if plant == 1} == {k for n, k in tied if n == 2}
    assert 1 in dict(tied) and tied == tuple(sorted(tied, key=lambda pair: pair[::-1]))
    plant, k = tied[0]
    where = f"on the design grid: of plant {plant} at {OMEGA[k]:.4g} rad/s"
    assert where in design.certificate.details


def test_a_plant_that_diverges_between_the_samples_is_not_said_to_converge():
    """A resonance that no design frequency sees; of one channel |eigenvalue| is sigma_max."""
    lag, Q = control.tf([10], [1, 10]), zero_phase_butterworth(2, 100.0, 0.01)
    omega, asked = np.geomspace(0.1, np.pi / 0.01, 60), {"order": 10, "band": (0.1, 20.0)}
    plant = control.sample_system(lag, 0.01)
    design = synthesise(plant, Q, omega, M_max=0.97, everywhere=True, **asked)
    said = set()
    for w in np.linspace(55, 65, 6):
        mode = control.tf([0.002 * w**2], [1, 0.001 * w, w**2])
        plant = control.sample_system(lag + mode, 0.01)
        found = design.check(plant)
        dense = np.union1d(np.linspace(0.1, 314, 4000), np.linspace(w - 0.2, w + 0.2, 2001))
        assert found.converges == (rate(plant, Q, design.filter, dense).gamma < 1)
        said.add(str(found).partition(":")[0])
    assert "diverges" in said


def test_an_order_below_the_delay_of_the_plant_is_named():
    late = control.tf([0.1], [1, -0.9, *np.zeros(40)], 1.0)
    Q, omega = zero_phase_butterworth(2, 0.03, 1.0), np.geomspace(1e-3, np.pi, 110)
    with pytest.raises(InfeasibleError, match="P lags by 41 samples at the cut-off"):
        synthesise(late, Q, omega, order=12, M_max=0.1)
    design, chosen = (
        synthesise(late, Q, omega, base=None, **asked) for asked in ({"order": 12}, {})
    )
    assert "order = 12 (P lags by 41 samples at the cut-off)" in str(design)
    assert "P's lag of 41 samples" in chosen.certificate.details and chosen.certificate.rate < 0.1


@pytest.fixture(scope="module")
def design():
    return of_lags(lag(), FINE)


@pytest.mark.parametrize(("gain", "monotone"), [(1.3, True), (3.0, False)])
def test_on_a_model_it_is_proven(design, gain, monotone):
    P = lag(0.93, gain)
    result, as_array = design.check(P), design.check(frequency_response(P, FINE))
    gamma, omega = peak_of_M(P, design.filter, BUTTERWORTH)
    assert result.gamma == pytest.approx(gamma, rel=1e-8) and result.proven
    assert result.at == pytest.approx(omega, rel=1e-3)
    assert result.monotone == monotone == result.converges
    how = "converges monotonically" if monotone else "diverges"
    assert str(result).startswith(f"{how}: sigma_max(M) is {gamma:.4f} at most")
    assert ("long against the slowest mode" in str(result)) != monotone
    assert result.assumptions == ()
    assert as_array.gamma == pytest.approx(gamma, rel=1e-3) and not as_array.proven
    assert result.spectral_radius == pytest.approx(gamma, rel=2e-6)  # of one channel
    assert as_array.spectral_radius == pytest.approx(as_array.sigma.max(), rel=1e-12)
    assert "not proven between samples" in str(as_array)


def test_with_two_channels_trials_may_converge_and_not_monotonically():
    """M = Q (I - P L) is nearly nilpotent where the coupling goes one way only."""
    apart = control.ss(0.5 * np.eye(2), 0.5 * np.eye(2), np.eye(2), 0, 1.0)
    coupled = control.ss(0.5 * np.eye(2), [[0.5, 4.0], [0, 0.5]], np.eye(2), 0, 1.0)
    design = of_lags(apart, FINE)
    result = design.check(coupled)
    on_grid = convergence(coupled, BUTTERWORTH, design.filter, FINE)
    assert result.gamma >= on_grid.gamma > 1
    assert result.spectral_radius == pytest.approx(on_grid.spectral_radius, rel=1e-6)
    assert not result.monotone and result.converges
    assert str(result).startswith("converges, not monotonically")
    unsure = design.check(coupled, uncertainty=np.full(250, 1e-3))
    assert not unsure.converges and str(unsure).startswith("need not converge")


def test_a_loop_brings_its_P_and_tables_their_own_grid(loop, Q):
    own = np.geomspace(1e-4, 2.0, 70)
    design = synthesise(loop, Q, np.geomspace(1e-4, np.pi, 250), **paper_choices())
    all_M, P = design.certificate.all_M, loop.frequency_response(own)
    assert design.check(loop).gamma == pytest.approx(all_M, rel=1e-9)
    result = design.check(control.frd(np.moveaxis(P, 0, -1), own))
    assert result.gamma == pytest.approx(all_M, rel=1e-2)
    assert result.gamma >= rate(P, Q, design.filter, own).gamma
    assert "assumed: above 2 rad/s, where P is not known" in str(result)
    unsure = design.check(P, own, uncertainty=np.full(70, 1e-3))
    assert result.gamma < unsure.gamma and not unsure.proven


def test_above_a_table_the_assumed_size_counts(design):
    own = np.geomspace(1e-3, 0.4, 60)
    table = frequency_response(lag(), own)
    low = design.check(table, own)
    asked = {"order": 1, "L_max": None, "objective": "peak"}
    asked["uncertainty"] = np.append(np.zeros(59), 20.0)
    problem = pose(table, BUTTERWORTH, own, **asked)
    high = check(problem, design.filter).convergence
    assert low.gamma < 1 < high.gamma and high.at >= own[-1]
    assert low.converges and str(high).startswith("need not converge")
    assert f"sigma_max(P) is {20 + np.abs(table[-1, 0, 0]):.4g} at most" in str(high)


def test_samples_of_Q_are_known_at_the_design_frequencies_only():
    design = of_lags(lag(), FINE, BUTTERWORTH.frequency_response(FINE))
    gamma = design.check(lag()).gamma
    assert gamma == pytest.approx(design.certificate.all_M, rel=1e-6)
    with pytest.raises(ValueError, match="omega must be the design frequencies"):
        design.check(lag(), FINE[::2])
