import machines
import pytest
from machines import ROOT


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="a copy without git")
def test_the_copy_is_that_of_the_working_tree(tmp_path):
    machines.copy_checkout(tmp_path)
    for name in (
        "pyproject.toml",
        "rodlib/paper/ledger.py",
        "notebooks/01-model.ipynb",
    ):
        assert (tmp_path / name).read_bytes() == (ROOT / name).read_bytes()
    assert not (tmp_path / "build").exists() and not (tmp_path / ".venv").exists()


def test_what_this_processor_cannot_run_is_left_out_by_name(
    monkeypatch, capsys, tmp_path
):
    said = {
        "Haswell": ("Haswell", ""),
        "Zen": ("Haswell", ""),
        "SkylakeX": ("SkylakeX", "this processor cannot run it"),
        "Nehalem": ("Nehalem", ""),
    }
    monkeypatch.setattr(machines, "LOGS", tmp_path / "logs")
    monkeypatch.setattr(machines, "probe", said.__getitem__)
    monkeypatch.setattr(
        machines, "try_machine", lambda name: ["README.md"] if name == "Nehalem" else []
    )
    assert machines.main(list(said)) == 1
    assert capsys.readouterr().out.splitlines() == [
        "Haswell          passed",
        "Zen              left out: the same code as Haswell",
        "SkylakeX         left out: this processor cannot run it",
        "Nehalem          README.md",
    ]


def test_a_machine_that_is_not_known_is_refused_with_those_that_are():
    with pytest.raises(
        SystemExit, match=r"^Haswel, rounding-x: not known; .*rounding-1 and other"
    ):
        machines.main(["Haswel", "rounding-2", "rounding-x"])


def test_a_processor_that_nobody_has_heard_of_is_left_out():
    assert machines.probe("Abacus")[1]
