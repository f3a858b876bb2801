"""What journals ask for, as docs/review.md lists it: fields that can be checked are checked."""

import json
import re

import yaml
from books import text

from rodlib.paper import ROOT

CODECHECK = yaml.safe_load(text("codecheck.yml"))
REVIEW = text("docs/review.md")
_, HEAD, PAPER = text("article/paper.md").split("---\n", 2)
ORCID = r"\d{4}-\d{4}-\d{4}-\d{3}[\dX]"
SECTIONS = [
    "Summary",
    "Statement of need",
    "State of the field",
    "Software design",
    "Research impact statement",
    "AI usage disclosure",
]


def test_the_manifest_lists_files_that_are_there_once():
    files = [entry["file"] for entry in CODECHECK["manifest"]]
    assert len({*files}) == len(files) and all((ROOT / file).is_file() for file in files)
    assert all(entry["comment"] for entry in CODECHECK["manifest"])
    figures = {f"figures/{path.name}" for path in ROOT.glob("figures/*.png")}
    assert figures - {*files} <= {"figures/workbench.png"}  # which tests/browser makes
    assert (ROOT / "codecheck" / "README.md").is_file()


def test_what_is_missing_from_codecheck_is_listed_as_missing():
    """By version 2.0: an ORCID for each author, a reference, who checks, report, certificate."""
    assert CODECHECK["version"] == "https://codecheck.org.uk/spec/config/2.0/"
    paper, listed = CODECHECK["paper"], {}
    for author in paper["authors"]:
        assert author["name"] and (author["ORCID"] is None or re.fullmatch(ORCID, author["ORCID"]))
    listed["an ORCID for each author of the paper"] = all(a["ORCID"] for a in paper["authors"])
    listed["a reference of the paper"] = bool(paper["reference"])
    of_check = ("summary", "certificate", "report")
    by_name = all(person["name"] for person in CODECHECK["codechecker"])
    checked = by_name and all(map(CODECHECK.get, of_check))
    listed["codechecker, summary, certificate, report"] = checked
    for item, there in listed.items():
        (state,) = re.findall(rf"^\| {item} \| ([^|]+) \|", REVIEW, re.MULTILINE)
        assert (state == "met") == there, item


def test_the_paper_for_joss_has_its_sections_and_its_length():
    assert re.findall(r"^# (.+)$", PAPER, re.MULTILINE)[:6] == SECTIONS
    assert 750 <= len(re.findall(r"\b\w[\w'-]*", PAPER)) <= 1750
    head = yaml.safe_load(HEAD)
    assert {"title", "tags", "authors", "affiliations", "date", "bibliography"} <= {*head}
    bibliography = text(f"article/{head['bibliography']}")
    cited = {*re.findall(r"@(\w+)", PAPER)}
    assert cited and cited <= {*re.findall(r"^@\w+\{(\w+),", bibliography, re.MULTILINE)}


def test_archive_and_citation_say_the_same():
    archive = json.loads(text(".zenodo.json"))
    citation = yaml.safe_load(text("CITATION.cff"))
    for field in ("title", "version", "license", "keywords"):
        assert archive[field] == citation[field], field
    assert [c["name"] for c in archive["creators"]] == [a["name"] for a in citation["authors"]]


def test_the_page_for_reviewers_sends_nobody_to_a_file_that_is_not_there():
    for name in re.findall(r"`([\w./-]+\.(?:md|yml|json|toml|cff|lock|typ|pdf))`", REVIEW):
        assert (ROOT / name).exists(), name
