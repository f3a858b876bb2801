from pathlib import Path

import suite

REPORT = """<testsuites><testsuite><testcase classname="tests.test_a" name="test_good"/>
<testcase classname="tests.test_a" name="test_bad"><failure message="no"/></testcase>
<testcase classname="notebooks.18.ipynb" name="Cell 11"><error message="no"/></testcase>
<testcase classname="tests.test_a" name="test_left_out"><skipped/></testcase>
</testsuite></testsuites>"""


def test_all_parts_run_whatever_fails_and_the_end_names_what_failed(monkeypatch, tmp_path, capsys):
    """Parts that note that they ran; the second leaves a report as pytest does, and fails."""
    note = "import pathlib, sys; pathlib.Path(sys.argv[1]).write_text(sys.argv[3]); "
    note += "sys.exit(int(sys.argv[2]))"

    def part(name, code, text=""):
        return ["-c", note, tmp_path / "build" / "test" / name, str(code), text]

    chosen = {"lint": part("lint", 1), "tests": part("report.xml", 1, REPORT)}
    chosen |= {"figures and ledger": part("last", 0), "browser": part("browser.xml", 1, REPORT)}
    monkeypatch.setattr(suite, "ROOT", tmp_path)
    monkeypatch.setattr(suite, "parts", lambda build, machine: chosen)
    assert suite.main()
    assert (tmp_path / "build" / "test" / "last").exists()
    assert capsys.readouterr().out.splitlines() == [
        "failed:", "lint", "tests", "  tests.test_a: test_bad", "  notebooks.18.ipynb: Cell 11",
        "browser", "  tests.test_a: test_bad", "  notebooks.18.ipynb: Cell 11",
    ]  # fmt: skip
    chosen = {"lint": part("lint", 0)}
    assert not suite.main()
    assert capsys.readouterr().out == "all passed\n"


def test_another_machine_runs_all_notebooks_and_tests_but_no_browser(tmp_path):
    here, there = (suite.parts(tmp_path, machine) for machine in (False, True))
    assert here.keys() - there.keys() == {"lint", "format", "tokens", "browser"}
    browser = suite.ROOT / "tests" / "browser"
    assert here["browser"][-1] == browser and here["tests"] == there["tests"]
    paths = [path for path in there["tests"] if isinstance(path, Path)]
    notebooks = [path for path in paths if path.suffix == ".ipynb"]
    assert len(notebooks) == 1 + len([*suite.ROOT.glob("notebooks/*.ipynb")])
    tests = [p for room in ("tests", "toolbox") for p in suite.ROOT.glob(f"{room}/**/test_*.py")]
    assert all({path, *path.parents} & {browser, *paths} for path in tests)
