"""docs/law.c makes the next trial's signal of a saved law as `Law.next` does."""

import platform
import shutil
import subprocess

import control
import numpy as np
import pytest

from ilctools import Law, LearningFilter, save_law, zero_phase_butterworth
from ilctools.base import RegularisedInverse
from rodlib.paper import ROOT, published

SOURCE = ROOT / "docs" / "law.c"
FULL, DIAGONAL = (
    LearningFilter(published.matrix(f"L_{kind}"), 1.0) for kind in ("full", "diagonal")
)
RNG = np.random.default_rng(0)
EXACT = LearningFilter(RNG.integers(-64, 64, (2, 2, 5)) / 16, 1.0)
ONE = LearningFilter([[[0.5, 0.25]]], 0.1)
OF_MODEL = RegularisedInverse(control.ss(0.5, 0.5, 1, 0, 1.0), 0.1, [1.0])
LAWS = {
    "the paper's": Law(zero_phase_butterworth(2, 0.1, 1.0), FULL, rest=15),
    "diagonal": Law(zero_phase_butterworth(3, 0.1, 1.0), DIAGONAL),
    "one channel, slower": Law(zero_phase_butterworth(1, 5.0, 0.1), ONE, gain=0.3),
    "back and ahead": Law(
        zero_phase_butterworth(2, 0.5, 1.0),
        LearningFilter(RNG.integers(-64, 64, (2, 2, 7)) / 64, 1.0, first=-3),
    ),
    "with a base": Law(
        zero_phase_butterworth(2, 0.5, 1.0),
        LearningFilter(
            [[[0.5, 1.0, 0.25]]],
            1.0,
            first=-1,
            base=LearningFilter(RNG.standard_normal((1, 1, 301)), 1.0, first=-150),
        ),
    ),
    "order five": Law(zero_phase_butterworth(5, 0.5, 1.0), EXACT, rest=1),
}


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    compiler = next(filter(shutil.which, ("cc", "gcc", "clang")), None)
    if compiler is None:
        pytest.skip("there is no C compiler")
    program = tmp_path_factory.mktemp("c") / "law"
    call = [compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2"]
    call += ["-ffp-contract=off", SOURCE, "-lm", "-o", program]
    subprocess.run(call, check=True)
    return program


def by_c(program, path, v, e):
    trial = "\n".join(" ".join(map(repr, row)) for row in np.hstack([v, e]).tolist())
    call = [program, path]
    run = subprocess.run(call, input=trial, capture_output=True, text=True, check=True)
    return np.array([row.split() for row in run.stdout.splitlines()], dtype=float)


@pytest.mark.parametrize("name", LAWS)
def test_it_is_the_next_signal_of_python(program, name, tmp_path):
    law = LAWS[name]
    save_law(tmp_path / "law.json", law)
    v, e = RNG.standard_normal((2, 400, law.channels))
    expected = law.next(v, e)
    actual = by_c(program, tmp_path / "law.json", v, e)
    assert actual.shape == expected.shape
    size = np.abs(expected).max()
    assert np.abs(actual - expected).max() < 1e-13 * size


def test_it_is_that_bit_for_bit_where_sums_are_exact(program, tmp_path):
    """Python leaves the order of the sum in L to BLAS; of a few binary digits it is no matter."""
    law = Law(zero_phase_butterworth(2, 0.1, 1.0), EXACT, rest=10)
    save_law(tmp_path / "law.json", law)
    v, e = RNG.integers(-1000, 1000, (2, 400, 2)) / 64
    expected, actual = law.next(v, e), by_c(program, tmp_path / "law.json", v, e)
    if platform.machine() in ("x86_64", "AMD64"):  # elsewhere scipy may fuse its products
        np.testing.assert_array_equal(actual, expected)
    assert np.abs(actual - expected).max() < 1e-13 * np.abs(expected).max()


@pytest.mark.parametrize(
    "law",
    [Law(zero_phase_butterworth(2, 0.1, 1.0, ends="hold"), EXACT),
     Law(zero_phase_butterworth(2, 0.1, 1.0), EXACT, limits={"Q1": (-1, 1)}),
     Law(zero_phase_butterworth(2, 0.1, 1.0), LearningFilter([[[1.0]]], 1.0, base=OF_MODEL))],
)  # fmt: skip
def test_what_it_does_not_know_it_refuses(program, law, tmp_path):
    save_law(tmp_path / "law.json", law)
    call = [program, tmp_path / "law.json"]
    run = subprocess.run(call, input="1 2 3 4\n", capture_output=True, text=True)
    assert run.returncode and not run.stdout and "law:" in run.stderr


def test_a_format_that_it_does_not_know_it_refuses(program, tmp_path):
    path = tmp_path / "law.json"
    save_law(path, LAWS["with a base"])
    path.write_text(path.read_text().replace("law 2", "law 3"))
    run = subprocess.run([program, path], input="1 2\n", capture_output=True, text=True)
    assert run.returncode and "format" in run.stderr


@pytest.mark.parametrize(
    ("trial", "samples", "message"),
    [
        ("1 2\n3 4\n5", (), "line 3 is no 2 numbers"),
        ("1 2\n3 4x\n5 6\n", (), "line 3 is no 2 numbers"),
        ("1 2\nnan 4\n", (), "line 2 is no 2 numbers"),
        ("1 2\n3 4\n", ("3",), "the trial has 2 samples"),
        ("", (), "the trial has 0 samples"),
        ("1 2\n" * (1 << 17) + "1 2\n", (), "beyond what fits"),
    ],
)
def test_a_broken_trial_is_refused(program, tmp_path, trial, samples, message):
    """With an exit code, and without a v that a target might apply."""
    save_law(tmp_path / "law.json", LAWS["one channel, slower"])
    call = [program, tmp_path / "law.json", *samples]
    run = subprocess.run(call, input=trial, capture_output=True, text=True)
    assert run.returncode == 1 and message in run.stderr and not run.stdout
    whole = subprocess.run([*call[:2], "2"], input="1 2\n3 4\n", capture_output=True, text=True)
    assert whole.returncode == 0 and len(whole.stdout.splitlines()) == 2
