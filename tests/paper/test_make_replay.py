"""`make replay` as a user calls it: a report on logs of other plants."""

import shutil
import subprocess

import control
import matplotlib
import nbformat
import numpy as np
import pytest
from plants import bump, stage
from replayed import trials_of

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    current_trial_loop,
    load_log,
    run_trials,
    save_log,
    zero_phase_butterworth,
)
from ilctools import replay as replay_of
from ilctools.errors import LogError
from ilctools.law.notes import with_law
from rodlib.paper import figures, reproduce
from rodlib.paper.repository import ROOT

ODD = 'my stage\'s "log" of $HOME, ~ & `x` #1.csv'


@pytest.fixture
def root(tmp_path):
    """A repository with nothing in it."""
    (tmp_path / "pyproject.toml").write_text('name = "rodlib"\n')
    return tmp_path


def next_trial(root):
    path = root / "build" / "replay" / "next-trial.csv"
    return np.loadtxt(path, delimiter=",", skiprows=1)


@pytest.fixture
def replay_here(root, monkeypatch, capsys):
    """`make replay` in this process, which runs the notebook's cells without a kernel."""
    monkeypatch.setenv("RODLIB_RESULTS", "")  # which a run sets for its kernels
    monkeypatch.setattr(figures, "PIXELS_PER_INCH", 40)
    monkeypatch.setattr(figures, "same_picture", lambda *_: True)  # or each is saved twice

    def run(notebook, executed, **parameters):
        monkeypatch.chdir(notebook.parent)
        namespace = {}
        for cell in nbformat.read(notebook, 4).cells:
            if cell.cell_type == "code":
                exec("".join(cell.source), namespace)
                if "parameters" in cell.metadata.get("tags", []):
                    namespace |= parameters

    def replay(log):
        monkeypatch.setattr(reproduce, "execute", run)
        reproduce.replay_log(str(root / log), root)
        said = capsys.readouterr()
        assert not said.err
        return said.out

    with matplotlib.rc_context():  # the notebook chooses a style
        yield replay


def test_a_stage_is_replayed_with_its_own_loop(root, replay_here):
    units = {"x": "mm", "F": "N", "friction": "N"}
    loop = current_trial_loop(stage(), ["F"], {"x": 1.0, "F": 10.0}, units)
    run = trials_of(loop, trials=4)
    save_log(run, root / ODD)
    text, found = replay_here(ODD), replay_of(load_log(root / ODD))
    assert text.startswith(f"{found}\nv of trial 5: build/replay/next-trial.csv\n")
    assert text.count(str(found)) == 2  # by the command, and by the notebook
    assert "\nlaw: the recorded v is that of the law in every trial\n" in text
    assert "mean of all trials: x 100 %" in text and "left out" not in text
    table = next_trial(root)
    np.testing.assert_array_equal(table[:, 1:], found.following)
    pictures = (root / "build" / "replay" / "figures").glob("*.png")
    names = ["convergence", "model-fit", "next-trial", "signals", "start-of-a-trial"]
    assert sorted(path.stem for path in pictures) == names


def test_a_bad_log_is_refused_in_a_few_words_and_an_earlier_replay_stays(root):
    log, earlier = root / "log.csv", root / "build" / "replay" / "next-trial.csv"
    log.write_text("a,b\n1,2\n")
    earlier.parent.mkdir(parents=True)
    earlier.touch()
    with pytest.raises(LogError, match="format is None") as refusal:
        reproduce.replay_log(str(log), root)  # `main` ends with its message
    assert len(str(refusal.value).splitlines()) <= 3
    assert earlier.exists()


@pytest.mark.parametrize("name", [ODD, "$(shell touch pwned)"])
def test_make_hands_over_the_path_as_it_is(name, tmp_path):
    if not shutil.which("make"):
        pytest.skip("there is no make")
    python = tmp_path / "python"
    python.write_text('#!/bin/sh\nfor word; do printf "<%s>" "$word"; done\n')
    python.chmod(0o755)
    call = ["make", "-sf", ROOT / "Makefile", f"BIN={tmp_path}", "PYTHON=true", "replay"]
    options = {"cwd": tmp_path, "capture_output": True, "text": True}
    outcome = subprocess.run([*call, f"LOG={name}"], **options)
    assert outcome.stdout == f"<-m><rodlib.paper.reproduce><{name}>"
    assert subprocess.run(call, **options).returncode == 2 and [*tmp_path.iterdir()] == [python]


def test_logs_of_loops_that_are_not_ours_that_never_rest_and_in_dollars_are_replayed(
    root, replay_here
):
    """Without commands; v of the next trial only as far as it follows; no unit is a formula."""
    P = control.ss(0.8, 0.2, 1, 0, 0.1, outputs=["price"])
    loop = ClosedLoop(P, units={"price": "$\\frac{$"})
    law = Law(zero_phase_butterworth(2, 3.0, 0.1), LearningFilter([[[0.5]]], 0.1))
    reference = bump(200, [1.0])
    run = with_law(run_trials(loop, law, reference, trials=4, reset=False), law.bound_to(loop))
    save_log(run, root / "log.csv")
    text = replay_here("log.csv")
    assert "law: the recorded v is that of the law in every trial" in text
    assert 0 < len(next_trial(root)) < 200
