"""The log that the README of data shows."""

from ilctools import load_log
from rodlib.paper import ROOT


def test_the_example_in_the_readme_of_data_is_a_log(tmp_path):
    text = (ROOT / "data" / "README.md").read_text(encoding="utf-8")
    path = tmp_path / "log.csv"
    path.write_text(text.split("```text\n")[1].split("```")[0], encoding="utf-8")
    assert load_log(path).y.values.ravel().tolist() == [98.2, 98.3]
