"""The networks of several looks alone: a folder of patterns without a design is run with them."""

from dataclasses import replace

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from conftest import quick
from deepfsi.base.errors import InputError
from deepfsi.camera.stop_rule import StopRule
from deepfsi.designfile.loop_file import loop_bytes, read_loop
from shared.design_files import file_of

SETTINGS = {
    "single": {"light": "free-dwell", "rails": "single"},
    "both": {"light": "free-dwell", "readout": "both"},
    "arms": {"light": "two-arm"},
}


def read(path, file, rails=None):
    """Read the loop of a design with what its folder knows of it."""
    about = {name: getattr(file.header, name) for name in ("light", "image_shape")}
    return read_loop(path, file.rails if rails is None else rails, summed_reflectance=30.0, **about)


@pytest.mark.parametrize("kind", SETTINGS)
def test_a_loop_answers_as_its_design(digits, tmp_path, kind):
    rule, path = {"threshold": 0.9, "photons": 1e3}, tmp_path / "loop.safetensors"
    design = quick(digits, masks=5, looks=3, photons=1e3, **SETTINGS[kind])
    file = file_of(replace(design, info={**design.info, "stopping": rule}))
    path.write_bytes(loop_bytes(file))
    loop = read(path, file)
    assert loop.stop_rule == StopRule(**rule)
    assert (loop.photons, loop.header.classes) == (1e3, file.header.classes)
    assert loop_bytes(loop) == path.read_bytes()
    features = np.linspace(0, 0.1, file.feature_count)
    inputs = file.inputs(features, np.full(file.frames, 0.5 / file.frames))
    assert np.array_equal(loop.chances(inputs, 300), file.chances(inputs, 300))
    assert np.array_equal(loop.next_dwell(inputs, 1, 0.01), file.next_dwell(inputs, 1, 0.01))
    assert np.array_equal(loop.distribution.mean, file.distribution.mean)
    assert np.array_equal(loop.scene_model.means, file.scene_model.means)


def test_a_damaged_loop_is_refused(digits, tmp_path):
    path = tmp_path / "loop.safetensors"
    file = file_of(quick(digits, masks=4, looks=2, **SETTINGS["single"]))
    with pytest.raises(InputError, match="missing"):
        read(path, file)
    path.write_bytes(loop_bytes(file)[:-10])
    with pytest.raises(InputError, match="not a whole loop"):
        read(path, file)
    path.write_bytes(loop_bytes(file))
    assert read(path, file).first_dwell.sum() == pytest.approx(1 / 2)
    with pytest.raises(InputError, match="do not fit"):  # of masks that are not these
        read(path, file, file.rails[:, 1:])
    sound = load_file(path)
    with safe_open(path, "np") as opened:
        header = opened.metadata()
    for name, change in (
        ("mean", lambda array: array[:-1]),
        ("chooser.1.weight", lambda array: array[:-1]),
        ("temperatures.logs", lambda array: array[1:]),
        ("temperatures.logs", lambda array: array * np.nan),
        ("temperatures.budgets", lambda array: array[::-1]),
    ):
        save_file(sound | {name: change(sound[name]).copy()}, path, header)
        with pytest.raises(InputError, match="do not fit"):
            read(path, file)
    with pytest.raises(InputError, match="one look"):
        loop_bytes(file_of(quick(digits, masks=4, **SETTINGS["single"])))
