"""Detectors at the command line: of one design, and as axes of many."""

import json

import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("undrawn")

DESIGN = "design --photons 1e4 --masks 3 --epochs 1 --light free-dwell --rails single"


def test_a_design_of_several_detectors_goes_through_its_commands(done, tmp_path):
    """Tiles and the same map give the same design; `evaluate --json` says them."""
    np.save(tmp_path / "map.npy", np.kron([[0, 1], [2, 3]], np.ones((4, 4), int)))
    files, told = [tmp_path / "tiles.safetensors", tmp_path / "map.safetensors"], []
    for file, detectors in zip(files, ("2x2", tmp_path / "map.npy"), strict=True):
        words = (*DESIGN.split(), "--detectors", detectors, "-o", file)
        told.append(json.loads(done(*words, "--json")))
    assert told[0]["tests"] == told[1]["tests"]
    assert told[0]["info"]["job"]["camera"]["detectors"] == "2x2"
    tested = json.loads(done("evaluate", files[0], "--photons", "1e4", "--json"))
    assert (tested["detectors"], tested["readout"]) == (4, "difference")
    assert "detectors: 4" in done("export", files[0], "-o", tmp_path / "d.onnx")
    done("show", files[0], "-o", tmp_path / "masks.png")


def test_detectors_are_an_axis_of_a_comparison(done, tmp_path):
    words = ["--designs", "pca,impulse", "--photons", "1e4", "--masks", 3, "--trials", 1]
    words += ["--epochs", 1, "--workers", 1, "--light", "two-arm", "-o", tmp_path]
    printed = done("compare", *words, "--detectors", "1x1,2x2")
    rows = [line.rsplit(maxsplit=1)[0].strip() for line in printed.splitlines() if "±0" in line]
    masks = [f"PCA {d} detectors" for d in ("1x1", "2x2")]
    assert sorted(rows) == sorted([*masks, "impulse imaging"])
    points = json.loads((tmp_path / "results.json").read_text())["points"]
    assert {p["detectors"] for p in points if p["design"] == "pca"} == {"1x1", "2x2"}
    assert "PCA 2x2 detectors" in (tmp_path / "report.html").read_text()
