"""Designs that come with the package are opened by name, and are as accurate as their page says."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from conftest import real_mnist
from deepfsi import InputError, evaluate, load_dataset, load_design
from deepfsi.designfile.design_file import SHIPPED_DESIGNS, find_design

NAMES = {"dmd-mnist", "adaptive-mnist"}
PAGE = Path(__file__).parents[2] / "docs/notebook/designs.md"


@pytest.fixture(autouse=True)
def elsewhere(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


def test_two_small_designs_come_with_the_package():
    assert {path.name for path in SHIPPED_DESIGNS.iterdir()} == {f"{n}.safetensors" for n in NAMES}
    for name in NAMES:
        design = load_design(name)
        assert (design.image_shape, len(design.classes)) == ((32, 32), 10)
        assert find_design(name).stat().st_size < 9e5


def test_what_cannot_be_found_is_said_in_one_line():
    with pytest.raises(InputError, match=r"no design file at dmd-mnis: give one, or dmd-mnist"):
        load_design("dmd-mnis")


@real_mnist
def test_shipped_designs_are_as_accurate_as_their_page_says():
    mnist = load_dataset("mnist")
    few = replace(mnist, x_test=mnist.x_test[:100], y_test=mnist.y_test[:100])
    for name in NAMES:
        [row] = [
            line for line in PAGE.read_text().splitlines() if f"| `{name}` " in line and "±" in line
        ]
        [accuracy] = map(float, re.findall(r"(0\.\d{3}) ±", row))
        [result] = evaluate(load_design(name), few, 1e4, draws=1)
        assert abs(result.accuracy - accuracy) < 4 * (accuracy * (1 - accuracy) / 100) ** 0.5
