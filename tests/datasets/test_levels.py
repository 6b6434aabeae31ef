"""Large scenes stay in the type that they came in and are read part by part."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import deepfsi
from conftest import same
from deepfsi.base.errors import InputError
from deepfsi.datasets import arrays, levels, pictures
from deepfsi.datasets.levels import StoredScenes
from deepfsi.datasets.load import load_dataset
from shared.benchmarks import benchmark
from shared.pictures import save_images

TESTS = Path(__file__).parents[1]
SCENES = 600
SIDE = 32
"""Of a scene whose training is measured: its principal components cost the square of its pixels."""
FORMS = ("float32", "uint8", "mapped", "npz", "folder")


@pytest.fixture
def large(monkeypatch):
    """Take all scenes for large ones, and read few values at once."""
    monkeypatch.setattr(arrays, "LARGE", 0)
    monkeypatch.setattr(pictures, "LARGE", 0)
    monkeypatch.setattr(levels, "VALUES_AT_ONCE", 5000)


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
    assert isinstance(stored.x_train, StoredScenes)
    monkeypatch.setattr(arrays, "LARGE", 2**30)
    whole = load_dataset(scenes(), rescale=(0.2, 0.9))
    assert stored.hash == whole.hash
    assert stored.pixels == 64
    x = np.asarray(stored.x_train)
    assert x.dtype == stored.x_train.dtype == np.float32
    assert np.array_equal(x, whole.x_train)
    for part in (3, [5, 2, 400], np.s_[:, [5, 2]], whole.y_train == 1):
        assert np.array_equal(stored.x_train[part], x[part])
    assert np.array_equal(stored.x_train.max(axis=0), x.max(axis=0))
    assert stored.x_train.min() == x.min()
    assert np.allclose(stored.x_train.mean(axis=0), x.mean(axis=0, dtype=float))
    assert np.allclose(stored.x_train.sum(axis=1), x.sum(axis=1, dtype=float))
    assert stored.hold_out(100).hash == whole.hold_out(100).hash


@pytest.mark.parametrize(
    ("design", "settings"),
    [
        ("deepfsi", {}),
        ("pca", {}),
        ("deepfsi", {"exposure": deepfsi.Looks(looks=2)}),
        ("deepfsi", {"camera": deepfsi.Camera.load("dmd", noise="gaussian", sigma=3.0)}),
        ("deepfsi", {"training": deepfsi.Training(epochs=1, counts=200.0)}),
    ],
)
def test_designs_are_the_same_of_all_forms(design, settings, tmp_path, large):
    """Bit for bit, in whatever form the scenes are given."""
    asked = {"camera": "dmd", "training": deepfsi.Training(epochs=1), **settings}
    first, *others = (
        deepfsi.learn(given(form, tmp_path), design=design, masks=6, photons=1e4, **asked)
        for form in FORMS[:3]
    )
    assert all(same(first, other) for other in others)
    assert all(first.info["brightness"] == other.info["brightness"] for other in others)


def test_designs_of_large_and_of_small_data_agree(large, monkeypatch):
    """But for rounding."""
    asked = {"masks": 6, "photons": 1e4, "camera": "dmd", "training": deepfsi.Training(epochs=1)}
    stored = deepfsi.learn(scenes(), **asked)
    monkeypatch.setattr(arrays, "LARGE", 2**30)
    whole = deepfsi.learn(scenes(), **asked)
    assert np.allclose(stored.matrix, whole.matrix, atol=2e-3)
    [one], [other] = (deepfsi.evaluate(each, scenes(), 1e4) for each in (stored, whole))
    assert one.accuracy == pytest.approx(other.accuracy, abs=0.03)


@pytest.mark.parametrize("matrix", [4096, 0])
def test_leading_components_of_parts_are_those_of_all_scenes(large, monkeypatch, matrix):
    """By the scatter matrix, and by products with all scenes."""
    from deepfsi.jobs import designs

    x, y = scenes()
    x = np.concatenate([x, x // 2], axis=1)  # a direction of each class stands out
    monkeypatch.setattr(designs, "FULL_BASIS_PIXELS", 32)
    monkeypatch.setattr(designs, "SCATTER_PIXELS", matrix)
    stored = load_dataset((x, y)).x_train
    made, whole = (designs.principal_components(each, 3) for each in (stored, np.asarray(stored)))
    assert np.abs(made @ whole.T - np.eye(3)).max() < 1e-3


def test_a_folder_of_large_pictures_leaves_no_file(tmp_path, large, monkeypatch):
    """Not while it is read, not after an error, and not after Ctrl-C."""
    room = tmp_path / "room"
    room.mkdir()
    monkeypatch.setattr(pictures.tempfile, "tempdir", str(room))
    folder = tmp_path / "pictures"
    folder.mkdir()
    source = given("folder", folder)
    data = load_dataset(source)
    assert isinstance(data.x_train._values.base, np.memmap | np.ndarray)
    assert not list(room.iterdir())
    read, left = pictures._read, [20]

    def stopped(*arguments):
        left[0] -= 1
        if not left[0]:
            raise KeyboardInterrupt
        return read(*arguments)

    monkeypatch.setattr(pictures, "_read", stopped)
    with pytest.raises(KeyboardInterrupt):
        load_dataset(source)
    assert not list(room.iterdir())
    monkeypatch.setattr(pictures, "_read", read)
    monkeypatch.setattr(pictures.shutil, "disk_usage", lambda place: type("", (), {"free": 99}))
    with pytest.raises(InputError, match=r"600 images of 8x8 pixels, in .* TMPDIR"):
        load_dataset(source)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_of_a_training_is_that_of_its_data_and_little_more(tmp_path):
    """At most the data's bytes and 0.25 GB, beyond a training of few scenes: they are large.

    Both in one process, whose peak can only grow. The scenes as float32 would take 0.27 GB more.
    """
    memory, count = benchmark("memory"), 1 + arrays.LARGE // (4 * SIDE**2)
    paths = [memory.write("mapped", tmp_path, scenes, SIDE) for scenes in (memory.FEW, count)]
    words = (
        "import sys; from shared.benchmarks import benchmark; memory = benchmark('memory')\n"
        "for path in sys.argv[1:]:\n"
        "    print(memory.train_once('mapped', memory.Path(path), 'deepfsi', 1)['peak'])"
    )
    command = [sys.executable, "-c", words, *map(str, paths)]
    child = subprocess.run(command, cwd=TESTS, check=True, capture_output=True, text=True)
    few, many = map(float, child.stdout.split())
    assert many - few < count * SIDE**2 / 1e9 + 0.25, (few, many)
