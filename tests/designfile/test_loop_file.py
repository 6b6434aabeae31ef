"""The networks of several looks alone: a folder of patterns without a design is run with them."""

from dataclasses import replace

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from conftest import quick
from deepfsi.base import InputError
from deepfsi.camera import StopRule
from deepfsi.designfile import loop_bytes, read_loop
from shared.design_files import file_of

SETTINGS = {
    "single": {"light": "free-dwell", "rails": "single"},
    "both": {"light": "free-dwell", "readout": "both"},
    "arms": {"light": "two-arm"},
}


def written(path, file):
    """Write the loop of a design; gives what reads it with what its folder knows of it."""
    path.write_bytes(loop_bytes(file))
    about = {name: getattr(file.header, name) for name in ("light", "image_shape")}
    return lambda: read_loop(path, file.rails, summed_reflectance=30.0, **about)


@pytest.mark.parametrize("kind", SETTINGS)
def test_a_loop_answers_as_its_design(digits, tmp_path, kind):
    rule = {"threshold": 0.9, "photons": 1e3}
    design = quick(digits, masks=5, looks=3, photons=1e3, **SETTINGS[kind])
    file = file_of(replace(design, info={**design.info, "stopping": rule}))
    loop = written(tmp_path / "loop.safetensors", file)()
    assert loop.stop_rule == StopRule(**rule)
    assert (loop.photons, loop.header.classes) == (1e3, file.header.classes)
    assert loop_bytes(loop) == loop_bytes(file)
    features = np.linspace(0, 0.1, file.feature_count)
    inputs = file.inputs(features, np.full(file.frames, 0.5 / file.frames))
    assert np.array_equal(loop.chances(inputs, 300), file.chances(inputs, 300))
    assert np.array_equal(loop.next_dwell(inputs, 1, 0.01), file.next_dwell(inputs, 1, 0.01))
    assert np.array_equal(loop.distribution.mean, file.distribution.mean)
    assert np.array_equal(loop.scene_model.means, file.scene_model.means)


def test_a_damaged_loop_is_refused(digits, tmp_path):
    path = tmp_path / "loop.safetensors"
    file = file_of(quick(digits, masks=4, looks=2, **SETTINGS["single"]))
    read = written(path, file)
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(InputError, match="not a whole loop"):
        read()
    path.unlink()
    with pytest.raises(InputError, match="missing"):
        read()
    read = written(path, file)
    sound = load_file(path)
    with safe_open(path, "np") as opened:
        header = opened.metadata()
    logs, budgets = (sound[f"temperatures.{name}"] for name in ("logs", "budgets"))
    for changed in (
        {"mean": sound["mean"][:-1].copy()},
        {"chooser.1.weight": sound["chooser.1.weight"][:-1].copy()},
        {"temperatures.logs": logs[1:].copy()},
        {"temperatures.logs": logs * np.nan},
        {"temperatures.budgets": budgets[::-1].copy()},
    ):
        save_file(sound | changed, path, header)
        with pytest.raises(InputError, match="do not fit"):
            read()
    save_file(sound, path, header)
    assert read().first_dwell.sum() == pytest.approx(1 / 2)
    with pytest.raises(InputError, match="do not fit"):  # of masks that are not these
        read_loop(
            path, file.rails[:, 1:], light="free-dwell", image_shape=(8, 8), summed_reflectance=1
        )
    with pytest.raises(InputError, match="one look"):
        loop_bytes(file_of(quick(digits, masks=4, **SETTINGS["single"])))
