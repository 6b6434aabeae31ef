"""Numbers stand in docs/numbers.toml, and pages repeat them.

The file is held to the tables of the notebook, which are made from records that are not in the
repository. All other pages, README and paper.md are held to the file.
"""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
GROUPS = tomllib.loads((DOCS / "numbers.toml").read_text())
NUMBERS = {text for group in GROUPS.values() for text, _ in group["numbers"].values()}
PAGES = [
    path
    for path in [ROOT / "README.md", ROOT / "paper.md", *sorted(DOCS.glob("**/*.md"))]
    if not {"notebook", "develop", "generated", "_build"} & set(path.relative_to(ROOT).parts)
]
"""Pages that repeat numbers; those of the notebook have tables of their own."""

CODE = re.compile(r"^(`{3,}).*?^\1|(?<!`)`[^`\n]+`(?!`)", re.M | re.S)
UNIT = r"(?! ?(?:[nmµ]?s|[kMG]?B|pixels|cells|[RGB])\b)"
BEFORE, INTERVAL = r"(?<![\d.·×])", r"(?: ± [\d.]+| \[[^\]]+\](?!\()| \([\d.]+ to [\d.]+\))?"
THREE = re.compile(rf"{BEFORE}0\.(?!00)\d{{3,4}}(?!\d|\.\d){UNIT}{INTERVAL}")
TWO = re.compile(rf"{BEFORE}0\.\d\d(?!\d|\.\d){UNIT}|(?<=recognises )\d\d\b")
ACCURATE = re.compile("accura|recogni|correct|rightly|classif", re.I)


def plain(text):
    """Text of a page without what marks words, signs alike."""
    return re.sub(r"\*\*|\\", "", text).replace("−", "-")


@pytest.mark.parametrize("group", GROUPS)
def test_each_number_stands_in_the_table_of_its_page(group):
    entry = GROUPS[group]
    assert set(entry) == {"are", "command", "cover", "page", "since", "numbers"}
    assert re.fullmatch(r"\d{4}-\d\d-\d\d( [0-9a-f]{8})?", entry["since"])
    page = plain((DOCS / f"{entry['page']}.md").read_text())
    missing = [text for text, _ in entry["numbers"].values() if plain(text) not in page]
    assert not missing
    assert all(about for _, about in entry["numbers"].values())


def foreign(text, numbers):
    """Accuracies of a text, in no code, that are none of the numbers.

    They are numbers 0.ddd from 0.01 on, with their intervals where the text gives them. In lines
    that speak of accuracy they are 0.dd, too, and the number of "recognises dd".
    """
    texts = {text.lstrip("+−") for text in numbers}
    values = {text.partition(" ")[0] for text in texts}
    hundredths = {f"{100 * float(value):.0f}" for value in values}
    found = []
    for line in CODE.sub("", text).splitlines():
        found += [each for each in THREE.findall(line) if each not in values | texts]
        short = TWO.findall(line) if ACCURATE.search(line) else []
        found += [each for each in short if each not in values | hundredths]
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_pages_have_numbers_of_the_file(page):
    """README has those of a run of `make run`, too."""
    printed = (DOCS / "make-run.txt").read_text() if page.name == "README.md" else ""
    assert not foreign(page.read_text(), {*NUMBERS, *re.findall(r"0\.\d{3}", printed)})


def test_pages_to_understand_are_short():
    for page in (DOCS / "understand").glob("*.md"):
        words = page.read_text().split()
        assert sum(bool(re.search(r"\w", word)) for word in words) <= 1000, page


def test_a_page_with_a_number_of_its_own_is_found():
    page = (
        "Learned masks have 0.894 ± 0.009, 0.894, at a threshold of 0.93, and 0.931.\n"
        "A camera recognises 92 of 100 digits, not 89, an accuracy of 0.92. It recognises 89.\n"
        "Not in `--ratios 0.125`, nor after 0.135 µs, nor\n```sh\ndeepfsi --lr 0.005\n```\n"
        "but in a table:\n| a | 0.9402 | 0.894 ± 0.008 | 0.894 [0.885, 0.903] |\n"
        "and gains: +0.044 [0.036, 0.053], −0.044 [0.036, 0.054].\n"
    )
    wrong = ["0.931", "92", "0.92", "0.9402", "0.894 ± 0.008", "0.894 [0.885, 0.903]"]
    known = {"0.894 ± 0.009", "+0.044 [0.036, 0.053]"}
    assert foreign(page, known) == [*wrong, "0.044 [0.036, 0.054]"]


def test_every_page_of_the_notebook_is_in_its_index_with_a_line():
    index = (DOCS / "notebook/index.md").read_text()
    listed = re.findall(r"^\| \[.+\]\(([\w-]+)\.md\) \| .+ \|$", index, re.M)
    pages = {path.stem for path in (DOCS / "notebook").glob("*.md")} - {"index"}
    assert sorted(listed) == sorted(pages)
    assert "notebook/index.md" in (DOCS / "understand/results.md").read_text()
