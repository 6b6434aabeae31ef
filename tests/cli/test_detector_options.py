"""Detectors and readout at the command line: of one design, and as axes of many."""

import csv
import json

import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("undrawn")

LIGHT = "--light free-dwell --rails single"
DESIGN = f"design --photons 1e4 --masks 3 --epochs 1 {LIGHT}"


def test_a_design_of_several_detectors_goes_through_its_commands(done, tmp_path):
    """Tiles and the same map give the same design; every command that shows light says them."""
    np.save(
        tmp_path / "map.npy",
        np.arange(64).reshape(8, 8) // 4 % 2 + np.arange(64).reshape(8, 8) // 32 * 2,
    )
    files, told = [tmp_path / "tiles.safetensors", tmp_path / "map.safetensors"], []
    for file, detectors in zip(files, ("2x2", tmp_path / "map.npy"), strict=True):
        words = (*DESIGN.split(), "--detectors", detectors, "-o", file)
        told.append(json.loads(done(*words, "--json")))
    assert told[0]["tests"] == told[1]["tests"]
    assert told[0]["info"]["job"]["camera"]["detectors"] == "2x2"
    assert "3 masks, 4 detectors" in done("evaluate", files[0], "--photons", "1e4")
    tested = json.loads(done("evaluate", files[0], "--photons", "1e4", "--json"))
    assert (tested["detectors"], tested["readout"]) == (4, "difference")
    assert "counts (batch, 3, 4)" in done("export", files[0])
    done("show", files[0], "-o", tmp_path / "masks.png")


def test_both_rails_are_read_where_asked(done, tmp_path):
    words = ["design", "--camera", "paper", "--photons", "1e4", "--masks", 3, "--epochs", 1, "-o"]
    file = tmp_path / "one.safetensors"
    assert "3 masks, both rails read" in done(*words, file, "--readout", "both")
    assert "3 masks at" in done(*words, file, "--force")


def test_detectors_and_readout_are_axes_of_a_comparison(done, tmp_path):
    words = ["--designs", "pca,impulse", "--photons", "1e4", "--masks", 3, "--trials", 1]
    words += ["--epochs", 1, "--workers", 1, "--light", "two-arm", "-o", tmp_path]
    axes = ["--detectors", "1x1,2x2", "--readout", "both,difference"]
    printed = done("compare", *words, *axes)
    rows = [line.rsplit(maxsplit=1)[0].strip() for line in printed.splitlines() if "±0" in line]
    masks = [f"PCA {d} detectors {r}" for d in ("1x1", "2x2") for r in ("both", "difference")]
    assert sorted(rows) == sorted([*masks, "impulse imaging"])
    points = json.loads((tmp_path / "results.json").read_text())["points"]
    assert {(p["detectors"], p["readout"]) for p in points if p["design"] == "pca"} == {
        (d, r) for d in ("1x1", "2x2") for r in ("both", "difference")
    }
    page = (tmp_path / "report.html").read_text()
    assert "PCA 2x2 detectors difference" in page
    (tmp_path / "one.toml").write_text(
        'designs = "pca"\nphotons = 1e4\nmasks = 3\ntraining.epochs = 1\n'
        '[camera]\nlight = "two-arm"\ndetectors = ["1x1", "2x2"]\n'
        'readout = ["both", "difference"]\n'
    )
    table = tmp_path / "all.csv"
    done("sweep", tmp_path / "one.toml", "-o", tmp_path / "one", "--workers", 1, "--table", table)
    rows = list(csv.DictReader(table.read_text().splitlines()))
    found = {(row["detectors"], row["readout"]) for row in rows}
    assert len(found) == 4


@pytest.mark.parametrize(
    ("detectors", "told"),
    [
        ("9x9", "do not divide scenes of 8x8: give ROWSxCOLUMNS from 1x1 to 8x8"),
        ("four", "give ROWSxCOLUMNS such as 2x2, a number of bands, or a .npy map"),
        ("2", "do not divide"),
        ("none.npy", "none.npy"),
        ("floats.npy", "give the detector of each pixel as a whole number"),
        ("gap.npy", "from 0 without a gap"),
        ("short.npy", "give 64 whole numbers"),
        ("text.npy", "text.npy"),
    ],
)
@pytest.mark.parametrize("command", ["design", "compare", "plan"])
def test_detectors_that_cannot_be_had_are_told(
    refuse, tmp_path, monkeypatch, command, detectors, told
):
    monkeypatch.chdir(tmp_path)
    np.save("floats.npy", np.zeros(64))
    np.save("gap.npy", np.arange(64) // 32 * 2)
    np.save("short.npy", np.zeros(10, dtype=int))
    (tmp_path / "text.npy").write_text("0 1")
    words = {
        "design": DESIGN,
        "compare": f"compare --photons 1e4 --designs pca --masks 3 {LIGHT}",
        "plan": f"plan --target 0.5 --designs pca --masks 3 {LIGHT}",
    }[command].split()
    out = tmp_path / ("one.safetensors" if command == "design" else "out")
    assert told in refuse(*words, "--detectors", detectors, "-o", out)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--light column --detectors 2x2", "column is other optics"),
        ("--readout sum", "readout"),
        ("--detectors 2x2 --light free-dwell --rails dual --looks 2", "read by themselves"),
    ],
)
def test_laws_that_do_not_allow_it_are_told(refuse, tmp_path, words, told):
    out = tmp_path / "one.safetensors"
    given = "--photons 1e4 --masks 3 --epochs 1"
    assert told in refuse("design", *given.split(), *words.split(), "-o", out)
