import numpy as np
import pytest

from rodlib.ilc.logs.sampling import check_trials, period_of, resample
from rodlib.ilc.logs.tables import Table


def table_of(times, numbers=(1, 2, 3)):
    """Trials of these times, below a header in line 4; x is the square of the time."""
    rows = [
        (number, t, t**2, t)
        for number, own in zip(numbers, times, strict=True)
        for t in own
    ]
    return Table(
        {}, ["trial", "time", "x", "u"], [], np.array(rows).T, range(5, 5 + len(rows))
    )


@pytest.mark.parametrize(
    ("second", "message"),
    [
        ([0.002, 2.002, 4.002, 6.002], None),
        ([0.0, 2.18, 4.0, 6.18], None),
        ([0.0, 2.01, 4.02, 6.03], None),
        (
            [0.0, 2.22, 4.2, 6.2],
            "row 10 of trial 2 is 2.22 after the row before, where Ts = 2: ir",
        ),
        (
            [0.0, 2.0, 4.0, 5.7],
            "row 12 of trial 2 is 1.7 after the row before, where Ts = 2: irr",
        ),
        (
            [0.0, 2.0, 6.0, 8.0],
            "row 11 of trial 2 is 4 after the row before, where Ts = 2: 1 lost",
        ),
        (
            [0.0, 2.0, 8.0, 8.0],
            "row 12 of trial 2 is at 8, not later than the row before",
        ),
        (
            [0.0, 2.0, 1.0, 6.0],
            "row 11 of trial 2 is at 1, not later than the row before",
        ),
        ([0.3, 2.3, 4.3, 6.3], "trial 2, in row 9, begins at 0.3, not at 0"),
    ],
)
def test_each_step_of_a_clock_may_be_off_by_a_tenth_and_their_mean_by_a_hundredth(
    second, message
):
    table = table_of([[0, 2, 4, 6], second, [0, 2, 4, 6]])
    numbers, problems = check_trials(table, 2.0)
    assert [*numbers] == [1, 2, 3]
    assert len(problems) == (message is not None)
    assert message is None or message in problems[0]


@pytest.mark.parametrize(
    ("times", "numbers", "message"),
    [
        (
            [[0, 2], [0, 2, 4], [0, 2]],
            (1, 2, 3),
            "2 samples in trial 1, 3; 3 samples in trial 2",
        ),
        (
            [[0, 2], [0, 2], [0, 2]],
            (3, 1, 3),
            "trial: 3 goes on in row 9, after trial 1: the rows",
        ),
        (
            [[0, 2], [0, 2], [0, 2]],
            (1, 2, 0),
            "0 in row 9 is no whole number, 1 or more",
        ),
        (
            [[0, 2], [0, 2], [0, 2]],
            (1, 2.5, 3),
            "2.5 in row 7 is no whole number, 1 or more",
        ),
    ],
)
def test_trials_that_are_none_are_told(times, numbers, message):
    (problem,) = check_trials(table_of(times, numbers), 2.0)[1]
    assert message in problem


def test_a_period_that_is_another_one_is_refused():
    """Each step is within a tenth, but on the whole the clock is as fast as it says."""
    assert check_trials(table_of([2.02 * np.arange(300)], [1]), 2.0)[1] == []
    (problem,) = check_trials(table_of([2.03 * np.arange(300)], [1]), 2.0)[1]
    assert "the mean step is 2.03, but Ts = 2: state that as Ts" in problem


@pytest.mark.parametrize(
    ("times", "Ts"),
    [
        (np.arange(50) / 60, 1 / 60),
        (0.001 * np.arange(50), 0.001),
        (1.0015 * np.arange(50) + 0.01 * np.sin(np.arange(50)), 1.0),
        (np.delete(3.0 * np.arange(50), [7, 8, 20]), 3.0),
        ([5.0, 5.0], None),
        ([5.0], None),
    ],
)
def test_a_clock_tells_the_sampling_period(times, Ts):
    found = period_of(table_of([times], [1]))
    assert found == (Ts and pytest.approx(Ts, rel=1e-9))


def test_resampled_rows_are_interpolated_or_held():
    table = table_of([[0, 2.5, 4, 10, 12], [7, 9, 11, 13, 15, 17, 19]], [1, 2])
    assert resample(table, 2.0, ["x"]) == (
        "12 rows were resampled to 14 samples; near 2 of them is no row, and the longest step is 6 "
        "where Ts = 2"
    )
    known = np.interp(
        [0, 2, 4, 6, 8, 10, 12], [0, 2.5, 4, 10, 12], [0, 6.25, 16, 100, 144]
    )
    np.testing.assert_allclose(table.column("x")[:7], known)
    np.testing.assert_array_equal(
        table.column("u"), [0, 2.5, 4, 4, 4, 10, 12, *range(7, 20, 2)]
    )
    np.testing.assert_array_equal(table.column("x")[7:], np.arange(7, 20, 2) ** 2)
    assert list(table.lines) == [5, 6, 7, 7, 7, 8, 9, *range(10, 17)]
    assert check_trials(table, 2.0, anywhere=True)[1] == []


@pytest.mark.parametrize(
    ("times", "Ts"),
    [
        ([[0, 2, 3, 3]], 2.0),
        ([[0, 2, 4, 40]], 2.0),
        ([[0, 2, 4], [0, 2.5, 4, 6, 8]], 2.0),
    ],
)
def test_what_cannot_be_resampled_stays_as_it_is(times, Ts):
    table = table_of(times, range(1, 1 + len(times)))
    before = table.columns.copy()
    assert resample(table, Ts, ["x"]) is None
    np.testing.assert_array_equal(table.columns, before)
    assert check_trials(table, Ts)[1]
