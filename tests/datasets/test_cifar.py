"""CIFAR-10 in each of its forms gives the same scenes, and a hostile pickle gives an error."""

from __future__ import annotations

import gzip
import hashlib
import io
import os
import pickle
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pooch
import pytest
from PIL import Image

from deepfsi.datasets import check, cifar, download, list_datasets, load_dataset
from deepfsi.datasets.pickles import read_batch
from deepfsi.errors import InputError

DATA = Path(os.environ.get("DEEPFSI_DATA") or ".") / "cifar10"
BATCH = 20

RECORDS = np.random.default_rng(8).integers(0, 256, (6, BATCH, 3073), dtype=np.uint8)
RECORDS[..., 0] = np.arange(BATCH) % 10
RECORDS[0, :, 0] = RECORDS[0, ::-1, 0]
BINARY = {
    f"{name}.bin": records.tobytes() for name, records in zip(cifar.BATCHES, RECORDS, strict=True)
}


def python_2_pickle(records: npt.NDArray[np.uint8]) -> bytes:
    """A batch as the official archive has it: protocol 2, with Python 2's strings."""

    def string(content: bytes) -> bytes:
        return b"T" + len(content).to_bytes(4, "little") + content

    def number(value: int) -> bytes:
        return b"J" + value.to_bytes(4, "little", signed=True)

    n = len(records)
    dtype = b"cnumpy\ndtype\n(" + string(b"u1") + number(0) + number(1) + b"tR("
    dtype += number(3) + string(b"|") + b"NNN" + number(-1) + number(-1) + number(0) + b"tb"
    array = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(" + number(0) + b"t"
    array += string(b"b") + b"tR(" + number(1) + b"(" + number(n) + number(3072) + b"t" + dtype
    array += b"I00\n" + string(records[:, 1:].tobytes()) + b"tb"
    labels = b"](" + b"".join(number(int(label)) for label in records[:, 0]) + b"e"
    return (
        b"\x80\x02}("
        + (string(b"batch_label") + string(b"training batch 1 of 5"))
        + (string(b"labels") + labels)
        + (string(b"data") + array)
        + (string(b"filenames") + b"]" + b"u.")
    )


PYTHON = {
    name: python_2_pickle(records) for name, records in zip(cifar.BATCHES, RECORDS, strict=True)
}


def archive(contents: dict[str, bytes], folder: str) -> bytes:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as file:
        for name, content in {"readme.html": b"<html>", **contents}.items():
            info = tarfile.TarInfo(f"{folder}/{name}")
            info.size = len(content)
            file.addfile(info, io.BytesIO(content))
    return packed.getvalue()


def one_line(error: pytest.ExceptionInfo[InputError], *parts: str) -> None:
    message = str(error.value)
    assert "\n" not in message
    for part in parts:
        assert part in message


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """$DEEPFSI_DATA/cifar10, empty; batches of twenty images; nothing can be downloaded."""
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    monkeypatch.setattr(pooch, "os_cache", lambda _: tmp_path / "cache")
    monkeypatch.setattr(cifar, "BATCH", BATCH)
    monkeypatch.setattr(cifar, "MIRRORS", ((tmp_path / "mirror").as_uri() + "/",))
    (tmp_path / "cifar10").mkdir()
    return tmp_path / "cifar10"


def put(home: Path, form: str, monkeypatch: pytest.MonkeyPatch, **spoilt: bytes) -> Path:
    """Put CIFAR-10 there in one of its forms, with the hash that goes with it."""
    if form == "unpacked":
        path = home / cifar.UNPACKED
        path.mkdir()
        for name, content in (BINARY | {f"{k}.bin": v for k, v in spoilt.items()}).items():
            (path / name).write_bytes(content)
        return path
    contents = (
        BINARY | {f"{k}.bin": v for k, v in spoilt.items()} if form == "binary" else PYTHON | spoilt
    )
    path = home / f"cifar-10-{form}.tar.gz"
    path.write_bytes(archive(contents, f"cifar-10-batches-{form[:3]}"))
    known = hashlib.md5(path.read_bytes()).hexdigest()
    monkeypatch.setitem(cifar.HASHES, path.name, f"md5:{known}")
    return path


def luma(records: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
    red, green, blue = records[:, 1:].reshape(-1, 3, 1024).transpose(1, 0, 2)
    return (0.299 * red + 0.587 * green + 0.114 * blue) / 255


@pytest.mark.parametrize("form", ["unpacked", "binary", "python"])
def test_every_form_gives_the_same_grey_scenes(
    home: Path, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = put(home, form, monkeypatch)
    data = load_dataset("cifar10")
    assert data.name == "CIFAR-10"
    assert data.classes[6] == "frog"
    assert data.image_shape == (32, 32)
    assert data.preprocessing == "Grey levels divided by 255."
    assert data.y_test.tolist() == RECORDS[5, :, 0].tolist()
    assert np.abs(data.x_test - luma(RECORDS[5])).max() < 0.51 / 255 + 1e-6
    train = RECORDS[:5].reshape(100, 3073)
    distance = np.abs(data.x_train[:, None] - luma(train)).max(axis=2)
    order = distance.argmin(axis=1)
    assert distance.min(axis=1).max() < 0.51 / 255 + 1e-6
    assert sorted(order) == list(range(100)) != order.tolist(), "shuffled"
    assert data.y_train.tolist() == train[order, 0].tolist()
    assert all(result.ok for result in check("cifar10"))
    assert download("cifar10") == path
    assert list_datasets()[3].where == str(path)


def test_size_is_bilinear_and_images_are_drawn_by_class(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(home, "unpacked", monkeypatch)
    data = load_dataset("cifar10", size=64, images=30)
    assert data.image_shape == (64, 64)
    assert np.bincount(data.y_train).tolist() == [3] * 10
    assert len(data.x_test) == 20
    assert data.preprocessing == (
        "30 training images drawn by class; grey levels, resized bilinearly to 64x64 pixels, "
        "divided by 255."
    )
    x = data.x_test.reshape(-1, 64, 64)
    plain = load_dataset("cifar10").x_test.reshape(-1, 32, 32)
    inside = 0.5625 * plain[:, 5, 5] + 0.1875 * (plain[:, 4, 5] + plain[:, 5, 4])
    assert np.abs(x[:, 10, 10] - inside - 0.0625 * plain[:, 4, 4]).max() < 1.01 / 255
    assert (
        load_dataset("cifar10", images=30).hash != load_dataset("cifar10", images=30, seed=1).hash
    )


def test_a_folder_of_batches_directly_in_deepfsi_data(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = put(home.parent, "unpacked", monkeypatch)
    assert download("cifar10") == path


def test_the_archive_is_downloaded_and_kept(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = put(home, "binary", monkeypatch).read_bytes()
    (home / "cifar-10-binary.tar.gz").unlink()

    def retrieve(url: str, known: str, name: str, path: Path, **_: Any) -> None:
        assert url.endswith("/cifar-10-binary.tar.gz")
        path.mkdir(parents=True)
        (path / name).write_bytes(whole)

    monkeypatch.setattr(pooch, "retrieve", retrieve)
    assert load_dataset("cifar10").x_train.shape == (100, 1024)
    kept = home.parent / "cache" / "cifar10" / "cifar-10-binary.tar.gz"
    assert download("cifar10") == kept


def test_published_hashes() -> None:
    assert cifar.HASHES == {
        "cifar-10-binary.tar.gz": "md5:c32a1d4ab5d03f1284b67883e8d87530",
        "cifar-10-python.tar.gz": "md5:c58f30108f718f92721af3b95e74349a",
    }


@pytest.mark.parametrize("form", ["binary", "python"])
def test_a_damaged_archive(home: Path, form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = put(home, form, monkeypatch)
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(InputError) as error:
        load_dataset("cifar10")
    one_line(error, str(path), "md5 is", "replace it with the original")
    assert not check("cifar10")[0].ok
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(InputError) as error:
        cifar._read(path)
    one_line(error, str(path), "replace it with the original")


def test_an_archive_that_lacks_a_batch(home: Path) -> None:
    path = home / "cifar-10-binary.tar.gz"
    path.write_bytes(archive({k: v for k, v in BINARY.items() if "5" not in k}, "a"))
    with pytest.raises(InputError) as error:
        cifar._read(path)
    one_line(error, str(path), "lacks data_batch_5")


def test_a_batch_of_another_size(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(home, "unpacked", monkeypatch, data_batch_2=BINARY["data_batch_2.bin"][:-1])
    with pytest.raises(InputError) as error:
        load_dataset("cifar10")
    one_line(error, "data_batch_2.bin", "61459 bytes, not 61460")
    assert [result.ok for result in check("cifar10")] == [True, False, True, True, True, True]
    (home / cifar.UNPACKED / "data_batch_2.bin").unlink()
    assert check("cifar10")[1].detail.startswith("missing")


def test_a_label_that_is_none(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = b"\x0a" + BINARY["test_batch.bin"][1:]
    put(home, "unpacked", monkeypatch, test_batch=wrong)
    with pytest.raises(InputError) as error:
        load_dataset("cifar10")
    one_line(error, "holds the label 10")


# ---------------------------------------------------------------- pickles


def test_pickles_that_this_python_writes() -> None:
    for protocol in (2, 3, 4):
        batch = {b"data": RECORDS[0, :, 1:].copy(), b"labels": RECORDS[0, :, 0].tolist()}
        if protocol == 2:  # bytes then need codecs.encode, which the official archive does not
            with pytest.raises(InputError):
                read_batch(pickle.dumps(batch, protocol), "a")
            continue
        pixels, labels = read_batch(pickle.dumps(batch, protocol), "a")
        assert np.array_equal(pixels, RECORDS[0, :, 1:])
        assert labels == RECORDS[0, :, 0].tolist()


class Call:
    """Calls something when it is unpickled."""

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self.call


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_hostile_pickles(tmp_path: Path, protocol: int) -> None:
    sprung = tmp_path / "sprung"
    traps = (
        Call(os.mkdir, str(sprung)),
        Call(eval, f"__import__('os').mkdir({str(sprung)!r})"),
        Call(np.memmap, str(sprung), "u1", "w+", 0, (4,)),
        Call(np.ndarray, (2**50,)),
        Call(getattr, "a", "upper"),
    )
    for trap in traps:
        for batch in ({b"data": trap, b"labels": []}, trap, {b"x": [trap]}):
            with pytest.raises(InputError) as error:
                read_batch(pickle.dumps(batch, protocol), "batch_1")
            one_line(error, "batch_1 is no batch of CIFAR-10", "replace it")
            assert not sprung.exists()


@pytest.mark.parametrize(
    "batch",
    [
        {b"data": np.zeros((2, 3072)), b"labels": [0, 1]},
        {b"data": np.full((2, 3072), None), b"labels": [0, 1]},
        {b"data": np.zeros((2, 3072), np.uint8, order="F"), b"labels": [0, 1]},
        {b"data": np.zeros((2, 3072), np.uint8), b"labels": [0]},
        {b"data": np.zeros((2, 3072), np.uint8), b"labels": [0, 0.5]},
        {b"data": np.zeros((2, 3072), np.uint8), b"labels": "ab"},
        {b"data": np.zeros((2, 9), np.uint8), b"labels": [0, 1]},
        {b"data": b"", b"labels": [0, 1]},
        {b"labels": [0, 1]},
        [1, 2],
    ],
)
def test_pickles_of_something_else(batch: object) -> None:
    with pytest.raises(InputError) as error:
        read_batch(pickle.dumps(batch, 4), "batch_1")
    one_line(error, "batch_1 is no batch")


@pytest.mark.parametrize("content", [b"", b"\x80\x02", PYTHON["data_batch_1"][:5000], b"GIF89a"])
def test_damaged_pickles(content: bytes) -> None:
    with pytest.raises(InputError) as error:
        read_batch(content, "batch_1")
    one_line(error, "batch_1 is no batch")


# ---------------------------------------------------------------- the copy in JPEG


def put_jpegs(home: Path, train: int, test: int) -> Path:
    path = home / cifar.JPEG_FILE
    with zipfile.ZipFile(path, "w") as file:
        for part, count in (("train", train), ("test", test)):
            for k, label in enumerate(cifar.CLASSES):
                for i in range(count):
                    image = io.BytesIO()
                    Image.new("RGB", (32, 32), (20 * k, i, 0)).save(image, "JPEG")
                    file.writestr(f"{part}/{label}/{i:04}.jpg", image.getvalue())
    return path


def test_the_copy_in_jpeg_says_so(home: Path) -> None:
    put_jpegs(home, 10, 2)
    data = load_dataset("cifar10-jpeg", images=40, size=(16, 16))
    assert data.name == "JPEG-decoded CIFAR-10"
    assert data.image_shape == (16, 16)
    assert np.bincount(data.y_train).tolist() == [4] * 10
    assert np.bincount(data.y_test).tolist() == [2] * 10
    assert data.classes == cifar.CLASSES
    level = 0.299 * 20 * data.y_test / 255
    assert np.abs(data.x_test - level[:, None]).max() < 4 / 255
    assert all(result.ok for result in check("cifar10-jpeg"))


def test_a_copy_in_jpeg_that_is_not_whole(home: Path) -> None:
    with pytest.raises(InputError) as error:
        load_dataset("cifar10-jpeg")
    one_line(error, "cifar10-jpeg is not here", "DEEPFSI_DATA")
    assert not check("cifar10-jpeg")[0].ok
    put_jpegs(home, 10, 1)
    with pytest.raises(InputError) as error:
        load_dataset("cifar10-jpeg")
    one_line(error, cifar.JPEG_FILE, "test folder does not hold 2 images of each of airplane")
    assert not check("cifar10-jpeg")[0].ok


# ---------------------------------------------------------------- the real files


@pytest.mark.skipif(not (DATA / cifar.JPEG_FILE).is_file(), reason="needs $DEEPFSI_DATA/cifar10")
def test_the_real_copy_in_jpeg() -> None:
    data = load_dataset("cifar10-jpeg", images=1000)
    assert data.x_train.shape == (1000, 1024)
    assert data.x_test.shape == (10_000, 1024)
    assert np.bincount(data.y_test).tolist() == [1000] * 10
    luma_mean = 0.299 * 0.4913 + 0.587 * 0.4821 + 0.114 * 0.4465
    assert data.x_train.mean(dtype=float) == pytest.approx(luma_mean, abs=0.03)


LOSSLESS = DATA / "cifar-10-train-first4000-lossless.bin.gz"


@pytest.mark.skipif(not LOSSLESS.is_file(), reason="needs $DEEPFSI_DATA/cifar10")
def test_real_records(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cifar, "BATCH", 4000)
    pixels, labels = cifar._read_batch(gzip.decompress(LOSSLESS.read_bytes()), "first.bin")
    assert labels[0] == 6
    image = pixels[0].reshape(3, 32, 32)
    assert image[:, 0, 0].tolist() == [59, 62, 63]
    assert image[:, 31, 31].tolist() == [123, 92, 72]
    assert np.bincount(labels)[:3].tolist() == [396, 366, 420]
