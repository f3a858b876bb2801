"""How large signals are, by their sums written out."""

import numpy as np
import pytest
import xarray as xr

from ilctools import rms
from ilctools.trials.rms import harmonics, noise_std, octaves, rms_by_octave

WHITE = np.random.default_rng(2).standard_normal((50, 2))


def test_rms_is_the_papers_definition():
    expected = np.sqrt(sum(e @ e for e in WHITE) / 50)
    e = xr.DataArray(WHITE, dims=("time", "channel"))
    assert rms(e).item() == pytest.approx(expected)
    assert rms(xr.Dataset({"reference": 2 * e, "y": e})).item() == rms(e).item()


def test_the_size_of_whole_numbers_is_not_wrapped():
    numbers = xr.DataArray(np.full((9, 1), 300, np.uint16), dims=("time", "channel"))
    assert rms(numbers) == rms(xr.Dataset({"reference": numbers, "y": 2 * numbers})) == 300


@pytest.mark.parametrize("samples", [49, 50])
def test_octaves_have_the_power_of_their_waves(samples):
    """One wave in the octave from 4 to 7; and whatever the signal, no power is lost."""
    wave = np.cos(2 * np.pi * 5 * np.arange(samples) / samples)[:, None]
    assert octaves(samples).tolist() == [0, 2, 4, 8, 16]
    np.testing.assert_allclose(rms_by_octave(wave), np.sqrt([0, 0, 0.5, 0, 0]), atol=1e-9)
    power = np.sum(np.abs(harmonics(WHITE[:samples])) ** 2, axis=0)
    np.testing.assert_allclose(power, np.mean(WHITE[:samples] ** 2, axis=0))


def test_the_noise_is_what_differs_between_neighbours():
    noise = 0.1 * np.random.default_rng(0).standard_normal((10**5, 1))
    ramp = np.linspace(0, 1000, len(noise))[:, None]
    assert noise_std(ramp + noise) == pytest.approx(0.1, rel=0.02)
