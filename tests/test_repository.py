"""The repository itself: notebooks, figures, ledger and README belong together."""

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from itertools import chain

import nbformat
import pandas as pd
import pytest

import rodlib
from rodlib.paper import ledger, published
from rodlib.paper.repository import ROOT

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


@pytest.fixture(scope="module")
def rows():
    return pd.read_csv(
        ROOT / "figures" / "ledger.csv", dtype=str, keep_default_na=False
    )


def test_readme_and_ledger_page_show_the_tracked_ledger(rows):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert ledger.splice(readme, "ledger", ledger.summary(rows)) == readme
    assert (ROOT / "figures" / "ledger.md").read_text(
        encoding="utf-8"
    ) == ledger.markdown(rows)


def test_ledger_has_every_claim_judged_as_its_numbers_say(rows):
    assert list(rows.key) == list(published.claims())
    for row in rows.itertuples():
        if row.verdict == ledger.IN_WORDS:
            before, after = (
                published.claims()[row.key].criterion[len(ledger.WORDS) :].split("{}")
            )
            assert re.fullmatch(
                re.escape(before) + r"[-+.e\d]+" + re.escape(after), row.computed
            )
            assert row.deviation == ""
        elif row.verdict != ledger.UNCHECKED and row.computed != ledger.BELOW_NOISE:
            outcome, deviation = ledger.verdict(
                published.claims()[row.key], float(row.computed)
            )
            assert outcome == row.verdict, row.key
            assert row.deviation == (
                f"{deviation:.1e}" if abs(deviation) > 1e-9 else ""
            ), row.key


def test_what_can_be_reproduced_is_reproduced(rows):
    verdicts = rows.set_index("key").verdict
    certain = [
        "states_minimal",
        "zero_s_1",
        "zero_s_2",
        "zero_z_1",
        "zero_z_2",
        "sigma_P",
    ]
    certain += ["gamma_diagonal", "peak_L_diagonal", "gamma_printed", "peak_L_printed"]
    certain += ["length", "width", "height", "density", "heat_capacity", "conductivity"]
    certain += [key for key in verdicts.index if re.match(r"N\[|K_s|K_L", key)]
    assert len(certain) > 70
    assert set(verdicts[certain]) == {ledger.REPRODUCED}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_executed_in_order_and_readable(path):
    notebook = nbformat.read(path, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert [cell for cell in code if "parameters" in cell.metadata.get("tags", [])] == [
        code[1]
    ]
    for cell in code:
        assert len(cell.source.splitlines()) <= 25, cell.source
        for node in ast.walk(
            ast.parse(cell.source)
        ):  # a longer function belongs to the module
            assert (
                not isinstance(node, ast.FunctionDef)
                or node.end_lineno - node.lineno < 12
            )
        assert not [
            o
            for o in cell.outputs
            if o.output_type == "error" or o.get("name") == "stderr"
        ]
        assert not any(
            "widget" in kind for o in cell.outputs for kind in o.get("data", {})
        )
        # how many, depends on the rounding of the processor
        assert not any(
            re.search(r"\d+ iterations", o.get("text", "")) for o in cell.outputs
        )
    assert "widgets" not in notebook.metadata  # which breaks the rendering elsewhere
    prose = " ".join(c.source for c in notebook.cells if c.cell_type == "markdown")
    words = re.findall(r"[A-Za-z]{2,}", re.sub(r"\$\$[^$]*\$\$|\$[^$]*\$", "", prose))
    assert 300 <= len(words) <= 1500


def is_folded(source):
    """Whether code is that of a picture, or states nothing but rows of the ledger."""
    named = [
        {getattr(n, "id", "") for n in ast.walk(s)} for s in ast.parse(source).body
    ]
    of_ledger = "ledger.save()" in source or all("ledger" in names for names in named)
    return of_ledger or bool(re.search(r"\bsave\(figure, \"", source))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_imports_pictures_and_the_ledger_are_folded_and_nothing_else(path):
    """So that one reads question, equation, the few lines that are it, picture, answer."""
    notebook = nbformat.read(path, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    for cell in code:
        hidden = cell.metadata.get("jupyter", {}).get("source_hidden", False)
        assert hidden == (cell is code[0] or is_folded(cell.source)), cell.source
    assert len(notebook.cells) <= 30


@pytest.mark.parametrize(
    ("source", "folded"),
    [
        ('ledger.record("a", 1)\nfor key in "bc":\n    ledger.record(key, 2)', True),
        ("size = rms(e)\nledger.record('a', size)", False),
        ("size = rms(e)\nledger.save()\nledger.table()", True),
        ('figure = plt.figure()\nsave(figure, "fig01-x", caption)', True),
        ("save_log(run, path)\nledger", False),
    ],
)
def test_what_is_folded(source, folded):
    assert is_folded(source) == folded


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_every_picture_has_a_caption_that_stands_for_it(path):
    captions = []
    for cell in nbformat.read(path, as_version=4).cells:
        outputs = cell.get("outputs", [])
        for k, picture in enumerate(outputs):
            if "image/png" in picture.get("data", {}):
                captions.append(picture.metadata["image/png"]["alt"])
                assert outputs[k + 1].data["text/markdown"] == f"*{captions[-1]}*"
    assert len({*captions}) == len(captions) > 0
    for caption in captions:
        assert 40 <= len(caption) <= 400 and caption.endswith("."), caption
        assert not re.search(r"[$*_`]", caption.replace("σ_max", "")), caption


def test_every_saved_figure_is_tracked_and_used():
    saved = set()
    for path in NOTEBOOKS:
        source = "\n".join(c["source"] for c in nbformat.read(path, as_version=4).cells)
        saved |= set(re.findall(r"\bsave\(\w+, \"([^\"]+)\", caption\)", source))
    tracked = {
        path.stem
        for path in (ROOT / "figures").iterdir()
        if path.suffix in (".png", ".pdf")
    }
    # `make bench` draws the one; the other is what tests/browser saw
    assert tracked == saved | {"performance", "workbench"}
    pictures = {path.stem for path in (ROOT / "figures").glob("*.png")} - {"workbench"}
    assert pictures == {path.stem for path in (ROOT / "figures").glob("*.pdf")}


def test_readme_links_lead_somewhere():
    for name in ("README.md", "CONTRIBUTING.md", "figures/performance.md"):
        path = ROOT / name
        for target in re.findall(
            r"\]\((?!https?:|#)([^)#]+)", path.read_text(encoding="utf-8")
        ):
            assert (path.parent / target).exists(), f"{name}: {target}"


def test_the_version_is_the_same_wherever_it_stands():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert rodlib.__version__ == project["version"]
    assert f"\nversion: {rodlib.__version__}\n" in citation


def test_lock_pins_and_hashes_every_direct_dependency():
    lock = (ROOT / "environment.lock").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]
    wanted = [
        *project["dependencies"],
        *chain(*project["optional-dependencies"].values()),
    ]
    for requirement in wanted:
        name = re.split(r"[\[<>=]", requirement)[0].replace("_", "-").lower()
        if name not in (
            "rodlib",
            "slycot",
        ):  # which only one test needs, if it is there
            assert re.search(rf"^{name}==\S+( ;.*)? \\$", lock, flags=re.MULTILINE), (
                name
            )
    assert "://" not in lock
    entries = re.split(r"\n(?=\S)", lock)
    assert all(
        "--hash=sha256:" in entry for entry in entries if "==" in entry.split("\n")[0]
    )


def test_no_notebook_reads_what_another_wrote():
    for path in NOTEBOOKS:
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            assert not re.search(
                r"build/|figures/[a-z0-9]+\.|read_csv", "".join(cell["source"])
            ) or (cell["cell_type"] == "markdown")


FROM_A_WHEEL = """
import runpy, sys
import matplotlib.pyplot as plt
from rodlib.paper import figures, published
from rodlib.paper.ledger import Ledger

print(published.__file__)
book = Ledger("test", M_max=0.9)
for name in published.MATRICES:
    book.record(name, published.matrix(name))
print(len(published.claims()), {*book.table().verdict})

def start(*arguments):
    sys.argv = ["", *arguments]
    runpy.run_module("rodlib.paper.reproduce", run_name="__main__")

for write in (
    book.save,
    lambda: figures.save(plt.figure(), "fig02-rod", ""),
    start,
    lambda: start(published.__file__),  # as a log
    lambda: runpy.run_module("rodlib.paper.rig_logs", run_name="__main__"),
    lambda: runpy.run_path(sys.orig_argv[-1], run_name="__main__"),
):
    try:
        write()
    except (RuntimeError, SystemExit) as error:
        print(error)
"""


def test_a_wheel_has_the_printed_numbers_and_writes_nowhere(tmp_path):
    """What an installation makes of the repository, used from an empty folder."""
    pytest.importorskip("hatchling")
    pytest.importorskip("uv")
    packages, empty = tmp_path / "packages", tmp_path / "empty"
    install = [
        sys.executable,
        "-m",
        "uv",
        "pip",
        "install",
        "--quiet",
        "--offline",
        "--no-deps",
    ]
    install += [
        "--python",
        sys.executable,
        "--no-build-isolation",
        "--target",
        packages,
        ROOT,
    ]
    subprocess.run(install, check=True)
    bystander = packages / "build" / "another-package.py"
    bystander.parent.mkdir()
    bystander.touch()
    empty.mkdir()
    before = sorted(packages.rglob("*"))
    used = subprocess.run(
        [
            sys.executable,
            "-c",
            FROM_A_WHEEL,
            ROOT / "tests" / "benchmarks" / "report.py",
        ],
        cwd=empty,
        env=os.environ | {"PYTHONPATH": str(packages), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
    )
    assert used.returncode == 0, used.stderr
    module, numbers, *refusals = used.stdout.splitlines()
    assert module == str(packages / "rodlib" / "paper" / "published.py")
    assert numbers == f"{len(published.claims())} {{'{ledger.REPRODUCED}'}}"
    refusal = (
        f" writes to a clone of the repository of rodlib, and {packages} is none: "
    )
    assert [line.partition(refusal)[0] for line in refusals] == [
        "Ledger.save",
        "figures.save",
        "make reproduce",
        "make replay",
        "python -m rodlib.paper.rig_logs",
        "tests/benchmarks/report.py",
    ]
    assert all(refusal in line for line in refusals)
    assert sorted(packages.rglob("*")) == before and not list(empty.iterdir())


def test_make_does_not_obey_the_settings_of_python_and_jupyter_around_it():
    if not shutil.which("make"):
        pytest.skip("there is no make")
    names = [
        "PYTHONPATH",
        "PYTHONHOME",
        "PYTHONSTARTUP",
        "PYTHONOPTIMIZE",
        "JUPYTER_PATH",
    ]
    names += [
        "JUPYTER_CONFIG_DIR",
        "JUPYTER_CONFIG_PATH",
        "VIRTUAL_ENV",
        "CONDA_PREFIX",
    ]
    names += ["PYTEST_ADDOPTS", "PIP_TARGET", "RODLIB_RESULTS"]
    around = {
        name: "astray"
        for name in [*names, "IPYTHONDIR", "MATPLOTLIBRC", "PYTHONUTF8", "LC_ALL"]
    }
    outcome = subprocess.run(
        ["make", "--no-print-directory", "--eval=show: ; @env", "show"],
        cwd=ROOT,
        env=os.environ | around | {"OMP_NUM_THREADS": "7", "HARMLESS": "kept"},
        capture_output=True,
        text=True,
        check=True,
    )
    inside = dict(
        line.split("=", 1) for line in outcome.stdout.splitlines() if "=" in line
    )
    assert not {*names} & {*inside}
    assert "astray" not in inside.values()
    assert (inside["PYTHONUTF8"], inside["OMP_NUM_THREADS"], inside["HARMLESS"]) == (
        "1",
        "1",
        "kept",
    )


def test_make_lab_runs_as_root_if_one_says_so():
    """Jupyter refuses root; `make help` says how to insist."""
    if not shutil.which("make"):
        pytest.skip("there is no make")
    call = ["make", "-n", "--no-print-directory", "lab", "LAB=--allow-root"]
    said = subprocess.run(
        call, cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert re.search(r"jupyter lab --allow-root ", said)
    assert "LAB=--allow-root" in (ROOT / "Makefile").read_text(encoding="utf-8")


def test_the_toolbox_knows_nothing_of_the_paper():
    """Not by a name in an import, and not by an import of an import, in a process of its own."""
    imported = re.compile(r"^\s*(?:from|import) (rodlib[.\w]*)", re.MULTILINE)
    for path in (ROOT / "rodlib" / "ilc").rglob("*.py"):
        for module in imported.findall(path.read_text(encoding="utf-8")):
            assert module.startswith("rodlib.ilc"), f"{path}: {module}"
    code = """
import importlib, pkgutil, sys
from rodlib import ilc
names = [module.name for module in pkgutil.walk_packages(ilc.__path__, "rodlib.ilc.")]
for name in names:
    importlib.import_module(name)
print(len(names), {n for n in sys.modules if n.startswith("rodlib.")} - {"rodlib.ilc", *names})
"""
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert re.fullmatch(r"\d{2} set\(\)\n", run.stdout), run.stdout
