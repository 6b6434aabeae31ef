"""Metadata that others read: review, citation, hooks and workflows, in step with each other."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml
from repo_review.processor import process

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())
HOOKS = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))


def test_the_review_of_scientific_python_passes_but_for_what_contributing_names():
    results = process(ROOT).results
    assert len(results) > 50
    assert not [f"{each.name}: {each.description}" for each in results if each.result is False]
    named = re.findall(r"^\| `([A-Z]+\d+)` ", (ROOT / "CONTRIBUTING.md").read_text(), re.M)
    assert sorted(named) == sorted(PYPROJECT["tool"]["repo-review"]["ignore"])


def test_the_citation_is_of_this_version_and_of_the_paper():
    project = PYPROJECT["project"]
    assert (CITATION["version"], CITATION["license"]) == (project["version"], project["license"])
    [paper] = CITATION["references"]
    assert paper["title"] == "Deep Feature-specific Imaging"
    assert project["urls"]["Paper"] == f"https://doi.org/{paper['doi']}"
    assert paper["doi"] in (ROOT / "paper.bib").read_text()


def test_hooks_run_the_pinned_ruff():
    [pinned] = re.findall(r"^ruff==(.+)$", (ROOT / "constraints.txt").read_text(), re.M)
    [hook] = [each for each in HOOKS if "ruff" in each["repo"]]
    assert hook["rev"] == f"v{pinned}"


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_call_our_own_scripts_and_pinned_actions(path):
    workflow = yaml.safe_load(path.read_text())
    steps = [step for job in workflow["jobs"].values() for step in job["steps"]]
    assert {step["run"] for step in steps if "run" in step} <= {
        "bash .ci/run",
        "python .ci/camera.py",
        "make docs",
    }
    used = re.findall(r"uses: (.+)", path.read_text())
    assert used
    assert not [each for each in used if not re.fullmatch(r"[\w/-]+@[0-9a-f]{40} # v[\d.]+", each)]
    assert workflow["permissions"] == {}
    assert workflow["concurrency"]["cancel-in-progress"]


def test_the_paper_cites_what_its_bibliography_has_within_the_words_of_its_journal():
    text, entries = ((ROOT / name).read_text() for name in ("paper.md", "paper.bib"))
    body = text.partition("# Summary")[2]
    assert set(re.findall(r"@(\w+)", body)) == set(re.findall(r"^@\w+\{(\w+),", entries, re.M))
    assert len(re.findall(r"[^\s|]+", body)) <= 1000 + body.count("---")
    assert all((ROOT / path).is_file() for path in re.findall(r"\]\((\S+?)\)", text))


def test_the_changelog_begins_with_this_version_and_its_date():
    text = (ROOT / "CHANGELOG.md").read_text()
    version, date = re.findall(r"^## (\d\S+) \((\d{4}-\d\d-\d\d)\)$", text, re.M)[0]
    assert (version, date) == (CITATION["version"], CITATION["date-released"])
