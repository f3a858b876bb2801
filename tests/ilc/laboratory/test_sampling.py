import numpy as np
import pytest

from rodlib.ilc.laboratory.sampling import check_trials
from rodlib.ilc.laboratory.tables import Table


def checked(times, numbers=(1, 2, 3)):
    """Trials of these times, below a header in line 4."""
    rows = [(number, t) for number, own in zip(numbers, times, strict=True) for t in own]
    table = Table({}, ["trial", "time"], [], np.array(rows).T, range(5, 5 + len(rows)))
    return check_trials(table, 2.0)


@pytest.mark.parametrize(
    ("second", "message"),
    [
        ([0.002, 2.002, 4.002, 6.002], None),
        ([-0.002, 1.998, 3.998, 5.998], None),
        ([0.0022, 2.0, 4.0, 6.0], "sample 0 of trial 2, in row 9, is at 0.0022, but due at 0"),
        ([0.0, 2.0, 4.0022, 6.0], "sample 2 of trial 2, in row 11, is at 4.0022, but due at 4"),
        ([0.0, 2.0, 6.0, 8.0], "sample 2 of trial 2, in row 11, is at 6, but due at 4: a gap, or"),
        ([0.0, 0.0, 2.0, 4.0], "sample 1 of trial 2, in row 10, is at 0, but due at 2"),
    ],
)
def test_clocks_may_be_off_by_a_thousandth_of_a_period(second, message):
    numbers, time, problems = checked([[0, 2, 4, 6], second, [0, 2, 4, 6]])
    assert [*numbers] == [1, 2, 3] and [*time] == [0, 2, 4, 6]
    assert len(problems) == (message is not None)
    assert message is None or message in problems[0]


@pytest.mark.parametrize(
    ("times", "numbers", "message"),
    [
        ([[0, 2], [0, 2, 4], [0, 2]], (1, 2, 3), "2 samples in trial 1, 3; 3 samples in trial 2"),
        ([[0, 2], [0, 2], [0, 2]], (3, 1, 3), "trial: 3 goes on in row 9, after trial 1: the rows"),
        ([[0, 2], [0, 2], [0, 2]], (1, 2, 0), "0 in row 9 is no whole number, 1 or more"),
        ([[0, 2], [0, 2], [0, 2]], (1, 2.5, 3), "2.5 in row 7 is no whole number, 1 or more"),
    ],
)
def test_trials_that_are_none_are_told(times, numbers, message):
    (problem,) = checked(times, numbers)[2]
    assert message in problem
