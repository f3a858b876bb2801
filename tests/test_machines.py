import machines


def test_each_kernel_is_tried_once_and_what_cannot_run_is_named(monkeypatch, capsys, tmp_path):
    probes = {
        "Haswell": ("Haswell", ""),
        "Zen": ("Haswell", ""),
        "SkylakeX": ("SkylakeX", "this processor cannot run it"),
        "Nehalem": ("Nehalem", ""),
    }
    failures = {"Haswell": [], "Nehalem": ["README.md"]}
    monkeypatch.setattr(machines, "LOGS", tmp_path / "logs")
    monkeypatch.setattr(machines, "probe", probes.get)
    monkeypatch.setattr(machines, "try_machine", failures.get)
    assert machines.main(list(probes)) == 1
    assert capsys.readouterr().out.splitlines() == [
        "Haswell          passed",
        "Zen              left out: the same code as Haswell",
        "SkylakeX         left out: this processor cannot run it",
        "Nehalem          README.md",
    ]


def test_kernels_of_one_code_and_those_that_cannot_run_are_no_choice(monkeypatch):
    probes = {name: (name, "") for name in machines.KERNELS}
    probes |= {"Zen": ("Haswell", ""), "SkylakeX": ("SkylakeX", "this processor cannot run it")}
    monkeypatch.setattr(machines, "probe", probes.get)
    assert [*machines.runnable()] == ["Haswell", "Prescott", "Nehalem", "Sandybridge"]
