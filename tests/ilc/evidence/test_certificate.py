"""What a certificate says, and when it fails."""

from contextlib import nullcontext
from dataclasses import replace

import control
import numpy as np
import pytest

from rodlib import synthesise
from rodlib.ilc.problem.problem import convergence_matrix, largest_singular_values
from rodlib.ilc.synthesis.result import SolverError


def test_a_certificate_prints_and_fails_as_it_should(loop, Q, omega):
    design = synthesise(loop, Q, omega[::5], 1.0, band=(1e-4, 0.01), samples=200)
    assert design.certificate.failures == []
    text = str(design.certificate)
    assert "norm of one trial of 200 samples: 1.27" in text
    assert (
        "over all frequencies" in text
        and "no diagonal filter of order 10 below" in text
        and "FAILS" not in text
    )
    bad = synthesise(
        loop, Q, omega[::5], 1.0, band=(1e-4, 0.01), M_max=0.95
    ).certificate
    tighter, peak = (
        replace(bad.problem, M_max=0.9),
        replace(bad.peak, sigma=1.01, omega=0.25),
    )
    wrong = replace(
        bad, problem=tighter, peak=peak, exact=peak, lower_bound=bad.value / 2
    )
    assert len(wrong.failures) == 3 and str(wrong).count("FAILS") == 3
    assert "sigma_max(M) reaches 1.01 at 0.25 rad/s, not in omega" in str(wrong)
    peak = replace(peak, sigma=1.2, omega=0.3)
    estimated = replace(design.certificate, peak=peak, estimated=1)
    assert "WARNING: sigma_max(M) may reach 1.2 at 0.3 rad/s" in str(estimated)
    assert design.certificate.warnings == estimated.failures == []
    at_rest = str(replace(design.certificate, rest=15))
    assert "norm of one trial of 200 samples, the last 15 at rest: 1.27" in at_rest


def test_a_certificate_fails_from_the_tolerance_on(loop, Q, omega):
    """A gap of 1e-6, a bound on the grid passed by 1e-9, relative; from 0.25 of the margin on."""
    good = synthesise(loop, Q, omega[::5], 1.0, band=(1e-4, 0.01)).certificate

    def failing(sigma_M=None, all_M=0.9, **changes):
        worst = (
            replace(good.worst, sigma=np.array([sigma_M])) if sigma_M else good.worst
        )
        peak = replace(good.peak, sigma=all_M)
        return len(
            replace(good, worst=worst, peak=peak, exact=peak, **changes).failures
        )

    def estimated(all_M, missed):
        return replace(
            good, peak=replace(good.peak, sigma=all_M, missed=missed), estimated=1
        )

    value, idle = good.value, good.problem.idle
    assert value > 1e-3 * idle
    assert not failing(lower_bound=value * (1 - 0.99e-6))
    assert failing(lower_bound=value * (1 - 1.01e-6)) == 1
    assert not failing(0.9 * (1 + 0.99e-9), grid_L=50 * (1 + 0.99e-9))
    assert failing(0.9 * (1 + 1.01e-9)) == failing(grid_L=50 * (1 + 1.01e-9)) == 1
    assert not failing(passed_L=1 + 0.99e-9) and failing(passed_L=1 + 1.01e-9) == 1
    assert failing(grid_L=50.1, passed_L=1.002) == 1
    assert not failing(all_M=np.nextafter(1, 0)) and failing(all_M=1.0) == 1
    for missed, warned in ((0.049, 0), (0.051, 1)):
        assert len(estimated(0.8, missed).warnings) == warned
    assert len(estimated(1.0, 0.0).warnings) == 1
    perfect = replace(good, value=1e-9 * idle, lower_bound=0.0)
    assert perfect.gap == pytest.approx(
        1e-6
    )  # relative to a thousandth of the objective, idle


def with_resonance(angle, distance, height):
    """A lag, and a resonance of `height` times the gain of the lag, at an angle."""
    lag = control.tf([0.1], [1, -0.9], 1.0)
    radius = 1 - distance
    height *= abs(lag(np.exp(1j * angle))) * distance * 2 * np.sin(angle)
    return lag + control.tf([height], [1, -2 * radius * np.cos(angle), radius**2], 1.0)


def peak_around(plant, design, Q, angle):
    """Largest sigma_max(M) on a grid so fine around an angle that nothing hides there."""
    omega = angle * (1 + np.linspace(-0.3, 0.3, 60001))
    L = design.filter.frequency_response(omega)
    P = plant(np.exp(1j * omega))[:, None, None]
    return largest_singular_values(
        convergence_matrix(P, Q.frequency_response(omega), L)
    ).max()


@pytest.mark.parametrize(
    ("distance", "shown"),
    [(1e-5, False), (1e-3, True)],
    ids=["hidden", "on its flanks"],
)
def test_a_resonance_between_measured_samples(Q, distance, shown):
    omega = np.geomspace(1e-3, np.pi, 60)
    angle = np.sqrt(omega[33] * omega[34])
    plant = with_resonance(angle, distance, 4.0)
    P = plant(np.exp(1j * omega))[:, None, None]
    with pytest.warns(match="too coarse") if shown else nullcontext():
        design = synthesise(P, Q, omega, 1.0, order=3, band=(1e-3, 0.02))
    certificate, text = design.certificate, str(design.certificate)
    assert certificate.all_M < 1 < peak_around(plant, design, Q, angle)
    assert (
        bool(certificate.warnings)
        == shown
        == ("WARNING: the samples are too coarse" in text)
    )
    assert "not known" in text and "at resonances that no sample shows" in text


def test_what_lies_below_the_first_measured_frequency(Q):
    omega = np.geomspace(1e-2, np.pi, 100)
    slow = control.tf([-2e-4], [1, -(1 - 1e-4)], 1.0)
    plant = (
        control.tf([0.1], [1, -0.9], 1.0) + slow
    )  # its gain is 1, but -1 below 1e-4 rad/s
    P = plant(np.exp(1j * omega))[:, None, None]
    design = synthesise(P, Q, omega, 1.0, band=(1e-2, 0.02))
    certificate, text = design.certificate, str(design.certificate)
    assert certificate.all_M < 1 < peak_around(plant, design, Q, 1e-5)
    assert "sigma_max(M) from 0.01 to 3.142 rad/s, between the samples:" in text
    assert "sigma_max(M) unknown: below 0.01 rad/s, at resonances" in text
    assert certificate.warnings == [] and certificate.failures == []
    with pytest.raises(
        SolverError, match=r"sigma_max\(M\) reaches 2.00\d* at 0 rad/s, not in omega"
    ):
        synthesise(control.ss(plant), Q, omega, 1.0, band=(1e-2, 0.02))


@pytest.mark.filterwarnings("ignore:the samples are too coarse")
@pytest.mark.parametrize(
    "grid", [np.geomspace(1e-3, np.pi, 60), np.linspace(0.01, np.pi, 300)]
)
def test_the_estimate_between_samples_misses_less_than_it_says(loop, Q, grid):
    P = loop.frequency_response(grid)
    design = synthesise(P, Q, grid, 1.0, band=(grid[0], 0.03), M_max=0.99)
    dense = np.geomspace(grid[0], np.pi, 20001)
    L = design.filter.frequency_response(dense)
    M = convergence_matrix(
        loop.frequency_response(dense), Q.frequency_response(dense), L
    )
    peak = largest_singular_values(M).max()
    assert abs(design.certificate.all_M - peak) < design.certificate.peak.missed
