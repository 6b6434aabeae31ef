"""The site builds without a warning, its links lead somewhere, and its tables leave nothing out."""

import inspect
import pkgutil
import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import deepfsi

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
sys.path[:0] = [str(DOCS), str(DOCS / "extensions")]

import check_site  # noqa: E402
import commands  # noqa: E402
import formats  # noqa: E402
import links  # noqa: E402
import messages  # noqa: E402
import modules  # noqa: E402

LISTED = re.compile(r"^```\{modules\} (.+)$", re.M)
OF_THE_HOUSE = {
    f"deepfsi.{name}" for name in ("frozen", "imports", "interrupts", "memory", "owners")
}
"""Modules that only the package itself needs."""

MODELS = re.findall(r"^```\{fields\} (\S+)$", (DOCS / "lookup/formats.md").read_text(), re.M)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Site built from a copy of the pages: no script is run, no module listed."""
    home = tmp_path_factory.mktemp("site")
    shutil.copytree(DOCS, home / "docs", ignore=shutil.ignore_patterns("_build", "generated"))
    for path in ROOT.glob("*.md"):
        shutil.copy(path, home)
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "docs", "html"]
    quick = ["-D", "plot_gallery=0", "-D", "quick=1"]
    done = subprocess.run([*command, *quick], cwd=home, capture_output=True, text=True)
    assert not done.returncode, done.stderr
    return home / "html"


@pytest.mark.slow
def test_every_link_of_the_built_site_leads_somewhere_and_nothing_comes_from_elsewhere(site):
    assert not list(check_site.faults(site))


def test_a_bad_link_and_a_file_from_elsewhere_are_found(tmp_path):
    (tmp_path / "a.html").write_text(
        '<p id="here"></p><a href="b.html"></a><a href="#here"></a><a href="#gone"></a>'
        '<img src="https://a.example/b.png"><link rel="stylesheet" href="//a.example/c.css">'
        '<a href="https://a.example"></a><p style="background: url(http://a.example/d.png)"></p>'
    )
    (tmp_path / "e.css").write_text('@import "https://a.example/f.css"; a { b: url(data:image) }')
    assert list(check_site.faults(tmp_path)) == [
        "a.html: loads https://a.example/b.png",
        "a.html: loads //a.example/c.css",
        "a.html: loads http://a.example/d.png",
        "a.html: nothing at b.html",
        "a.html: nothing at #gone",
        "a.html: nothing at //a.example/c.css",
        "e.css: loads https://a.example/f.css",
    ]


@pytest.mark.parametrize(
    ("link", "page"),
    [
        ("[a](../../CONTRIBUTING.md#b)", "[a](/lookup/contributing.md#b)"),
        ("[a](../gallery/b/plot_c.py)", "[a](/generated/gallery/b/plot_c.rst)"),
        ("[a](../../tutorial/plot_b.py)", "[a](/generated/tutorial/plot_b.rst)"),
        ("[a](b.md#c)", "[a](b.md#c)"),
    ],
)
def test_links_to_files_outside_the_docs_turn_to_pages(link, page):
    assert links.turned(link) == page


def test_every_heading_of_the_command_line_has_a_page():
    pages = (DOCS / "lookup/cli").glob("*.md")
    found = [name for path in pages for name in re.findall(r"\{commands\} (\w+)", path.read_text())]
    assert sorted(found) == sorted(commands.headings())


def test_every_option_is_in_the_reference():
    text = commands.reference("Design")
    assert "| `--photons <str>` | budget Φ: expected photons on the coding device," in text
    assert "| `-o, --out <path>` | design file, .safetensors | required |" in text
    assert "$ deepfsi design --data mnist" in text


@pytest.mark.parametrize("path", MODELS)
def test_every_field_of_a_file_has_a_meaning_and_a_type(path):
    found = formats.model(path)
    rows = list(formats.rows(found))
    assert len(rows) == len(formats.TypeAdapter(found).json_schema()["properties"])
    assert all(name and meaning and kind for name, meaning, kind, _ in rows)


@pytest.mark.parametrize("name", deepfsi.__all__)
def test_every_name_of_the_package_is_on_its_page_with_an_example(name):
    page = (DOCS / "lookup/api/package.md").read_text()
    assert re.search(rf"^.. auto(class|function):: {name}$", page, re.M)
    assert "\nExamples\n---" in inspect.getdoc(getattr(deepfsi, name))


def test_every_module_with_public_names_is_on_a_page():
    pages = [path.read_text() for path in (DOCS / "lookup/api").glob("*.md")]
    folders = [name for text in pages for name in " ".join(LISTED.findall(text)).split()]
    listed = {path for folder in folders for path in modules.under(folder)}
    every = (each.name for each in pkgutil.walk_packages(deepfsi.__path__, "deepfsi."))
    public = {name for name in every if not re.search(r"\.(_|cli)", name)}
    left_out = {name for name in public - listed if modules.names(import_module(name))}
    assert left_out == OF_THE_HOUSE


def test_every_message_of_the_package_is_on_the_page_of_troubleshooting():
    assigned = messages.assigned((DOCS / "lookup/troubleshooting.md").read_text())
    every = {path for _, path in messages.modules() if messages.of_module(path)}
    explained = {path for files in assigned.values() for path in files}
    assert not every - explained
    assert all(assigned.values())
    texts = [text for path in every for text in messages.of_module(path)]
    assert len(texts) > 500
    assert any(text.startswith("unknown data set '‹name›': ‹…›") for text in texts)


def test_messages_show_what_they_fill_in(tmp_path):
    (tmp_path / "a.py").write_text(
        'MOST = "at most 3"\nraise InputError(f"{path} has {len(x)} rows: give {MOST}, {self.b}")\n'
        "raise ValueError(name)\n"
    )
    found = ["‹path› has ‹…› rows: give at most 3, ‹b›"]
    assert messages.of_module(tmp_path / "a.py") == found


def test_types_and_allowed_values_are_words():
    schema = {"type": "array", "items": {"type": "number", "minimum": 0, "maximum": 1e15}}
    assert formats.kind(schema) == "list of number, 0 to 1e15"
    assert formats.kind({"anyOf": [{"enum": ["a", "b"]}, {"type": "null"}]}) == "`a` or `b` or none"
    assert formats.kind({"$ref": "#/$defs/Frame"}) == "[Frame](#frame)"
    assert formats.kind({"type": "integer", "exclusiveMinimum": 0}) == "whole number, > 0"
