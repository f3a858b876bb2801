"""The peak over all frequencies, and what is said where P is not known: below the first sample."""

import warnings

import control
import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from plants import copies, lags, random_stable

from ilctools import measured_response, read_table, synthesise, zero_phase_butterworth
from ilctools.evidence.peak import BELOW, PEAK_TOLERANCE, peak_of_M, proven_peak, with_tops
from ilctools.models import frequency_response
from ilctools.response.door import in_own_units
from ilctools.singular_values import largest_singular_values

[AXIS] = copies(1)
Q = zero_phase_butterworth(2, 40.0, 0.01)


def table(first, last=314.0):
    return control.frequency_response(AXIS, np.geomspace(first, last, 200))


@pytest.mark.filterwarnings("ignore:the error grows", "ignore:the phase of P leads")
def test_a_table_that_begins_too_late_promises_nothing():
    """At 20 rad/s the phase is -90 degrees: the law diverges on the plant, and that is said."""
    with pytest.warns(match=r"sigma_max\(M\) may reach .* below 20 rad/s, where P is not known"):
        design = synthesise(table(20.0), Q)
    true, at = peak_of_M(AXIS, design.filter, Q)
    assert true > 5 and at == 0 and design.rate >= true
    assert design.certificate.failures == []
    assert "assumed: below 20 rad/s, where P is not known" in f"{design}"
    assert not design.check(table(20.0)).converges


@pytest.mark.parametrize(("first", "more"), [(0.4, 1e-3), (4.0, 0.1)])
def test_a_table_with_a_small_phase_hardly_suffers(first, more):
    """Nothing warns, the filter is that for the known range, and the rate holds for the plant.

    What is added is d of response/samples, which 2 zeta x = x = omega_1 / 20 decides:
    Re P is 1 + O(x^4) for this damping, so that it is about x^2.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        design = synthesise(table(first), Q)
    true, _ = peak_of_M(AXIS, design.filter, Q)
    known = design.certificate.peaks["estimated"].sigma
    assert true <= design.rate * (1 + 1e-3)
    assert design.rate <= known + more
    assert f"above this frequency, the rate is {known:.4f}" in f"{design}"


def test_a_rate_within_a_radius_holds_for_plants_within_it_down_to_rest():
    """README's example: any gain within 5 % of P's, at rest too."""
    design = synthesise(table(0.5), Q, uncertainty=0.05)
    for gain in (0.951, 1.049):
        assert peak_of_M(gain * AXIS, design.filter, Q)[0] <= design.rate
    assert design.rate < 0.055


def test_a_model_is_known_at_rest():
    omega = np.geomspace(20, 314, 200)
    assert BELOW not in synthesise(AXIS, Q, omega).certificate.peaks
    design = synthesise(AXIS, Q, omega, uncertainty=0.01)
    assert BELOW not in design.certificate.peaks and "assumed: below" not in f"{design}"


def test_a_record_says_itself_what_P_is_below_its_lowest_frequency():
    """By the region of its estimate, in whatever units; judged by the plant at rest."""
    plant, rng, time = lags(), np.random.default_rng(0), np.arange(800)
    w = np.cumsum(rng.standard_normal((800, 2)), axis=0) / 10
    w -= np.outer(time / time[-1], w[-1])
    y = control.forced_response(plant, inputs=w.T).outputs.T
    columns = np.column_stack([time, w, y + 0.002 * rng.standard_normal(y.shape)])
    table = pd.DataFrame(columns, columns=["t", "a", "b", "p", "q"])
    log = read_table(table, time="t", inputs={"a": "a", "b": "b"}, outputs={"p": "p", "q": "q"})
    measured, lowpass = measured_response(log, delay=1), zero_phase_butterworth(2, 0.05, 1.0)
    [at_rest] = frequency_response(plant, [0.0]).real
    for scale in ([1.0, 1.0], [1.0, 1.5]):
        design = synthesise(measured, lowpass, scale=scale)
        assert design.certificate.peaks["estimated"].sigma < design.rate < 1
        assert peak_of_M(plant, design.filter, lowpass)[0] <= design.rate
        assert "P is what the measured response says at zero frequency" in f"{design}"
        S = np.array(scale)
        response = design.problem.response
        for known, truth in (
            (response, at_rest * S / S[:, None]),
            (in_own_units(response), at_rest),
        ):
            [P], [radius] = known.anywhere(0, np.zeros(1))
            assert np.linalg.norm(P - truth, 2) <= radius < 0.5
            assert not P.imag.any()


def test_the_tops_of_crests_are_those_of_parabolas():
    omega = np.array([0.0, 0.7, 1.4, 2.0])

    def parabola(omega):
        return 1.01 - 0.05 * (omega - 1) ** 2

    at, values = with_tops(parabola, omega)
    assert at[-1] == pytest.approx(1) and values.max() == values[-1] == pytest.approx(1.01)
    assert len(with_tops(parabola, omega, height=1.02)[0]) == 4


def peak_gain(system, lowpass=None):
    """Of a system by itself, or behind a filter."""

    def sigma(omega):
        gain = 1.0 if lowpass is None else lowpass.frequency_response(omega)
        return gain * largest_singular_values(frequency_response(system, omega))

    return proven_peak(
        sigma, np.append(system.poles(), [] if lowpass is None else lowpass.poles), 1
    )


@given(
    st.integers(1, 5),
    st.integers(1, 3),
    st.sampled_from([1e-1, 1e-4, 1e-8]),
    st.none() | st.tuples(st.integers(1, 8), st.sampled_from([1e-3, 0.1, 3])),
    st.integers(0, 999),
)
def test_a_peak_is_above_and_close_to_brute_force_in_whatever_units(n, m, distance, cut, seed):
    """Of random systems with poles near the circle; matrices are inverted at each frequency."""
    rng, system = np.random.default_rng(seed), random_stable(seed, n, m, distance, Ts=1.0)
    rounding, lowpass = 1e-14 / distance, None
    if cut:
        try:
            lowpass = zero_phase_butterworth(*cut, 1.0)
        except ValueError:  # cut off so low that its poles are rounded
            assume(False)
        rounding += 1e-15 / cut[1] ** 2  # of |z - p|^2, p a pole of Q
    A, B, C, D = control.ssdata(system)
    units = 10.0 ** rng.uniform(-8, 8, n)
    gain, place = peak_gain(
        control.ss(A * units / units[:, None], B / units[:, None], C * units, D, 1.0), lowpass
    )
    near = np.append(place, np.abs(np.angle(system.poles())))[:, None]
    about = (near + distance * np.linspace(-1, 1, 11) * 1e-3).ravel()
    omega = np.concatenate([about, np.linspace(0, np.pi, 2001), [place]])
    z = np.exp(1j * omega)[:, None, None]
    sigma = np.linalg.matrix_norm(C @ np.linalg.solve(z * np.eye(n) - A, [B]) + D, ord=2)
    if lowpass:
        sigma *= lowpass.frequency_response(omega)
    assert sigma.max() <= gain * (1 + rounding)
    assert gain <= sigma[-1] * (1 + PEAK_TOLERANCE + rounding)


def test_an_unstable_system_has_no_peak():
    with pytest.raises(ValueError, match="unstable, because it has a pole of modulus 1"):
        peak_gain(control.ss(1.0, 1, 1, 0, 1.0))
