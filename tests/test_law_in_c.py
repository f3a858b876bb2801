"""docs/law.c and law.m make the next trial's signal of a saved law as `Law.next` does."""

import json
import platform
import re
import shutil
import subprocess
from pathlib import Path

import control
import numpy as np
import pytest

from ilctools import Law, LearningFilter, load_law, save_law, zero_phase_butterworth
from ilctools.base import RegularisedInverse
from rodlib.paper import ROOT, published

SOURCE = ROOT / "docs" / "law.c"
FULL = LearningFilter(published.matrix("L_full"), 1.0)
RNG, Q = np.random.default_rng(0), zero_phase_butterworth(2, 0.5, 1.0)
ONE = LearningFilter([[[0.5, 0.25]]], 0.1)


def random(rows, columns, order, first=1):
    """A filter with coefficients of a few binary digits."""
    return LearningFilter(RNG.integers(-64, 64, (rows, columns, order)) / 64, 1.0, first=first)


EXACT = random(2, 2, 5)
OF_MODEL = RegularisedInverse(control.ss(0.5, 0.5, 1, 0, 1.0), 0.1, [1.0])
LAWS = {
    "the paper's": Law(zero_phase_butterworth(2, 0.1, 1.0), FULL, rest=15),
    "one channel, slower": Law(zero_phase_butterworth(1, 5.0, 0.1), ONE, gain=0.3),
    "back and ahead": Law(Q, random(2, 2, 7, first=-3)),
    "of many samples": Law(
        Q, LearningFilter(RNG.standard_normal((1, 1, 303)), 1.0, first=-151), limits={}
    ),
    "order five": Law(zero_phase_butterworth(5, 0.5, 1.0), EXACT, rest=1),
    "two errors, three v": Law(Q, random(3, 2, 7, first=-3)),
    "three errors, one v": Law(Q, random(1, 3, 4)),
}


SANITIZERS = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
PIECE = re.compile(rb'"[^"]*"|[-+.\w]+|.', re.DOTALL)  # of JSON
PIECES = b"-1 0 3 1e400 1. NaN 0x10 99999999999999999999".split()


def compiled(source, folder, *options):
    compiler = next(filter(shutil.which, ("cc", "gcc", "clang")), None)
    if compiler is None:
        pytest.skip("there is no C compiler")
    call = [compiler, "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", "-ffp-contract=off"]
    subprocess.run([*call, *options, source, "-lm", "-o", folder / "law"], check=True)
    return folder / "law"


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    return compiled(SOURCE, tmp_path_factory.mktemp("c"), "-std=c99")


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory):
    if platform.system() == "Windows":
        pytest.skip("there is no fork")
    source = ROOT / "tests" / "law_files.c"
    return compiled(source, tmp_path_factory.mktemp("c"), "-std=gnu99", *SANITIZERS)


def outcomes(sanitized, contents, v, e, folder):
    """What law.c makes of each content of a file of a law: v, or None if it refuses it."""
    for k, content in enumerate(contents):
        (folder / str(k)).write_bytes(content)
    np.savetxt(folder / "trial", np.hstack([v, e]), "%.17g")
    call = [sanitized, folder, str(len(contents))]
    run = subprocess.run(call, capture_output=True, text=True, check=True)
    texts = run.stdout.split("=")[:-1]
    assert len(texts) == len(contents)
    return [np.loadtxt(text.split("\n"), ndmin=2) if text else None for text in texts]


def mutated(content, rng):
    """The file of a law with a string, a number or a mark changed, often one next to a key."""
    pieces = PIECE.findall(content)
    strings = [k for k, piece in enumerate(pieces) if b'"' in piece]
    at = rng.choice([rng.integers(len(pieces)), rng.choice(strings) + rng.integers(4)])
    old = pieces[at]
    others = *PIECES, b"", 2 * old, rng.choice(pieces), rng.bytes(1), old[:-1], old + b"7"
    pieces[at] = others[rng.integers(len(others))]
    return b"".join(pieces)


def by_octave(law, v, e, folder):
    """What law.m makes of the file of a law, or an error."""
    octave = shutil.which("octave-cli")
    if octave is None:
        pytest.skip("Octave is not installed")
    save_law(folder / "law.json", law)
    for name, signal in {"v": v, "e": e}.items():
        np.savetxt(folder / name, signal, "%.17g")
    made = "law('law.json', load('v'), load('e'))"
    call = [octave, "--path", SOURCE.parent, "--eval", f"printf('%.17g ', {made}.')"]
    run = subprocess.run(call, cwd=folder, capture_output=True, text=True)
    return run.stderr if run.returncode else np.reshape(run.stdout.split(), v.shape).astype(float)


@pytest.mark.parametrize("name", LAWS)
def test_octave_makes_the_same_v(name, tmp_path):
    law = LAWS[name]
    v, e = (RNG.standard_normal((200, count)) for count in (law.rows, law.columns))
    actual, expected = by_octave(law, v, e, tmp_path), law.next(v, e)
    assert np.abs(actual - expected).max() < 1e-12 * np.abs(expected).max()


def run_of(program, law, trial, folder, *samples):
    """What law.c does with a law, or the text of its file, and the text of a trial."""
    path = folder / "law.json"
    path.write_text(law) if isinstance(law, str) else save_law(path, law)
    return subprocess.run([program, path, *samples], input=trial, capture_output=True, text=True)


@pytest.mark.parametrize(
    ("trial", "message"),
    [
        ("1 2\n3 4\n5", "line 3 is no 2 numbers"),
        ("1 2\n3 4x\n5 6\n", "line 2 is no 2 numbers"),
        ("1 2\n1e999 4\n", "line 2 is no 2 numbers"),
        ("1 2\n3 4\n5 6\n", "the trial has 3 samples"),
        ("1 2\n3 4", "line 2 is no 2 numbers, torn"),
        ("1 2\n" * (1 << 17) + "1 2\n", "beyond what fits"),
    ],
)
def test_a_broken_trial_is_refused(program, tmp_path, trial, message):
    """With an exit code, and without a v that a target might apply."""
    run = run_of(program, LAWS["one channel, slower"], trial, tmp_path, "2")
    assert run.returncode == 1 and message in run.stderr and not run.stdout


LARGEST = np.finfo(float).max


@pytest.mark.parametrize(
    ("name", "v", "e"),
    [  # in the sums of L, in v + L e, in Q, which overshoots
        ("the paper's", 0.0, 1e307),
        ("one channel, slower", 0.9 * LARGEST, 0.9 * LARGEST),
        ("order five", 0.999 * LARGEST, 0.0),
    ],
)
def test_a_v_that_overflows_is_refused(program, tmp_path, name, v, e):
    """It goes to actuators: an exit code, one sentence, and nothing that looks like a signal."""
    law = LAWS[name]
    moving = np.repeat([0.0, 1.0], 100)[:, None] * np.ones(law.rows)
    v, e = v * moving, e * moving
    with pytest.raises(ValueError, match="v or e is too large"):
        law.next(v, e)
    lines = (" ".join(map(repr, row)) for row in np.hstack([v, e]).tolist())
    run = run_of(program, law, "\n".join(lines) + "\n", tmp_path)
    assert run.returncode == 1 and not run.stdout
    assert re.fullmatch(r"law: the next v is not finite in line \d+: .*\n", run.stderr)
    assert law.next(1e-9 * v, 1e-9 * e).any()  # what is large and does not overflow is learned
    assert "law: the next v is not finite" in by_octave(law, v, e, tmp_path)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full device")
def test_a_v_that_could_not_be_written_is_no_success(program, tmp_path):
    save_law(tmp_path / "law.json", LAWS["one channel, slower"])
    call = ["sh", "-c", '"$0" "$1" > /dev/full', program, tmp_path / "law.json"]
    run = subprocess.run(call, input="1 2\n" * 9, stderr=subprocess.PIPE, text=True)
    assert run.returncode == 1 and run.stderr == "law: the next v was not written as a whole\n"


@pytest.mark.parametrize("name", LAWS)
def test_a_damaged_law_is_refused_or_that_of_python(sanitized, name, tmp_path):
    """Mutated 40 times, and cut; the shortest at every letter."""
    law, rng = LAWS[name], np.random.default_rng(7)
    save_law(tmp_path / "law.json", law, note='first: "rest",\n"step": ε')
    whole = (tmp_path / "law.json").read_bytes()
    contents = [whole, *(mutated(whole, rng) for _ in range(40))]
    contents += [whole[:k] for k in range(1, len(whole), 1 + len(whole) // 600 * len(whole) // 99)]
    v, e = (rng.standard_normal((40, count)) for count in (law.rows, law.columns))
    for k, actual in enumerate(outcomes(sanitized, contents, v, e, tmp_path)):
        if actual is not None or k == 0:
            expected = load_law(tmp_path / str(k)).next(v, e)
            atol = 1e-12 * np.abs(expected).max()
            np.testing.assert_allclose(actual, expected, rtol=0, atol=atol)


BEYOND = {  # what law.c and law.m leave to Python
    "ends": Law(zero_phase_butterworth(2, 0.1, 1.0, ends="hold"), EXACT),
    "limits": Law(Q, EXACT, limits={"Q1": (-1, 1)}),
    "model": Law(Q, OF_MODEL @ LearningFilter([[[1.0]]], 1.0)),
}
SECTIONS = '{"sections": [[1, %s, 0, 1, %s, 0]]}'
UNREAD = [  # what Python does not read, or does without
    SECTIONS % (1, 1.5), SECTIONS % (0, 0), SECTIONS % ("NaN", 0), SECTIONS % ("1e999", 0),
    '{"Ts": 0.5}', '{"L": null}', '{"Q": {"order": 1, "cutoff": 5.000001, "ends": "zero"}}',
    '{"L": {"coefficients": [[[1]]], "ends": "zero", "first": 1}}', '{"format": "rodlib law 3"}',
    '{"format": "rodlib law 4"}',
]  # fmt: skip
REFUSED = [
    '{"format": "rodlib law 5"}', '{"stepp": 0.5}', '{"actuator": {}}', '{"step": 1.5}',
    '{"step": NaN}', '{"step": 1e999}', '{"rest": 1.0}', '{"rest": -1}', '{"Ts": -1}',
    '{"Q": {"order": 2}}', '{"Q": {"order": 1, "cutoff": 5.0, "ends": "zero", "poles": 2}}',
    '{"L": {"coefficients": [[[1]]], "ends": "zero", "taps": 1}}',
    '{"L": {"coefficients": [[[NaN]]], "ends": "zero", "first": 1}}',
]  # fmt: skip


def test_what_contradicts_itself_or_is_not_known_is_refused(sanitized, tmp_path):
    """By C; by Python, too, what it reads; by Octave what it does not know."""
    path, v = tmp_path / "law.json", np.zeros((20, 1))
    save_law(path, LAWS["one channel, slower"])
    whole = json.loads(path.read_text())
    contents = [json.dumps(whole | json.loads(change)) for change in (*REFUSED, *UNREAD)]
    contents = [text.replace("Infinity", "1e999").encode() for text in contents]
    found = outcomes(sanitized, contents, v, v, tmp_path)
    for k, change in enumerate((*REFUSED, *UNREAD)):
        assert found[k] is None, change
        if change in REFUSED:
            with pytest.raises(ValueError, match=f"{k}' is not a law saved by save_law"):
                load_law(tmp_path / str(k))


@pytest.mark.parametrize("kind", BEYOND)
def test_what_they_do_not_know_they_refuse(sanitized, kind, tmp_path):
    law = BEYOND[kind]
    save_law(tmp_path / "law.json", law)
    v, content = np.zeros((20, law.rows)), (tmp_path / "law.json").read_bytes()
    assert outcomes(sanitized, [content], v, v, tmp_path) == [None]
    assert by_octave(law, v, v, tmp_path).startswith("error: law: ")
