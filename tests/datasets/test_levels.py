"""Large scenes are kept in a file, and are read part by part."""

import os
from pathlib import Path

import numpy as np
import pytest

import deepfsi
from conftest import same
from deepfsi.base.errors import InputError
from deepfsi.datasets import arrays, levels
from deepfsi.datasets.load import load_dataset
from deepfsi.exposure import training_set
from deepfsi.jobs import designs
from shared.pictures import save_images

SCENES = 600
FORMS = ("float32", "uint8", "mapped", "npz", "folder")


@pytest.fixture
def large(monkeypatch):
    """Take all scenes for large ones, and read few values at once."""
    limit(monkeypatch, 0)
    monkeypatch.setattr(levels, "VALUES_AT_ONCE", 5000)


def limit(monkeypatch, large: int) -> None:
    """Take scenes of more bytes for large ones."""
    for module in (arrays, levels, designs, training_set):
        monkeypatch.setattr(module, "LARGE", large)


def scenes() -> tuple[np.ndarray, np.ndarray]:
    """Images (n, 8, 8) of four classes in their order, a corner of which never varies."""
    x = np.random.default_rng(3).integers(0, 256, (SCENES, 8, 8), dtype=np.uint8)
    y = np.repeat(np.arange(4), SCENES // 4)
    for label in range(4):
        x[y == label, label] //= 3
    x[:, :2, :2] = 7
    return x, y


def given(form: str, folder: Path):
    """The scenes in a form."""
    x, y = scenes()
    if form == "float32":
        return x.astype(np.float32) / np.float32(255), y
    if form == "mapped":
        np.save(folder / "x.npy", x)
        return np.load(folder / "x.npy", mmap_mode="r"), y
    if form == "npz":
        np.savez(folder / "arrays.npz", x=x, y=y)
        return folder / "arrays.npz"
    if form == "folder":
        for label in range(4):
            save_images(folder / str(label), x[y == label])
        return folder
    return x, y


@pytest.mark.parametrize("form", FORMS)
def test_large_data_are_the_same_data_set(form, tmp_path, large, monkeypatch):
    """Hash, order, parts and reflectance are those of the arrays in memory."""
    stored = load_dataset(given(form, tmp_path), rescale=(0.2, 0.9))
    assert isinstance(stored.x_train.base.base, np.memmap)
    limit(monkeypatch, 2**30)
    whole = load_dataset(scenes(), rescale=(0.2, 0.9))
    assert stored.hash == whole.hash
    assert np.array_equal(stored.x_train, whole.x_train)
    assert stored.hold_out(100).hash == whole.hold_out(100).hash


@pytest.mark.parametrize("settings", [{}, {"exposure": deepfsi.Range(span=10)}])
def test_designs_are_the_same_of_all_forms(settings, tmp_path, large):
    """Bit for bit, in whatever form the scenes are given."""
    asked = {"camera": "dmd", "training": deepfsi.Training(epochs=1), **settings}
    first, *others = (
        deepfsi.learn(given(form, tmp_path), masks=6, photons=1e4, **asked) for form in FORMS[:3]
    )
    assert all(same(first, other) for other in others)
    assert all(first.info["brightness"] == other.info["brightness"] for other in others)


def test_leading_components_of_large_scenes_are_those_of_all(large, monkeypatch):
    x, y = scenes()
    x = np.concatenate([x, x // 2], axis=1)  # a direction of each class stands out
    monkeypatch.setattr(designs, "FULL_BASIS_PIXELS", 32)
    stored = load_dataset((x, y)).x_train
    made = designs.principal_components(stored, 3)
    monkeypatch.setattr(designs, "LARGE", 2**30)
    assert np.abs(made @ designs.principal_components(stored, 3).T - np.eye(3)).max() < 1e-3


def test_a_file_of_large_scenes_has_no_name_and_needs_room(tmp_path, large, monkeypatch):
    monkeypatch.setattr(levels.tempfile, "tempdir", str(tmp_path))
    data = load_dataset(scenes())
    assert data.x_train.any()
    assert not os.listdir(tmp_path)
    monkeypatch.setattr(levels.shutil, "disk_usage", lambda place: type("", (), {"free": 99}))
    with pytest.raises(InputError, match=r"600 scenes of 64 values, in .* TMPDIR"):
        load_dataset(scenes())
