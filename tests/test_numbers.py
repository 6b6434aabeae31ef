"""Numbers stand in docs/numbers.toml, and pages quote them.

The file is held to the tables of the notebook, which are made from records that are not in the
repository. All other pages, README and paper.md are held to the file.
"""

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS / "extensions"))

import measured  # noqa: E402

GROUPS = measured.groups()
NUMBERS = {
    f"{group}.{name}": text
    for group, entry in GROUPS.items()
    for name, (text, _) in entry["numbers"].items()
}
PAGES = [
    path
    for path in sorted(DOCS.glob("**/*.md"))
    if not {"notebook", "develop", "generated", "_build"} & set(path.relative_to(DOCS).parts)
]
"""Pages that quote numbers; those of the notebook have tables of their own."""


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


def test_pages_write_no_accuracy_of_their_own_and_those_to_understand_are_short():
    for page in PAGES:
        text = page.read_text()
        assert not measured.accuracies(text), page
        words = measured.filled(text).split()  # every number that it quotes is there
        if page.parent.name == "understand":
            assert sum(bool(re.search(r"\w", word)) for word in words) <= 1000, page


def foreign(text, numbers):
    """Accuracies of a text that are none of the numbers, with their intervals where it has them."""
    shown = re.findall(r"(?<![\d.])0\.\d{3,4}(?: ± 0\.\d+)?(?!\d|\.\d)", text)
    values = {text.partition(" ")[0].lstrip("+−") for text in numbers}
    return [each for each in shown if each not in values | numbers]


@pytest.mark.parametrize("name", ["README.md", "paper.md"])
def test_files_that_cannot_quote_have_numbers_of_the_file(name):
    assert not foreign((ROOT / name).read_text(), set(NUMBERS.values()))


def test_readme_says_of_100_what_masks_and_a_raster_scan_recognise():
    quotes = "{{ shared.1e4 of 100 }} {{ looks.1-1e4 of 100 }} {{ column.raster-1e4 of 100 }}"
    said = re.findall(r"recognises (\d+)", (ROOT / "README.md").read_text())
    assert said == measured.filled(quotes).split()


def test_a_page_with_a_number_of_its_own_is_found():
    page = (
        "Learned masks have {{ looks.8-1e4 ± }}, at a threshold of 0.93, and 0.931.\n"
        "A camera recognises 92 of 100 digits, an accuracy of 0.92.\n"
        "Not in `--ratios 0.125`, nor after 0.135 µs, nor\n```sh\ndeepfsi --lr 0.005\n```\n"
        "but in a chart:\n```{chart}\n| a | 0.9402 |\n```\n"
    )
    assert measured.accuracies(page) == ["0.931", "92", "0.92", "0.9402"]
    text = "0.894 ± 0.009, 0.894, 0.895, 0.894 ± 0.008."
    assert foreign(text, {"0.894 ± 0.009"}) == ["0.895", "0.894 ± 0.008"]


def test_a_quote_is_a_value_its_interval_or_a_number_of_100():
    found = {"a": {"numbers": {"b-1": ["0.934 ± 0.005", "what"]}}}
    text = "{{ a.b-1 }}, {{ a.b-1 ± }}, {{ a.b-1 of 100 }}"
    assert measured.filled(text, found) == "0.934, 0.934 ± 0.005, 93"
    with pytest.raises(KeyError, match="c"):
        measured.filled("{{ a.c }}", found)


def test_every_page_of_the_notebook_is_in_its_index_with_a_line():
    index = (DOCS / "notebook/index.md").read_text()
    listed = re.findall(r"^\| \[.+\]\(([\w-]+)\.md\) \| .+ \|$", index, re.M)
    pages = {path.stem for path in (DOCS / "notebook").glob("*.md")} - {"index"}
    assert sorted(listed) == sorted(pages)
    assert "notebook/index.md" in (DOCS / "understand/results.md").read_text()
