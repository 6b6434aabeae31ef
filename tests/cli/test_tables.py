"""Tables: one line a row at 80 columns, sorted, with one notation of photons."""

import json
import re

import pytest

from deepfsi.base.quantities import Table, budget_text
from deepfsi.cli import terminal

pytestmark = pytest.mark.usefixtures("undrawn")

WIDTH = 80


def lines_of(printed: str, width: int = WIDTH) -> list[str]:
    """Lines of a table's rows: those between its rule and the first empty line after it."""
    lines = [line.rstrip() for line in printed.splitlines()]
    rule = next(place for place, line in enumerate(lines) if set(line.strip()) == {"─"})
    assert max(map(len, lines[rule - 1 :][:2])) <= width
    return lines[rule + 1 : lines.index("", rule)]


@pytest.mark.parametrize(
    ("photons", "text"),
    [(1, "1e0"), (100, "1e2"), (31623, "3.16e4"), (1e6, "1e6"), (250, "2.5e2"), (0.13, "1.3e-1")],
)
def test_photons_have_one_notation_that_options_take(photons, text):
    assert budget_text(photons) == text
    assert float(text) == pytest.approx(photons, rel=5e-3)


def test_a_comparison_is_one_matrix_one_sentence_and_one_path(done, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    words = ["--photons", "1e2,31623,1e3,1e4", "--masks", 3, "--trials", 2, "--epochs", 1]
    words += ["--designs", "truncated-hadamard,pca,impulse", "--workers", 1, "-o", tmp_path]
    printed = done("compare", *words)
    rows = lines_of(printed)
    assert max(map(len, rows)) <= WIDTH
    assert [row.split("  ")[0].strip() for row in rows] == [
        "truncated Hadamard", "PCA", "impulse imaging",
    ]  # fmt: skip
    cell = r" +0\.\d{3}±0\.\d{3}[ *]?"
    assert all(re.fullmatch(rf" \w[\w ]*?{4 * cell}", row) for row in rows)
    assert printed.count("─ ") == 1
    head = next(line for line in printed.splitlines() if line.startswith(" design"))
    assert head.split() == ["design", "1e2", "1e3", "1e4", "3.16e4"]
    *_, said, path = printed.splitlines()
    assert said.endswith(".")
    assert path == f"report: {tmp_path / 'report.html'}"
    told = json.loads(done("compare", *words, "--json"))
    assert told["verdict"] == said


def test_names_are_text(capsys):
    """Brackets and colons stay; what a terminal takes for a command goes."""
    rows = [("[red]class",), (":smile:",), ("\x1b[31mred",)]
    terminal.Terminal(False).say(Table("[bold]title", ("name",), rows), "a\x9bb\nc")
    printed = capsys.readouterr().out
    for text in ("[bold]title", "[red]class", ":smile:", " [31mred", "a b\nc"):
        assert text in printed
