"""Values in place of classes, on the command line."""

import json

import numpy as np
import pytest

from shared.values import placed_digits


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """An .npz file of 400 digits and the centres of their light."""
    data, path = placed_digits(), tmp_path_factory.mktemp("values") / "placed.npz"
    x, y = data.x_train[:400].reshape(-1, 8, 8), data.y_train[:400]
    np.savez(path, x=x, y=y, values=np.array(data.values))
    return path


def test_values_go_from_design_to_the_report(done, refuse, file, tmp_path):
    made = tmp_path / "v.safetensors"
    few = ("--photons", "1e4", "--masks", 3, "--epochs", 2)
    out = done("design", "--data", file, *few, "-o", made)
    assert "R² " in out
    assert "root mean squared error" in out
    told = json.loads(done("evaluate", made, "--photons", "1e4", "--json"))["results"][0]
    assert told["values"] == ["row", "column"]
    table = done("evaluate", made, "--photons", "1e3,1e4")
    assert "row" in table
    assert "accuracy" not in table
    words = ("page", made, "-o", tmp_path / "p.html")
    assert "is of classes" in refuse(*words)

    folder = tmp_path / "out"
    words = ("--designs", "pca,impulse", "--workers", 1, "--data", file, *few, "-o", folder)
    printed = done("compare", *words)
    assert "root mean squared error" in printed
    assert "worst class" not in printed
    results = json.loads((folder / "results.json").read_text())
    assert results["data"]["measure"] == "R²"
    assert results["data"]["chance"] == 0
    assert all(len(point["rmse"]) == 2 for point in results["points"])
    page = (folder / "report.html").read_text()
    assert "Errors of each value" in page
    assert "R² at each budget" in page
    assert "classified correctly" not in page
    assert "is the most accurate" not in page
