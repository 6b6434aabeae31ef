"""Tables: one line a row at 80 columns, sorted, with one notation of photons."""

import re

import numpy as np
import pytest

from deepfsi.cli import common

WIDTH = 80


def lines_of(printed: str, number: int = 0) -> list[str]:
    """Lines of a table's rows: those between its rule and the first empty line after it."""
    lines = [line.rstrip() for line in printed.splitlines()]
    rule = [place for place, line in enumerate(lines) if set(line.strip()) == {"─"}][number]
    assert max(map(len, lines[rule - 1 :][:2])) <= WIDTH
    return lines[rule + 1 : lines.index("", rule)]


@pytest.mark.parametrize(
    ("photons", "text"),
    [(1, "1e0"), (100, "1e2"), (31623, "3.16e4"), (1e6, "1e6"), (250, "2.5e2"), (0.13, "1.3e-1")],
)
def test_photons_have_one_notation_that_options_take(photons, text):
    from deepfsi.cli.options import number

    assert common.budget(photons) == text
    assert number("photons", text) == pytest.approx(photons, rel=5e-3)


def test_a_comparison_is_sorted_and_has_a_line_for_each_row(done, tmp_path, monkeypatch):
    """Every axis that is asked for at the command line, and the longest names."""
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    words = ["--designs", "truncated-hadamard,pca,impulse", "--photons", "1e2,31623,1e4"]
    words += ["--masks", 3, "--trials", 1, "--epochs", 1, "--workers", 1, "-o", tmp_path]
    words += ["--noise", "poisson,gaussian", "--light", "column,equal-dwell", "--rails"]
    printed = done("compare", *words, "dual,single")
    rows = lines_of(printed)
    assert max(map(len, rows)) <= WIDTH
    assert len(rows) == 3 * (4 + 4 + 1) * 2
    cells = [(float(row.split()[1]), -float(row.split()[3])) for row in rows]
    assert cells == sorted(cells)
    assert all(
        re.match(r" (TH|FSI|II) +\d(\.\d+)?e\d +\d+ +0\.\d{3} ± 0\.\d{3} ", row) for row in rows
    )
    assert "TH truncated Hadamard" in printed
    by_class = lines_of(printed, 1)
    assert max(map(len, by_class)) <= WIDTH
    assert [row.split()[:2] for row in by_class] == [row.split()[:2] for row in rows]
    assert all(re.search(r" 0\.\d{3} ± 0\.\d{3} +0\.\d{3} \(\d\) ", row) for row in by_class)


def test_budgets_of_a_test_are_sorted(done, made, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    file = made("deepfsi", "column", "dual").save(tmp_path / "one.safetensors")
    rows = lines_of(done("evaluate", file, "--photons", "1e4,1e2,31623"))
    assert [row.split()[0] for row in rows] == ["1e2", "1e4", "3.16e4"]
    assert max(map(len, rows)) <= WIDTH


def test_long_names_of_classes_are_shortened(done, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    x, y = np.random.default_rng(0).random((60, 9)), np.arange(60) % 2
    classes = ["a class of a very long name", "another class of a very long name"]
    data, file = tmp_path / "scenes.npz", tmp_path / "one.safetensors"
    np.savez(data, x=x, y=np.array(classes)[y])
    done("design", "--data", data, "--photons", "1e4", "--masks", 3, "--epochs", 1, "-o", file)
    [row] = lines_of(done("evaluate", file, "--photons", "3.16e4"))
    assert re.search(r"\((a class of a|another clas)…\)", row)
    words = ["--data", data, "--designs", "pca,deepfsi", "--photons", "1e4", "--masks", 3]
    words += ["--noise", "poisson,gaussian", "--light", "column,equal-dwell", "--trials", 1]
    words += ["--rails", "dual,single", "--epochs", 1, "--workers", 1, "-o", tmp_path / "out"]
    rows = lines_of(done("compare", *words), 1)
    assert all(re.search(r"\((a clas|anothe)…\)", row) for row in rows)
    assert max(map(len, [row, *rows])) <= WIDTH


def test_names_of_data_sets_are_whole(done, monkeypatch, tmp_path):
    """Where they are is told from $DEEPFSI_DATA on: the longest name and folder fit."""
    from deepfsi.datasets import catalog

    root = tmp_path / "a-long-way-to-the-data-of-everybody"
    (root / "indian_pines").mkdir(parents=True)
    monkeypatch.setenv("DEEPFSI_DATA", str(root))
    monkeypatch.setattr(catalog.indian_pines, "where", lambda name: root / "indian_pines")
    printed = done("data", "list")
    rows = lines_of(printed)
    assert len(rows) == len(catalog.NAMES)
    assert max(map(len, rows)) <= WIDTH
    assert "indian-pines-surrogate" in printed
    assert "$DEEPFSI_DATA/indian_pines" in printed


def test_a_terminal_that_is_too_narrow_loses_nothing(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "30")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("NO_COLOR", "1")
    heads = ("design", "photons", "masks", "accuracy", "counted")
    row = ("impulse imaging", "1.27e3", "64", "0.279 ± 0.020", "0.016")
    common.print_table("a table", heads, [row])
    words = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out).split()
    assert "".join(sorted("".join((*heads, *row)).replace(" ", ""))) == "".join(
        sorted("".join(words).replace("atable", "").replace("─", ""))
    )


def test_names_in_brackets_are_text(capsys):
    common.print_table("[bold]title", ("name",), [("[red]class",), (":smile:",)])
    printed = capsys.readouterr().out
    for text in ("[bold]title", "[red]class", ":smile:"):
        assert text in printed
