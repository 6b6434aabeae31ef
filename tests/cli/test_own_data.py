"""A user's own pictures on the command line: what was done to them is said."""

import json

import numpy as np
import pytest
from PIL import Image


def save_pictures(folder, counts, side=8, seed=0):
    """Write 12-bit pictures in 16-bit PNG files: each class a bright quarter and noise."""
    rng = np.random.default_rng(seed)
    for label, count in counts.items():
        (folder / label).mkdir(parents=True)
        row, column = divmod(list(counts).index(label), 2)
        for number in range(count):
            levels = rng.integers(100, 1200, (side, side))
            half = side // 2
            levels[half * row : half * (row + 1), half * column : half * (column + 1)] += 2500
            Image.fromarray(levels.astype(np.uint16)).save(folder / label / f"{number:03}.png")
    return folder


@pytest.fixture
def pictures(tmp_path):
    return save_pictures(tmp_path / "leaves", {"ash": 30, "oak": 30, "yew": 30})


SAID = "data: leaves. 90 images of 8x8 pixels; 16-bit values from 10"
TRAINED = ("--photons", "1e4", "--masks", 4, "--epochs", 1)


def test_what_was_done_to_pictures_is_said_in_one_line(done, pictures, tmp_path):
    file = tmp_path / "leaves.safetensors"
    out = done("design", "--data", pictures, *TRAINED, "-o", file)
    [line] = [line for line in out.splitlines() if line.startswith("data:")]
    assert line.startswith(SAID)
    assert line.endswith("divided by 4095 (12 bits).")
    assert line in done("evaluate", file, "--data", pictures, "--photons", "1e4")
    words = ["--designs", "pca", "--photons", "1e4", "--masks", 3, "--epochs", 1, "--workers", 1]
    words += ["--data", pictures, "-o", tmp_path / "out"]
    assert line in done("compare", *words).splitlines()
    facts = json.loads(done("compare", *words, "--json"))["data"]
    assert line == f"data: {facts['name']}. {facts['preprocessing']}"
