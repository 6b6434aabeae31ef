"""The pattern of a design file as a photomask, and the command that writes it."""

import json
import re

import numpy as np
import pytest
from PIL import Image

import deepfsi
from conftest import RECIPE, once, synthetic
from deepfsi.base import InputError
from deepfsi.lab.static_pattern import read_pattern, write_photomask
from shared.design_files import rewrite


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("designs")
    for name, levels in (("grey", None), ("binary", 2)):
        deepfsi.learn(
            synthetic((4, 6)),
            photons=1e4,
            camera={"levels": levels} if levels else None,
            exposure={"bins": 6, "speed": 1.5},
            training=RECIPE,
        ).save(folder / f"{name}.safetensors")
    return folder


def test_the_pattern_of_the_file_is_written(made, tmp_path):
    design = deepfsi.Design.load(made / "binary.safetensors")
    wanted = design.exposure.pattern.numpy()
    assert np.array_equal(read_pattern(made / "binary.safetensors"), wanted)
    assert np.array_equal(
        write_photomask(made / "binary.safetensors", tmp_path / "m.png", 5.0), wanted
    )
    assert np.array_equal(np.asarray(Image.open(tmp_path / "m.png")), wanted.astype(bool))
    write_photomask(made / "binary.safetensors", tmp_path / "m.svg", 5.0)
    text = (tmp_path / "m.svg").read_text()
    assert "4 x 15 pixels of 5 um, 20 x 75 um" in text
    assert 'width="0.075mm" height="0.02mm"' in text


def test_the_command_says_what_it_wrote(made, tmp_path, call):
    code, out, _ = call("mask", made / "binary.safetensors", "--pixel", 5, "-o", tmp_path / "m.svg")
    assert not code
    assert "4 x 15 pixels of 5 µm, 20 x 75 µm in all" in out
    code, out, _ = call(
        "mask", made / "grey.safetensors", "--pixel", 5, "-o", tmp_path / "m.png", "--json"
    )
    said = json.loads(out)
    assert said["pixels"] == [4, 15]
    assert said["um"] == [20, 75]
    assert 0 < said["open"] < 1


@pytest.mark.parametrize(
    ("name", "out", "pixel", "match"),
    [
        ("grey", "m.svg", 5, "polygons are open or dark.*--levels 2"),
        ("binary", "m.gds", 5, "end the name in .svg or .png"),
        ("binary", "m.svg", 0, "a pixel of 0 µm is not allowed"),
        ("binary", "m.svg", float("nan"), "a pixel of nan µm is not allowed"),
        ("missing", "m.svg", 5, "no design file at"),
    ],
    ids=str,
)
def test_bad_input_is_one_line_and_writes_nothing(made, tmp_path, call, name, out, pixel, match):
    code, _, err = call(
        "mask", made / f"{name}.safetensors", "--pixel", pixel, "-o", tmp_path / out
    )
    assert code == 2
    assert err.count("\n") == 1
    assert re.search(match, err)
    assert not list(tmp_path.iterdir())


def test_designs_of_masks_at_rest_and_damaged_patterns_are_refused(made, tmp_path):
    path = once(synthetic((4, 6)), masks=3).save(tmp_path / "rest.safetensors")
    with pytest.raises(InputError, match="a photomask is one pattern that scenes pass"):
        read_pattern(path)
    bright = tmp_path / "bright.safetensors"
    bright.write_bytes((made / "grey.safetensors").read_bytes())
    rewrite(bright, lambda header, tensors: tensors["exposure.pattern"].mul_(3))
    with pytest.raises(InputError, match="not a whole deepfsi design file"):
        read_pattern(bright)
