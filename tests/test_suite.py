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
