import ast
import os
import platform
import subprocess
import sys

import machines
import numpy as np
import pytest

SHOW = """import numpy as np
print(np.linalg.inv(np.random.default_rng(0).normal(size=(20, 20))).tolist())"""


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="no x86 processor")
def test_seeds_have_kernels_that_differ_in_the_last_digits():
    """An inverse, as processes of two seeds find it; its condition is 77."""
    found = []
    for seed in (1, 2):
        call = [sys.executable, "-c", SHOW]
        run = subprocess.run(
            call, env=os.environ | machines.environment(seed), capture_output=True, check=True
        )
        found.append(ast.literal_eval(run.stdout.decode()))
    np.testing.assert_allclose(*found, rtol=0, atol=1e-12 * np.abs(found).max())
    assert found[0] != found[1]


@pytest.mark.parametrize("seed", ["x", "-1", "1.5", "1 2"])
def test_a_seed_that_is_none_is_said_in_a_sentence(seed):
    with pytest.raises(SystemExit, match=f"SEED={seed} must be a whole number.*$"):
        machines.seed_of(seed.split())
