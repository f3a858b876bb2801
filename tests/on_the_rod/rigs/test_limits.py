"""A rig that is stopped while somebody watches: what is kept."""

import numpy as np
import pytest
from plants import bump
from rods import Failing

from ilctools import Law, LearningFilter, load_log, record
from ilctools.errors import StoppedError


def test_what_was_learned_before_a_stop_is_kept(loop, Q, tmp_path):
    """Somebody knocks in the third trial. With a path in the log, in any case with the error.

    The same call goes on.
    """
    law, path = Law(Q, LearningFilter(np.eye(2)[..., None], 1.0)), tmp_path / "log.csv"
    trials, knock = (loop, law, bump(25, [0.5, 0.2]), None, 3), (2 * 25 + 7, [100.0, 100.0])
    whole = record(Failing(), *trials)
    with pytest.raises(StoppedError, match=r"(?s)y1 = .*in trial 3, sample 8") as stop:
        record(Failing(*knock), *trials, path=path)
    assert str(path) in stop.value.__notes__[0]
    assert load_log(path).identical(stop.value.trials)
    assert stop.value.trials.identical(whole.isel(trial=slice(2)))
    assert record(Failing(), *trials, path=path).identical(whole)
    wider = {"y1": (-200.0, 200.0), "y2": None, "Q1": (-60.0, 60.0)}
    with pytest.raises(StoppedError, match=r"(?s)Q1 = .*in trial 3, sample 9"):
        record(Failing(*knock), *trials, stop=wider)
