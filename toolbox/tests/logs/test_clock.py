import numpy as np
import pandas as pd
import pytest

from ilctools import read_table
from ilctools.errors import LogError
from ilctools.logs.clock import check_trials, mean_step, seconds

GOOD = [0.0, 2.0, 4.0, 6.0]


def table_of(times, numbers=(1, 2, 3)):
    """Trials of these times, in the rows from 5 on."""
    rows = [(number, t) for number, trial in zip(numbers, times, strict=False) for t in trial]
    return pd.DataFrame(rows, range(5, 5 + len(rows)), ["trial", "time"], dtype=float)


ORDER = (1, 2, 3)
REFUSALS = [  # times of the second trial of three, numbers of the trials, what the error says
    ([0.0, 2.22, 4.2, 6.2], ORDER, "row 10 is 2.22 s after"),
    ([0.0, 2.0, 4.0, 5.7], ORDER, "row 12 is 1.7 s after"),
    ([0.0, 2.0, 4.0], ORDER, "equally long, but trial 2 has 3"),
    ([0.3, 2.3, 4.3, 6.3], ORDER, "0.3 in row 9"),
    (GOOD, (3, 1, 3), "3 in row 13 must"),
    (GOOD, (1, 2.5, 3), "2.5"),
]


@pytest.mark.parametrize(("second", "numbers", "message"), REFUSALS)
def test_trials_that_are_not_whole_alike_and_in_time_are_refused(second, numbers, message):
    with pytest.raises(LogError, match=message):
        check_trials(table_of([GOOD, second, GOOD], numbers), 2.0)


def test_a_step_may_be_off_by_a_tenth_and_the_mean_by_a_hundredth():
    check_trials(table_of([GOOD, [0.0, 2.18, 4.0, 6.18], GOOD]), 2.0)
    check_trials(table_of([2.02 * np.arange(300)]), 2.0)
    with pytest.raises(LogError, match=r"the mean step is 2.03 s, but Ts = 2 s"):
        check_trials(table_of([2.03 * np.arange(300)]), 2.0)


def test_a_clock_that_is_nearly_exact_is_not_noted():
    assert check_trials(table_of([[0.0, 2.001, 4.0]]), 2.0) == {}
    assert "from 1.9 to 2.1 s" in check_trials(table_of([[0.0, 2.1, 4.0]]), 2.0)["clock"]


@pytest.mark.parametrize(
    ("times", "Ts"),
    [(np.arange(50) / 60, 1 / 60), (1.0015 * np.arange(50) + 0.01 * np.sin(np.arange(50)), 1.0)],
)
def test_a_clock_shows_the_sampling_period(times, Ts):
    assert mean_step(table_of([times])) == pytest.approx(Ts, rel=1e-9)


def test_a_unit_of_time_is_known_in_seconds():
    assert [seconds(unit) for unit in ("us", "ms", "secs", "min", "h")] == [1e-6, 1e-3, 1, 60, 3600]


def test_a_clock_since_1970_in_a_finer_unit_is_not_one_in_s():
    """Seconds since 1970 are; and with its unit it is what the steps say."""
    t = 1.0e9 + 0.25 * np.arange(40)  # multiples of a quarter, which doubles hold exactly
    asked = {"time": "t", "outputs": {"T": "t"}}
    in_ms = pd.DataFrame({"t": 1000 * t})
    with pytest.raises(LogError, match=r"begins at 1000000000000, .* state its unit"):
        read_table(in_ms, **asked)
    assert read_table(in_ms, **asked, units={"time": "ms"}).attrs["Ts"] == 0.25
    assert read_table(in_ms / 1000, **asked).attrs["Ts"] == 0.25
