"""Detectors at the command line: of one design, and as axes of many."""

import json

import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("undrawn")

DESIGN = "design --photons 1e4 --masks 3 --epochs 1 --light free-dwell --rails single"


def test_a_design_of_several_detectors_goes_through_its_commands(done, tmp_path):
    """Tiles and the same map give the same design; every command that shows light says them."""
    np.save(tmp_path / "map.npy", np.kron([[0, 1], [2, 3]], np.ones((4, 4), int)))
    files, told = [tmp_path / "tiles.safetensors", tmp_path / "map.safetensors"], []
    for file, detectors in zip(files, ("2x2", tmp_path / "map.npy"), strict=True):
        words = (*DESIGN.split(), "--detectors", detectors, "-o", file)
        told.append(json.loads(done(*words, "--json")))
    assert told[0]["tests"] == told[1]["tests"]
    assert told[0]["info"]["job"]["camera"]["detectors"] == "2x2"
    assert "3 masks, 4 detectors" in done("evaluate", files[0], "--photons", "1e4")
    tested = json.loads(done("evaluate", files[0], "--photons", "1e4", "--json"))
    assert (tested["detectors"], tested["readout"]) == (4, "difference")
    assert "counts (batch, 3, 4)" in done("export", files[0], "-o", tmp_path / "d.onnx")
    done("show", files[0], "-o", tmp_path / "masks.png")
