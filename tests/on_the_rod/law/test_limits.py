"""Where a platform lacks the solver of quadratic programs: limits say what to do."""

import subprocess
import sys

WITHOUT = """
import sys
sys.modules |= dict.fromkeys({missing})  # as if they were not installed
import numpy as np
import ilctools
import rodlib
from rodlib.workbench import try_out  # imports all that a design needs

loop, Q = rodlib.paper_loop(), ilctools.zero_phase_butterworth(2, 0.1, 1.0)
L = ilctools.LearningFilter(0.1 * np.eye(2)[:, :, None], 1.0)
ilctools.synthesise(loop, Q, np.geomspace(1e-3, 3, 60), order=10)
limits = {{"Q1": (-1, 1)}}
silent = ilctools.Law(Q, None, limits=limits)
ilctools.run_trials(loop, silent, np.ones((60, 2)), trials=1)
print("ended")
try:
    ilctools.run_trials(loop, ilctools.Law(Q, L, limits=limits), np.ones((60, 2)), trials=2)
except ImportError as error:
    print(error)
ilctools.save_log(ilctools.run_trials(loop, silent, np.ones((9, 2)), trials=1), "log.csv")
print(ilctools.load_log("log.csv").sizes["time"])
"""


def test_what_is_not_installed_is_not_needed_but_for_limits(tmp_path):
    """Nor is CVXPY, which is for comparison."""
    missing = ["piqp", "cvxpy", "clarabel", "pyarrow"]
    code = WITHOUT.format(missing=missing)
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    ended, refusal, samples = run.stdout.splitlines()
    assert (ended, samples) == ("ended", "9")
    assert "pip install piqp" in refusal and "limits={}" in refusal
