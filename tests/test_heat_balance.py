"""The heat balance of two heaters, fitted to real records, and to simulated ones of known truth."""

import control
import numpy as np
import pytest

from rodlib.boards import fit_heat_balance, heat_balance

BOARD = np.array([0.0033, 0.0018, 0.0051, 0.0018, 18.0])
MOVES = np.repeat([[50.0, 0], [80, 40], [10, 40], [10, 90], [60, 0], [0, 0]], 25, axis=0)


def simulated(parameters, moves=MOVES, Ts=4.0, zero=(21.0, 19.5)):
    """By python-control, which knows nothing of the fit."""
    answer = control.forced_response(heat_balance(*parameters, Ts), inputs=moves.T)
    return np.asarray(answer.outputs).T + zero


@pytest.mark.parametrize(
    "true",
    [
        BOARD,  # slow heaters, quick thermometers
        [0.035, 0.0175, 0.05, 0.01, 140.0],  # the reverse: the emulator
        [0.004, 0.02, 0.008, 0.02, 5.0],
    ],
)
def test_what_made_a_record_is_found_from_it(true):
    fit = fit_heat_balance(MOVES, simulated(true), 4.0)
    np.testing.assert_allclose(fit.values, true, rtol=1e-4)
    np.testing.assert_allclose(fit.zero, [21.0, 19.5], atol=1e-3)
    assert np.abs(fit.left).max() < 1e-3


def test_the_gain_of_a_heater_that_is_idle_is_not_determined():
    moves = MOVES * [1, 0]
    readings = simulated(BOARD, moves)
    readings += 0.05 * np.random.default_rng(1).standard_normal(readings.shape)
    fit = fit_heat_balance(moves, readings, 4.0)
    low, high = fit.table().loc["gain_2", ["from", "to"]]
    assert low < 1e-99 and high > 1e99
    rest = [0, 2, 3, 4]
    np.testing.assert_allclose(fit.values[rest], BOARD[rest], rtol=0.2)


def test_intervals_hold_the_truth_and_are_as_wide_as_the_noise():
    """1.5 of 30 may be without: of Bin(30, 0.05) more than five are as rare as 1 in 300."""
    outside, widths = 0, []
    for seed in range(6):
        noise = np.random.default_rng(seed).standard_normal((len(MOVES), 2))
        sizes = [0.4 * noise] if seed else [0.1 * noise, 0.4 * noise]
        for size in sizes:
            fit = fit_heat_balance(MOVES / 1000, simulated(BOARD) + size, 4.0)
            widths.append(np.log(fit.table().to / fit.table()["from"]))
        scale = np.array([1000, 1000, 1, 1, 1])  # of another unit of the heaters
        table = fit.table()
        true = BOARD * scale
        outside += np.sum((true < table["from"]) | (true > table.to))
    assert outside <= 5
    np.testing.assert_allclose(widths[1] / widths[0], 4, rtol=0.1)
