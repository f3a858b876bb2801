"""Trials and their contrasts: what repeats is in one series of each group."""

import numpy as np
from records import trials_of

from ilctools.measurement.arx.trials import SeriesKey, contrasts, keys_of, series_of


def test_a_disturbance_that_repeats_is_in_the_means_alone_and_white_noise_stays_white():
    noise = np.random.default_rng(0).standard_normal((5, 30))
    repeats = np.sin(np.arange(30))
    mean, *differences = contrasts(noise + repeats) - contrasts(noise)
    np.testing.assert_allclose(mean, 5**0.5 * repeats, atol=1e-12)
    np.testing.assert_allclose(differences, 0, atol=1e-12)
    np.testing.assert_allclose(contrasts(np.eye(5)) @ contrasts(np.eye(5)).T, np.eye(5), atol=1e-15)


def test_each_series_is_found_by_its_key():
    """A single trial is no mean, though all of it may repeat."""
    groups = first, second = trials_of(3), trials_of(1, N=40)
    found = {series.key: series for series in series_of(groups)}
    assert list(found) == keys_of(groups) and len(found) == 4
    assert [key for key, series in found.items() if series.is_mean] == [(0, 0)]
    assert [key for key in found if key.has_what_repeats] == [(0, 0), (1, 0)]
    np.testing.assert_array_equal(found[SeriesKey(1, 0)].u, second.u[0])
    difference = found[SeriesKey(0, 1)]
    np.testing.assert_allclose(difference.y, (first.y[0, :, 0] - first.y[1, :, 0]) / 2**0.5)
