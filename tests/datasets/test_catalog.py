"""Data sets with a name: listed, checked, downloaded and loaded, from tiny and from real files."""

import hashlib
import io
import os
import tarfile
from pathlib import Path

import numpy as np
import pooch
import pytest
from dataset_samples import not_loaded
from scipy.io import savemat

from deepfsi.datasets import catalog
from deepfsi.datasets.catalog import load_indian_pines
from deepfsi.datasets.load import load_dataset

MINE = Path(os.environ.get("DEEPFSI_DATA") or ".")


def needs(path):
    return pytest.mark.skipif(not (MINE / path).exists(), reason=f"needs $DEEPFSI_DATA/{path}")


MNIST_HASH = "49bd5a2700bc752110ee3797138b1924d711c3bd98a376b24e07fd7ad78585d1"


@needs("mnist/train-images-idx3-ubyte.gz")
def test_mnist():
    data = load_dataset("mnist")
    assert data.hash == MNIST_HASH
    assert data.y_train[:5].tolist() == [5, 0, 4, 1, 9]
    held = data.hold_out()
    assert held.x_test.shape == (10_000, 1024)
    assert held.y_test[-1] == data.y_train[-1]


# ---------------------------------------------------------------- CIFAR-10, twenty images a batch

CIFAR = catalog.DATASETS["cifar10"]
BATCH = 20
RECORDS = np.random.default_rng(8).integers(0, 256, (6, BATCH, 3073), dtype=np.uint8)
RECORDS[..., 0] = np.arange(BATCH) % 10
RECORDS[0, :, 0] = RECORDS[0, ::-1, 0]


@pytest.fixture
def archive(tmp_path, monkeypatch):
    """The archive alone in $DEEPFSI_DATA/cifar10; nothing can be downloaded."""
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    monkeypatch.setattr(pooch, "os_cache", lambda _: tmp_path / "cache")
    monkeypatch.setattr(CIFAR, "mirrors", ((tmp_path / "mirror").as_uri() + "/",))
    path = tmp_path / "cifar10" / "cifar-10-binary.tar.gz"
    path.parent.mkdir()
    with tarfile.open(path, mode="w:gz") as file:
        for name, records in zip(CIFAR.BATCHES, RECORDS, strict=True):
            info = tarfile.TarInfo(f"cifar-10-batches-bin/{name}")
            info.size = records.nbytes
            file.addfile(info, io.BytesIO(records.tobytes()))
    actual = hashlib.md5(path.read_bytes()).hexdigest()
    monkeypatch.setitem(CIFAR.hashes, path.name, f"md5:{actual}")
    return path


def luma(records):
    red, green, blue = records[:, 1:].reshape(-1, 3, 1024).transpose(1, 0, 2)
    return (0.299 * red + 0.587 * green + 0.114 * blue) / 255


def test_the_archive_gives_grey_scenes(archive):
    data = load_dataset("cifar10")
    assert data.name == "CIFAR-10"
    assert data.classes[6] == "frog"
    assert data.image_shape == (32, 32)
    assert data.preprocessing == "Colours turned to grey, divided by 255."
    assert data.y_test.tolist() == RECORDS[5, :, 0].tolist()
    assert np.abs(data.x_test - luma(RECORDS[5])).max() < 0.51 / 255 + 1e-6
    train = RECORDS[:5].reshape(100, 3073)
    distance = np.abs(data.x_train[:, None] - luma(train)).max(axis=2)
    order = distance.argmin(axis=1)
    assert distance.min(axis=1).max() < 0.51 / 255 + 1e-6
    assert sorted(order) == list(range(100)) != order.tolist(), "shuffled"
    assert data.y_train.tolist() == train[order, 0].tolist()


def test_size_is_bilinear_and_images_are_drawn_by_class(archive):
    data = load_dataset("cifar10", size=64, images=30)
    assert data.image_shape == (64, 64)
    assert np.bincount(data.y_train).tolist() == [3] * 10
    assert data.preprocessing.startswith("30 training images drawn by class; Colours turned to ")
    assert "grey, resized bilinearly to 64x64 pixels, divided" in data.preprocessing
    x = data.x_test.reshape(-1, 64, 64)
    plain = load_dataset("cifar10").x_test.reshape(-1, 32, 32)
    inside = 0.5625 * plain[:, 5, 5] + 0.1875 * (plain[:, 4, 5] + plain[:, 5, 4])
    assert np.abs(x[:, 10, 10] - inside - 0.0625 * plain[:, 4, 4]).max() < 1.01 / 255
    few = [load_dataset("cifar10", images=30, seed=seed).hash for seed in range(2)]
    assert len(set(few)) == 2


# ---------------------------------------------------------------- Indian Pines

PINES = catalog.DATASETS["indian-pines"]


def made_up():
    """Cube and label map of the scene's size, other values."""
    labels = np.kron(np.arange(1, 26).reshape(5, 5), np.ones((29, 29))).astype(np.uint8)
    labels[labels > 16] = 0
    cube = np.random.default_rng(6).integers(955, 9605, (145, 145, 200)).astype(np.uint16)
    return {PINES.CUBE: cube, "Indian_pines_gt": labels}


def write(path, values):
    if path.suffix == ".npy":
        np.save(path, values)
    else:
        savemat(path, {path.stem.lower(): values})


@pytest.fixture(params=[".npy", ".mat"])
def ending(request):
    return request.param


@pytest.fixture
def pines(ending, tmp_path, monkeypatch):
    """$DEEPFSI_DATA/indian_pines with files of either kind."""
    folder = tmp_path / "indian_pines"
    folder.mkdir()
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    for stem, values in made_up().items():
        write(folder / f"{stem}{ending}", values)
    return folder


def test_the_scene_of_a_folder(pines):
    data = load_dataset("indian-pines")
    assert data.name == "indian-pines"
    assert data.image_shape == (256,)
    assert data.classes == PINES.classes
    assert len(data.x_train) + len(data.x_test) == 16 * 29 * 29
    for said in ("200 of 220 bands", "with darkness to 256", "from [955, 9604] to [0, 1]"):
        assert said in data.preprocessing
    assert not data.x_test[:, 200:].any()
    assert data.x_test[:, :200].any(axis=0).all()
    scene = load_indian_pines()
    assert np.array_equal(scene.cube, made_up()[PINES.CUBE])
    blocks = load_dataset("indian-pines", split="blocks")
    assert np.array_equal(blocks.x_test, scene.dataset("blocks", bands=256).x_test)


def test_what_is_missing_is_named(pines, ending, monkeypatch):
    (pines / f"Indian_pines_gt{ending}").unlink()
    not_loaded("indian-pines", "no label map beside it", "Indian_pines_gt")
    (pines / f"{PINES.CUBE}{ending}").unlink()
    monkeypatch.setattr(catalog, "find_spec", lambda name: None)
    not_loaded("indian-pines", "pip install", f"{PINES.CUBE}.mat and", "DEEPFSI_DATA")


def test_the_copy_in_tensorly_is_restored(tmp_path, monkeypatch):
    """Few values stick out once restored, and it is the cube that all figures are of."""
    tensorly = pytest.importorskip("tensorly")
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    real = load_indian_pines()
    assert real.cube.shape == (145, 145, 200)
    assert (real.cube.min(), real.cube.max()) == (955, 9604)
    counts = np.bincount(real.labels.ravel())
    assert (counts[1:].sum(), counts[1], counts[9], counts[11]) == (10_249, 46, 20, 2455)
    path = Path(tensorly.__file__).parent / "datasets" / "data" / f"{PINES.CUBE}.npy"
    lost, cube = np.load(path).astype(int), real.cube.astype(int)
    dips = [(2 * each[..., 12] - each[..., 11] - each[..., 13] < -1000) for each in (lost, cube)]
    assert dips[0].sum() > 1000
    assert dips[1].sum() < 20
    assert set(np.unique(cube - lost)) == {0, 768}
    wanted = "3c39e3746be7f26c6cbd54fa6570201170dd17bd3c82199eaa51ecf4d607f032"
    assert hashlib.sha256(real.cube.tobytes()).hexdigest() == wanted
