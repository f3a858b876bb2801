"""The first trial of another task, on the rod."""

import control
import pytest

from ilctools import Law, NormOptimal, run_trials, transfer, zero_phase_butterworth
from ilctools.trials.rms import rms
from rodlib import midr
from rodlib.case import assumed_disturbance, assumed_reference
from rodlib.rigs import MISMATCHED


@pytest.mark.filterwarnings("ignore:v for")
def test_a_disturbance_that_came_in_between_is_reported(loop):
    plant = control.sample_system(midr(MISMATCHED, 6), 1.0, "zoh")
    names = {"inputs": MISMATCHED.inputs, "outputs": MISMATCHED.outputs}
    plant = control.ss(*control.ssdata(plant), 1.0, **names)
    law = Law(zero_phase_butterworth(2, 0.1, 1.0), NormOptimal(loop.P, 1e-2, 2500))

    def run(*task, **more):
        return run_trials(loop, law, *task, plant=plant, **more)

    came, old = assumed_disturbance(trials=8, first=4), assumed_reference()
    done, new = run(old, came, 8), old[:, ::-1]
    with pytest.warns(UserWarning, match="another disturbance came") as seen:
        transfer(done, new)
    assert seen[0].filename == __file__
    since = done.isel(trial=slice(3, None))
    assert transfer(since, old).predicted.min() > 0.9
    after = transfer(since, new).v
    error, unlearned = (rms(run(new, came[-1], 1, v=v).e).item() for v in (after, None))
    assert error < 0.1 * unlearned
