"""CIFAR-10 of its archive and of its copy in JPEG."""

import gzip
import hashlib
import io
import os
import tarfile
import zipfile
from collections import Counter
from pathlib import Path

import numpy as np
import pooch
import pytest
from dataset_samples import BATCH, BINARY, RECORDS, refused
from PIL import Image

from deepfsi.datasets import check, download, list_datasets, load_dataset
from deepfsi.datasets.catalog import DATASETS, CifarJpeg

CIFAR = DATASETS["cifar10"]
ARCHIVE = "cifar-10-binary.tar.gz"
DATA = Path(os.environ.get("DEEPFSI_DATA") or ".") / "cifar10"


def archive():
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as file:
        for name, content in {"readme.html": b"<html>", **BINARY}.items():
            info = tarfile.TarInfo(f"cifar-10-batches-bin/{name}")
            info.size = len(content)
            file.addfile(info, io.BytesIO(content))
    return packed.getvalue()


@pytest.fixture
def home(tmp_path, monkeypatch):
    """$DEEPFSI_DATA/cifar10, empty; batches of twenty images; nothing can be downloaded."""
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    monkeypatch.setattr(pooch, "os_cache", lambda _: tmp_path / "cache")
    monkeypatch.setattr(CifarJpeg, "PARTS", {"train": BATCH // 2, "test": BATCH // 10})
    monkeypatch.setattr(CIFAR, "mirrors", ((tmp_path / "mirror").as_uri() + "/",))
    (tmp_path / "cifar10").mkdir()
    return tmp_path / "cifar10"


def put(home, monkeypatch):
    """Put the archive there, with the hash that goes with it."""
    path = home / ARCHIVE
    path.write_bytes(archive())
    known = hashlib.md5(path.read_bytes()).hexdigest()
    monkeypatch.setitem(CIFAR.hashes, path.name, f"md5:{known}")
    return path


def luma(records):
    red, green, blue = records[:, 1:].reshape(-1, 3, 1024).transpose(1, 0, 2)
    return (0.299 * red + 0.587 * green + 0.114 * blue) / 255


def test_the_archive_gives_grey_scenes(home, monkeypatch):
    put(home, monkeypatch)
    data = load_dataset("cifar10")
    assert data.name == "CIFAR-10"
    assert data.classes[6] == "frog"
    assert data.image_shape == (32, 32)
    told = "120 images of 32x32 pixels, 120 in colour, turned to grey; 8-bit values from "
    assert data.preprocessing.startswith(told)
    assert data.preprocessing.endswith(", divided by 255.")
    assert data.y_test.tolist() == RECORDS[5, :, 0].tolist()
    assert np.abs(data.x_test - luma(RECORDS[5])).max() < 0.51 / 255 + 1e-6
    train = RECORDS[:5].reshape(100, 3073)
    distance = np.abs(data.x_train[:, None] - luma(train)).max(axis=2)
    order = distance.argmin(axis=1)
    assert distance.min(axis=1).max() < 0.51 / 255 + 1e-6
    assert sorted(order) == list(range(100)) != order.tolist(), "shuffled"
    assert data.y_train.tolist() == train[order, 0].tolist()
    assert all(result.ok for result in check("cifar10"))
    assert download("cifar10") == home
    assert list_datasets()[3].where == str(home)


def test_size_is_bilinear_and_images_are_drawn_by_class(home, monkeypatch):
    put(home, monkeypatch)
    data = load_dataset("cifar10", size=64, images=30)
    assert data.image_shape == (64, 64)
    assert np.bincount(data.y_train).tolist() == [3] * 10
    assert len(data.x_test) == 20
    assert data.preprocessing.startswith("30 training images drawn by class; 50 images of 32x32")
    assert "in colour, turned to grey, resized bilinearly to 64x64 pixels; 8-bit" in (
        data.preprocessing
    )
    x = data.x_test.reshape(-1, 64, 64)
    plain = load_dataset("cifar10").x_test.reshape(-1, 32, 32)
    inside = 0.5625 * plain[:, 5, 5] + 0.1875 * (plain[:, 4, 5] + plain[:, 5, 4])
    assert np.abs(x[:, 10, 10] - inside - 0.0625 * plain[:, 4, 4]).max() < 1.01 / 255
    assert (
        load_dataset("cifar10", images=30).hash != load_dataset("cifar10", images=30, seed=1).hash
    )


def test_the_archive_is_downloaded_and_kept(home, monkeypatch):
    whole = put(home, monkeypatch).read_bytes()
    (home / ARCHIVE).unlink()

    def retrieve(url, known, name, path, **_):
        assert url.endswith("/cifar-10-binary.tar.gz")
        path.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(whole)

    monkeypatch.setattr(pooch, "retrieve", retrieve)
    assert load_dataset("cifar10").x_train.shape == (100, 1024)
    assert download("cifar10") == home.parent / "cache" / "cifar10"


def test_published_hash():
    known = "md5:c32a1d4ab5d03f1284b67883e8d87530"
    assert {"cifar-10-binary.tar.gz": known} == CIFAR.hashes


def test_a_damaged_archive(home, monkeypatch):
    path = put(home, monkeypatch)
    path.write_bytes(path.read_bytes()[:-9])
    with refused(str(path), "md5 is", "replace it with the original"):
        load_dataset("cifar10")
    assert not check("cifar10")[0].ok


def put_jpegs(home, train, test):
    path = home / CifarJpeg.FILE
    with zipfile.ZipFile(path, "w") as file:
        for part, count in (("train", train), ("test", test)):
            for k, label in enumerate(CIFAR.classes):
                for i in range(count):
                    image = io.BytesIO()
                    Image.new("RGB", (32, 32), (20 * k, i, 0)).save(image, "JPEG")
                    file.writestr(f"{part}/{label}/{i:04}.jpg", image.getvalue())
    return path


def test_the_copy_in_jpeg_says_so(home):
    put_jpegs(home, 10, 2)
    data = load_dataset("cifar10-jpeg", images=40, size=(16, 16))
    assert data.name == "JPEG-decoded CIFAR-10"
    assert data.image_shape == (16, 16)
    assert np.bincount(data.y_train).tolist() == [4] * 10
    assert np.bincount(data.y_test).tolist() == [2] * 10
    assert data.classes == CIFAR.classes
    level = 0.299 * 20 * data.y_test / 255
    assert np.abs(data.x_test - level[:, None]).max() < 4 / 255
    assert all(result.ok for result in check("cifar10-jpeg"))


def test_a_copy_in_jpeg_that_is_not_whole(home):
    with refused("cifar10-jpeg is not here", "DEEPFSI_DATA"):
        load_dataset("cifar10-jpeg")
    assert not check("cifar10-jpeg")[0].ok
    put_jpegs(home, 10, 1)
    with refused(CifarJpeg.FILE, "test folder does not hold 2 images of each of airplane"):
        load_dataset("cifar10-jpeg")
    assert not check("cifar10-jpeg")[0].ok


@pytest.mark.skipif(not (DATA / CifarJpeg.FILE).is_file(), reason="needs $DEEPFSI_DATA/cifar10")
def test_the_real_copy_in_jpeg():
    data = load_dataset("cifar10-jpeg", images=1000)
    assert data.x_train.shape == (1000, 1024)
    assert data.x_test.shape == (10_000, 1024)
    assert np.bincount(data.y_test).tolist() == [1000] * 10
    luma_mean = 0.299 * 0.4913 + 0.587 * 0.4821 + 0.114 * 0.4465
    assert data.x_train.mean(dtype=float) == pytest.approx(luma_mean, abs=0.03)


LOSSLESS = DATA / "cifar-10-train-first4000-lossless.bin.gz"


@pytest.mark.skipif(not LOSSLESS.is_file(), reason="needs $DEEPFSI_DATA/cifar10")
def test_real_records():
    """The first training image, a frog, and the colours of its corners."""
    pictures = CIFAR.pictures(gzip.decompress(LOSSLESS.read_bytes()), "first")
    assert pictures[0].label == "frog"
    image = np.asarray(Image.open(pictures[0].open()))
    assert image[0, 0].tolist() == [59, 62, 63]
    assert image[31, 31].tolist() == [123, 92, 72]
    labels = Counter(picture.label for picture in pictures)
    assert [labels[name] for name in CIFAR.classes[:3]] == [396, 366, 420]
