"""MNIST and Fashion-MNIST: the original gzipped idx files, checked by their hashes."""

import gzip
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from deepfsi.datasets.arrays import Range, assemble
from deepfsi.datasets.dataset import Dataset, Reflectance
from deepfsi.datasets.store import FileCheck, check_files, find_folder, whole_files

IDX_FILES = (
    "train-images-idx3-ubyte.gz",
    "train-labels-idx1-ubyte.gz",
    "t10k-images-idx3-ubyte.gz",
    "t10k-labels-idx1-ubyte.gz",
)
"""Names of the files: training images and labels, test images and labels."""


class Original(NamedTuple):
    """A data set in MNIST's idx format, as its authors publish it."""

    classes: tuple[str, ...]
    mirrors: tuple[str, ...]
    hashes: tuple[str, ...]  # "algorithm:hex" of each of IDX_FILES


ORIGINALS = {
    # Y. LeCun, L. Bottou, Y. Bengio, P. Haffner, "Gradient-based learning applied to document
    # recognition", Proc. IEEE 86(11), 1998
    "mnist": Original(
        classes=tuple("0123456789"),
        mirrors=(
            "https://ossci-datasets.s3.amazonaws.com/mnist/",
            "https://storage.googleapis.com/cvdf-datasets/mnist/",
        ),
        hashes=(
            "sha256:440fcabf73cc546fa21475e81ea370265605f56be210a4024d2ca8f203523609",
            "sha256:3552534a0a558bbed6aed32b30c495cca23d567ec52cac8be1a0730e8010255c",
            "sha256:8d422c7b0a1c1c79245a5bcf07fe86e33eeafee792b84584aec276f5a2dbc4e6",
            "sha256:f7ae60f92e00ec6debd23a6088c31dbd2371eca3ffa0defaefb259924204aec6",
        ),
    ),
    # H. Xiao, K. Rasul, R. Vollgraf, "Fashion-MNIST: a novel image dataset for benchmarking
    # machine learning algorithms", arXiv:1708.07747, 2017
    # its "T-shirt/top" has no slash here, as classes are names of folders
    "fashion-mnist": Original(
        classes=(
            *("T-shirt or top", "Trouser", "Pullover", "Dress", "Coat"),
            *("Sandal", "Shirt", "Sneaker", "Bag", "Ankle boot"),
        ),
        mirrors=(
            "http://fashion-mnist.s3-website.eu-central-1.amazonaws.com/",
            "https://github.com/zalandoresearch/fashion-mnist/raw/master/data/fashion/",
        ),
        hashes=(
            "md5:8d4fb7e6c68d591d4c3dfef9ec88bf0d",
            "md5:25c81989df183df01b3e8a0aad5dffbe",
            "md5:bef4ecab320f06d8554ea6380940ec79",
            "md5:bb300cfdad3c16e7a12a480ee83cd310",
        ),
    ),
}


def load_idx(name: str, rescale: Range) -> Dataset:
    """Load the original in its own split and order, framed to 32x32."""
    folder = download(name)
    images, labels, images_test, labels_test = (_read_idx(folder / file) for file in IDX_FILES)
    return assemble(
        name,
        (_framed(images), labels.astype(np.int64)),
        (_framed(images_test), labels_test.astype(np.int64)),
        classes=ORIGINALS[name].classes,
        values="Padded from 28x28 to 32x32 with black, divided by 255",
        rescale=rescale,
    )


def _framed(images: npt.NDArray[np.uint8]) -> Reflectance:
    """Images (n, 28, 28) as reflectance (n, 32, 32)."""
    return np.divide(np.pad(images, ((0, 0), (2, 2), (2, 2))), 255, dtype=np.float32)


def _read_idx(path: Path) -> npt.NDArray[np.uint8]:
    """Bytes of a gzipped idx file: the fourth says how many lengths follow, then the array."""
    content = gzip.decompress(path.read_bytes())
    start = 4 + 4 * content[3]
    lengths = np.frombuffer(content[4:start], ">u4")
    return np.frombuffer(content, np.uint8, offset=start).reshape(lengths)


def _hashes(name: str) -> dict[str, str]:
    return dict(zip(IDX_FILES, ORIGINALS[name].hashes, strict=True))


def where(name: str) -> Path | None:
    """First folder that has all four files."""
    return find_folder(name, IDX_FILES)


def check(name: str) -> list[FileCheck]:
    """Compare the four files with their hashes."""
    return check_files(name, _hashes(name))


def download(name: str) -> Path:
    """Folder of the four files, downloaded where they are missing, all whole."""
    return whole_files(name, _hashes(name), ORIGINALS[name].mirrors)
