"""Pages are plain Markdown; the site of them has no bad link, and its tables leave nothing out."""

import inspect
import json
import math
import pkgutil
import re
import shutil
import subprocess
import sys
from html import unescape
from importlib import import_module
from pathlib import Path

import pytest

import deepfsi

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
sys.path[:0] = [str(DOCS), str(DOCS / "extensions")]

import charts  # noqa: E402
import check_site  # noqa: E402
import commands  # noqa: E402
import formats  # noqa: E402
import links  # noqa: E402
import modules  # noqa: E402

MODELS = re.findall(r"^Fields: \[(.+)\]", (DOCS / "lookup/formats.md").read_text(), re.M)
PAGES = [
    page
    for page in [*ROOT.glob("[A-Z]*.md"), *DOCS.rglob("*.md")]
    if not {"generated", "_build"} & set(page.relative_to(ROOT).parts)
]


def junk(text):
    """What viewers of Markdown show as it stands, and links that lead nowhere there."""
    shown = re.sub(
        r"^(`{3,})(?!\{).*?^\1$|(?<![`}])`[^`\n]+`|<!--.*?-->", "", text, flags=re.M | re.S
    )
    return re.findall(r"\A---$|\{\{|`{3}\{|:::|^\(.+\)=$|\{[\w:]+\}`|\)\{|\]\(/", shown, re.M)


def test_pages_are_plain_markdown():
    assert len(PAGES) > 80
    for page in PAGES:
        text = page.read_text()
        assert not junk(text), page
        for address in re.findall(r"\]\((?!https?:)([^)#\s]+)", re.sub(r"`[^`]*`", "", text)):
            assert (page.parent / address).exists(), f"{page}: {address}"


def test_what_is_no_plain_markdown_is_found():
    page = "A {{ b }}, {term}`c`, [d](/e.md).\n(f)=\n:::{div} g\n![h](i){.j}\n```{k}\n```\n"
    assert len(junk(f"---\n{page}")) == 8
    assert not junk("<!-- index ! a -->\n<!-- eval-rst\n:::\n-->\n`{{ b }}`\n```text\n:::\n```\n")


def test_comments_and_lines_become_directives():
    page = "<!-- index ! a -->\n\nSource: [b](c)\n<!-- toctree\n:hidden:\n\nd\n-->\n<!-- e -->\n"
    page += "Modules: [f](g), [h.i](j)\n[k](../gallery) [l](../tutorial/plot_1_m.py)\n"
    assert links.turned(page) == (
        "```{index} ! a\n```\n\n```{toctree} \n:hidden:\n\nd\n```\n<!-- e -->\n"
        "```{modules} f h.i\n```\n"
        "[k](/generated/gallery/index.rst) [l](/generated/tutorial/plot_1_m.rst)\n"
    )


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
def test_links_and_searches_of_the_built_site_lead_where_they_should(site):
    assert not list(check_site.faults(site))
    assert not list(check_site.lost(site))


def test_a_how_to_page_is_short():
    pages = {page: page.read_text() for page in (DOCS / "do").glob("*.md")}
    lengths = {page: len(re.sub("<!--.*?-->", "", text).split()) for page, text in pages.items()}
    assert max(lengths.values()) <= 700, lengths


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


def test_every_heading_of_the_command_line_has_a_page():
    pages = (DOCS / "lookup/cli").glob("*.md")
    found = [
        name for path in pages for name in re.findall("<!-- commands (.+) -->", path.read_text())
    ]
    assert sorted(found) == sorted(commands.headings())


def test_every_option_is_in_the_reference():
    text = commands.reference("Design")
    assert r"| `--photons <number,…>` | budgets, such as 1e2,1e3,1e4 \[required\] |" in text
    assert "| `--photons <number>` | budget Φ: expected photons on the coding device," in text
    assert "| `-o, --out <path>` | table with a line for each picture, .csv |" in text
    assert "$ deepfsi evaluate digits.safetensors --photons" in text


@pytest.mark.parametrize("path", MODELS)
def test_every_field_of_a_file_has_a_meaning_and_a_type(path):
    model = formats.model(path)
    rows = list(formats.rows(model))
    assert len(rows) == len(formats.TypeAdapter(model).json_schema()["properties"])
    assert all(name and meaning and kind for name, meaning, kind, _ in rows)


def test_every_name_of_the_package_is_on_its_page_with_an_example():
    page = "".join(each.read_text() for each in (DOCS / "lookup/api/package").glob("*.md"))
    assert set(deepfsi.__all__) <= set(
        re.findall(r"^.. auto(?:class|function):: (\w+)$", page, re.M)
    )
    for name in deepfsi.__all__:
        assert "\nExamples\n---" in inspect.getdoc(getattr(deepfsi, name)), name


def test_every_module_with_public_names_is_on_a_page():
    pages = [path.read_text() for path in (DOCS / "lookup/api").glob("*.md")]
    folders = [name for text in pages for name in modules.folders(text)]
    listed = set(modules.listed(folders))
    every = (each.name for each in pkgutil.walk_packages(deepfsi.__path__, "deepfsi."))
    public = {name for name in every if not re.search(r"\.(_|cli)", name)}
    assert not {name for name in public - listed if modules.names(import_module(name))}


def test_each_stored_chart_shows_its_table_as_it_stands():
    stored = {path.stem: path.read_text() for path in (DOCS / "figures").glob("chart-*.svg")}
    told = {name: re.search("<dc:description>(.*)</dc:d", text)[1] for name, text in stored.items()}
    assert {name: json.loads(unescape(text)) for name, text in told.items()} == {
        f"chart-{name}": chart for name, chart in charts.charts().items()
    }
    pages = "".join(page.read_text() for page in PAGES)
    assert all(f"figures/{name}.svg)" in pages for name in stored)
    assert max(map(len, stored.values())) < 60_000


def test_a_chart_reads_budgets_values_and_intervals():
    texts = ("1e2", "10⁴", "3 · 10³", "10 000", "1e2 photons", "0.0001 s")
    assert [charts.number(text, whole=True) for text in texts] == [100, 1e4, 3000, 1e4, 100, 1e-4]
    assert math.isnan(charts.number("2 looks", whole=True))
    assert math.isnan(charts.reach("refused")[0])
    assert charts.reach("**0.530 ± 0.003 (41)**") == (0.53, 0.003, 0.003)
    assert charts.reach("−0.08 [−0.16, +0.01]") == pytest.approx((-0.08, 0.08, 0.09))


TABLE = "| design | 1e2 | 10⁴ |\n| --- | --- | --- |\n| DeepFSI | 0.4 ± 0.1 | **0.9** |\n"


def test_a_chart_has_the_points_of_its_table_on_a_logarithmic_axis():
    page = f'<!-- chart a\nshow = ["DeepFSI"]\ny = "b"\n-->\n\n{TABLE}\n| other |\n'
    [(name, settings, heads, rows)] = charts.marked(page)
    assert (name, settings) == ("a", {"show": ["DeepFSI"], "y": "b"})
    places, lines = charts.chosen(heads, rows, settings["show"])
    [ax] = charts.drawn(places, lines, "photons", "accuracy").axes
    assert ax.get_xscale() == "log"
    assert ax.lines[0].get_xydata().tolist() == [[100, 0.4], [1e4, 0.9]]
    assert [(end - start)[1] for start, end in ax.collections[0].get_segments()] == [
        pytest.approx(0.2),
        0,
    ]


def test_a_logarithmic_chart_leaves_out_zero():
    lines = {"time": ["0.0", "0.2", "23"]}
    [ax] = charts.drawn([1e3, 1e4, 1e6], lines, "scenes", "s", log=True).axes
    assert ax.lines[0].get_xydata().tolist() == [[1e4, 0.2], [1e6, 23]]
    assert ax.get_xticks().tolist() == [1e4, 1e6]


def test_rows_without_numbers_become_bars():
    page = "<!-- chart a -->\n\n| what | gain |\n| --- | --- |\n| a | 1 |\n| b | 3 |\n"
    [(_, _, heads, rows)] = charts.marked(page)
    [ax] = charts.drawn(*charts.chosen(heads, rows, None), "", "gain").axes
    assert [bar.get_width() for bar in ax.patches] == [1, 3]
    assert [label.get_text() for label in ax.get_yticklabels()] == ["a", "b"]


def test_a_chart_of_a_line_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="the table has no 'PCA', it has b"):
        charts.chosen(["a", "b"], [["1", "2"]], ["PCA"])


SIGNATURE = "(*, camera={0}, exposure=Fixed(), hidden=(40, 128), seed=0)"


@pytest.mark.parametrize(
    ("turn", "given", "wanted"),
    [
        (
            lambda text: modules.short(None, "class", "", None, None, text, None)[0],
            SIGNATURE.format("Camera(light='a', sigma=f(1))"),
            SIGNATURE.format("Camera(...)"),
        ),
        (
            formats.kind,
            {"type": "array", "items": {"type": "number", "minimum": 0, "maximum": 1e15}},
            "list of number, 0 to 1e15",
        ),
        (formats.kind, {"anyOf": [{"enum": ["a", "b"]}, {"type": "null"}]}, "`a` or `b` or none"),
        (formats.kind, {"$ref": "#/$defs/Frame"}, "[Frame](#frame)"),
        (formats.kind, {"type": "integer", "exclusiveMinimum": 0}, "whole number, > 0"),
    ],
)
def test_names_and_types_are_shown_as_a_reader_has_them(turn, given, wanted):
    """Objects are cut in signatures."""
    assert turn(given) == wanted
