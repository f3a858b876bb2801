import ast
import os
import platform
import subprocess
import sys

import machines
import numpy as np
import pytest

from rodlib import paper_loop
from rodlib.paper.repository import ROOT

SHOW = "from rodlib import paper_loop; print(paper_loop().N.tolist())"


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="no x86 processor")
def test_seeds_have_kernels_that_differ_in_the_last_digits():
    """The paper's N, from a realisation and a Riccati equation, as processes of two seeds find it.

    numpy's kernels differ in transcendental functions, which N does not need. 1e-9 is 1e7 times the
    rounding of a number: more than the conditions of both steps make of it.
    """
    found = []
    for seed in (1, 2):
        changed = (
            os.environ | machines.environment(seed) | {"PYTHONPATH": os.pathsep.join(sys.path)}
        )
        call = [sys.executable, "-c", SHOW]
        run = subprocess.run(call, cwd=ROOT, env=changed, capture_output=True, check=True)
        found.append(ast.literal_eval(run.stdout.decode()))
    np.testing.assert_allclose(found, [paper_loop().N] * 2, rtol=1e-9)
    assert len(np.unique(found, axis=0)) > 1
