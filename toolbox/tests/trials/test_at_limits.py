import numpy as np
import pytest
from plants import bump, lag

from ilctools import ClosedLoop, run_trials, synthesise, zero_phase_butterworth

P, R = lag(0.6), bump(80, [1.0])
LOOP, Q = ClosedLoop(P), zero_phase_butterworth(2, 0.5, 1.0)


def test_learning_that_stands_still_says_why():
    """The limit touches the reference, the error of the model may be large, and noise takes all."""
    design = synthesise(P, Q, uncertainty=0.3)
    law = design.law(limits={"y[0]": (None, 1.0)}, noise={"y[0]": 0.2})
    expected = r"learning stands still at the limit of y\[0\], because .* may add [0-9.e-]+, "
    with pytest.warns(UserWarning, match=expected + "and the room is 0"):
        run_trials(LOOP, law, R, trials=6, v=-0.35 * R)


def test_the_first_trial_beyond_a_limit_is_named_and_no_other():
    """The plant changes in trial 3, as by another load, which is in no radius."""
    law = synthesise(P, Q, uncertainty=0.1).law(limits={"y[0]": (None, 1.02)})
    disturbed = np.zeros((4, 80, 1))
    disturbed[2, 40] = 0.1
    with pytest.warns(UserWarning, match=r"y\[0\] was beyond its limit by 0\.0.* in trial 3"):
        run = run_trials(LOOP, law, R, trials=4, noise=disturbed)
    assert run.y[[0, 1, 3]].max() <= 1.02
