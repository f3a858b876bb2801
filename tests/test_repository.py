"""The repository itself: notebooks, figures, ledger and README belong together."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from itertools import chain

import pytest
from books import BOOKS, ROWS, SAVED, cells, code, text

import rodlib
from rodlib.paper import ROOT, ledger, published
from rodlib.paper.comparison import different_figures


def test_readme_and_page_show_the_tracked_ledger():
    readme = text("README.md")
    assert ledger.splice(readme, "ledger", ledger.summary(ROWS)) == readme
    assert text("figures/ledger.md") == ledger.markdown(ROWS)


def test_each_row_and_each_figure_leads_to_the_cell_that_made_it():
    sources = {(name, cell.id): cell.source for name in BOOKS for cell in cells(name)}
    for key, row in ROWS.set_index("key").iterrows():
        assert re.search(r"\.record\(", sources[row.notebook, row.cell]), key
        direct = re.compile(rf'\.record\(\s*"{re.escape(key)}"')
        at = [place for place, source in sources.items() if direct.search(source)]
        assert at in ([], [(row.notebook, row.cell)])
    page = text("figures/ledger.md")
    links = re.findall(r"\(\.\./notebooks/([^)]+)\.ipynb#cell-id=([^)]+)\)", page)
    assert len(links) == len(ROWS) and {*links} <= {*sources}
    saved = {
        (name, *place) for place, source in sources.items() for name in re.findall(SAVED, source)
    }
    listed = r"- file: figures/(.+)\.png\n    comment: \".*; notebooks/(.+)\.ipynb, cell (.+)\""
    assert {*re.findall(listed, text("codecheck.yml"))} == saved and len(saved) > 40


@pytest.mark.parametrize("name", BOOKS)
def test_notebooks_are_executed_in_order(name):
    every = cells(name)
    assert [cell.execution_count for cell in every] == list(range(1, len(every) + 1))
    assert "parameters" in every[1].metadata.tags
    for output in chain(*(cell.outputs for cell in every)):
        assert output.output_type != "error" and output.get("name") != "stderr"
        # how many, depends on the rounding of the processor
        assert not re.search(r"\d+ iterations", output.get("text", ""))
    # which breaks the rendering elsewhere
    assert "widgets" not in BOOKS[name].metadata


@pytest.mark.parametrize("name", BOOKS)
def test_every_picture_has_a_caption_that_stands_for_it(name):
    outputs = [output for cell in cells(name) for output in cell.outputs]
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    captions = {picture.metadata["image/png"]["alt"] for picture in pictures}
    assert len(captions) == len(pictures) > 0
    for caption in captions:
        assert 40 <= len(caption) <= 400 and caption.endswith("."), caption
        assert not re.search(r"[$*_`]", caption.replace("σ_max", "")), caption


def test_every_saved_figure_is_tracked_and_used():
    saved = set()
    for name in BOOKS:
        source = "\n".join(code(name))
        saved |= set(re.findall(SAVED, source))
        # nor does one read what another wrote
        assert not re.search(r"build/|figures/[a-z0-9]+\.|read_csv", source), name
    figures = ROOT / "figures"
    assert {path.stem for path in figures.glob("*.png")} == saved | {"workbench"}
    assert {*different_figures(figures, figures)} == {"workbench"}  # a picture of tests/browser
    assert {path.stem for path in figures.glob("*.pdf")} == saved


def test_links_lead_somewhere():
    docs = sorted(f"docs/{path.name}" for path in ROOT.glob("docs/*.md"))
    for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "figures/performance.md", *docs):
        for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", text(name)):
            assert ((ROOT / name).parent / target).exists(), f"{name}: {target}"


def test_version_and_lock_agree_with_the_project():
    project = tomllib.loads(text("pyproject.toml"))["project"]
    assert rodlib.__version__ == project["version"]
    assert f"\nversion: {rodlib.__version__}\n" in text("CITATION.cff")
    lock = text("environment.lock")
    assert "://" not in lock
    extras = project["optional-dependencies"]
    for requirement in chain(project["dependencies"], *extras.values()):
        name = re.split(r"[\[<>=]", requirement)[0].replace("_", "-").lower()
        assert name == "rodlib" or f"\n{name}==" in lock, name


FROM_A_WHEEL = """
import runpy
import matplotlib.pyplot as plt
from rodlib.paper import figures, published
from rodlib.paper.ledger import Ledger

print(published.__file__)
book = Ledger("test", M_max=0.9)
for name in published.PRINTED_MATRICES:
    book.record(name, published.matrix(name))
print(len(published.claims()), {*book.table().verdict})

for write in (
    book.save,
    lambda: figures.save(plt.figure(), "fig02-rod", ""),
    lambda: runpy.run_module("rodlib.paper.reproduce", run_name="__main__"),
    lambda: runpy.run_module("rodlib.paper.rig_logs", run_name="__main__"),
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
    empty.mkdir()
    install = [sys.executable, "-m", "uv", "pip", "install", "--quiet", "--offline"]
    install += ["--python", sys.executable, "--no-deps", "--no-build-isolation"]
    subprocess.run([*install, "--target", packages, ROOT], check=True)
    before = sorted(packages.rglob("*"))
    installed = {"PYTHONPATH": str(packages), "PYTHONDONTWRITEBYTECODE": "1"}
    run = subprocess.run(
        [sys.executable, "-c", FROM_A_WHEEL],
        cwd=empty,
        env=os.environ | installed,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    module, numbers, *refusals = run.stdout.splitlines()
    assert module == str(packages / "rodlib" / "paper" / "published.py")
    assert numbers == f"{len(published.claims())} {{'{ledger.REPRODUCED}'}}"
    assert len(refusals) == 4
    refusal = f"writes to a clone of the repository of rodlib, but {packages} is not"
    assert all(refusal in line for line in refusals)
    assert sorted(packages.rglob("*")) == before and not list(empty.iterdir())


@pytest.mark.skipif(not shutil.which("make"), reason="there is no make")
def test_make_does_not_obey_the_settings_of_python_and_jupyter_around_it():
    names = ["PYTHONPATH", "JUPYTER_CONFIG_DIR", "PIP_TARGET", "RODLIB_RESULTS"]
    replaced = ["IPYTHONDIR", "MATPLOTLIBRC", "OMP_NUM_THREADS"]
    astray = dict.fromkeys([*names, *replaced], "astray")
    run = subprocess.run(
        ["make", "--no-print-directory", "--eval=show: ; @env", "show"],
        cwd=ROOT,
        env=os.environ | astray | {"HARMLESS": "stays"},
        capture_output=True,
        text=True,
        check=True,
    )
    inside = dict(line.split("=", 1) for line in run.stdout.splitlines() if "=" in line)
    assert not {*names} & {*inside}
    assert "astray" not in inside.values() and inside["HARMLESS"] == "stays"


def test_the_toolbox_knows_nothing_of_the_rod():
    """Neither then does what its modules import; formats of files keep their names."""
    for path in (ROOT / "toolbox").rglob("*.py"):
        formats = r"rodlib (?:trial log [234]|law [1234])\b"
        assert "rodlib" not in re.sub(formats, "", text(path)), path


def test_rooms_of_the_toolbox_import_from_those_above_them():
    """In the order of the table of CONTRIBUTING, which names them all."""
    package = ROOT / "toolbox" / "ilctools"
    table = re.findall(r"^\| ([a-z_/, ]+) \| ", text("CONTRIBUTING.md"), re.MULTILINE)
    rooms = [name.strip(" /") for row in table[1:] for name in row.split(",")]
    within = {path.stem for path in package.iterdir() if not path.stem.startswith("_")}
    assert {*rooms} == within - {"py"}
    for path in package.rglob("*.py"):
        own = path.relative_to(package).parts[0].removesuffix(".py")
        for name in re.findall(r"^ *from ilctools\.(\w+)", text(path), re.MULTILINE):
            above = own == "__init__" or rooms.index(name) <= rooms.index(own)
            assert above, f"{path} imports {name}"
