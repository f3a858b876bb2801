"""What the readings of a rig must be."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from plants import TASK, Axis

from ilctools import record
from ilctools.errors import RigError


def test_a_reading_of_one_output_may_be_a_number():
    """As `law.next` takes signals of one channel without an axis for it."""
    law, plain, listed = TASK["law"], Axis(), record(Axis(), **TASK, trials=3)
    for number in (float, np.array):
        plain.x, plain.read = 0.0, lambda number=number: number(plain.x)
        assert record(plain, **TASK, trials=3).identical(listed)
    v, e = (listed[name].values[0] for name in ("v", "e"))
    assert np.array_equal(law.next(v[:, 0], e[:, 0]), law.next(v, e)[:, 0])


@pytest.mark.parametrize(
    ("method", "bad", "name"),
    [
        *(("read", bad, "reading of x") for bad in ([np.nan], [0.0, 0.0], None)),
        ("clock", np.nan, "clock"),
        ("wind", None, "wind"),
    ],
)
def test_an_error_of_a_reading_says_in_which_trial_and_sample(method, bad, name):
    """In its text, which a log of a service has without notes."""
    good = {"read": [[0.0]] * 206, "clock": np.arange(206) * 0.01, "wind": [0.0] * 207}
    given = {"wind": lambda: 0.0, method: partial(next, iter(good[method]), bad)}

    class Windy(Axis):
        measured = property(lambda axis: {"wind": axis.wind()})  # one more, to see if it is there

    loop = replace(TASK["loop"], disturbances=["wind"])
    with pytest.raises(RigError) as error:
        record(Windy(**given), **TASK | {"loop": loop}, pause=0)
    assert str(error.value).startswith(f"trial 2, sample 7: {name} ")
