"""Data sets that have a name: download, check of their files, and loading.

- ``digits``: 8x8, embedded in scikit-learn;
- ``mnist``, ``fashion-mnist``: padded to 32x32; the original gzipped idx files, found in
  ``$DEEPFSI_DATA/NAME/`` or else downloaded once;
- ``cifar10``: 32x32, grey; the official binary archive, found in ``$DEEPFSI_DATA/cifar10/`` or
  else downloaded once. At 64x64 the whole of it takes 1 GB, and twice that while it is loaded;
- ``indian-pines``: 200 of 220 bands, each labelled pixel a scene, padded with darkness to 256
  bands; the corrected cube and its label map in ``$DEEPFSI_DATA/indian_pines/`` or in the package
  ``tensorly``.
"""

import gzip
import hashlib
import itertools
import os
import tarfile
import tomllib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from importlib.resources import as_file, files
from importlib.util import find_spec
from pathlib import Path
from typing import ClassVar, cast
from urllib.parse import urlsplit

import numpy as np
import numpy.typing as npt

from deepfsi.base.errors import InputError
from deepfsi.datasets.arrays import assemble, draw_stratified, split_arrays
from deepfsi.datasets.dataset import Dataset, Ends, Origin
from deepfsi.datasets.spectra import CUBE_ENDINGS, SpectralImage, read_cube

DIM_BLACK = (0.3, 1.0)
"""Reflectance of black and white in named images: black reflects, so that every pixel counts."""


def _data_folders(name: str) -> list[Path]:
    """Folders where the files of a data set may be, the user's before the cache."""
    import pooch

    cache = Path(pooch.os_cache("deepfsi")) / name
    root = os.environ.get("DEEPFSI_DATA")
    if not root:
        return [cache]
    if not Path(root).is_dir():
        raise InputError(f"DEEPFSI_DATA is '{root}', which is no folder; correct or unset it")
    return [Path(root) / name, cache]


@dataclass
class NamedDataset(ABC):
    """A data set that has a name."""

    name: str
    classes: tuple[str, ...]
    folder: str = ""  # name of the folder of its files
    hashes: dict[str, str] = field(default_factory=dict)  # hash of each file, "algorithm:hex"
    mirrors: Sequence[str] = ()  # addresses of folders that have the files
    options: ClassVar[tuple[str, ...]] = ()
    ends: ClassVar[Ends] = (0.0, 1.0)  # reflectance of black and white, unless another is asked for

    def __post_init__(self) -> None:
        self.classes = tuple(self.classes)

    @abstractmethod
    def load(self, options: Origin) -> Dataset:
        """Load it."""

    def download(self) -> Path:
        """Folder of the files; missing or damaged ones are downloaded to the cache."""
        import pooch

        *users, cache = _data_folders(self.folder)
        complete = (all((user / file).is_file() for file in self.hashes) for user in users)
        folder = next(itertools.compress(users, complete), cache)
        for file, expected in self.hashes.items():
            # A user's file is never replaced
            if folder != cache and not pooch.hashes.hash_matches(folder / file, expected):
                raise InputError(f"{folder / file} is damaged: replace it with the original")
            for mirror in self.mirrors:
                with suppress(OSError, ValueError):  # no connection, no such file; wrong hash
                    pooch.retrieve(mirror + file, expected, file, folder)
                    break
            else:
                hosts = " or ".join(urlsplit(mirror).netloc for mirror in self.mirrors)
                raise InputError(
                    f"{self.name}: cannot download {file} from {hosts}; try again, or put the "
                    f"original files into a folder {self.folder} and set DEEPFSI_DATA to the "
                    "folder that holds it"
                )
        return folder


class Digits(NamedDataset):
    """The digits of scikit-learn, which have no files."""

    ends = DIM_BLACK

    def load(self, options: Origin) -> Dataset:
        """Load them; a fifth is drawn for testing."""
        from sklearn.datasets import load_digits

        digits = load_digits()
        return split_arrays(
            (digits.images / 16, digits.target),
            name=self.name,
            seed=options.seed,
            rescale=options.rescale or self.ends,
            described="Divided by 16",
        )


class IdxImages(NamedDataset):
    """MNIST or Fashion-MNIST: the original gzipped idx files, framed to 32x32."""

    FRAME = ((0, 0), (2, 2), (2, 2))  # pixels in front of and behind each axis
    options = ("images",)
    ends = DIM_BLACK

    def load(self, options: Origin) -> Dataset:
        """Load the original in its own split and order."""
        folder = self.download()
        images, labels, images_test, labels_test = (_read_idx(folder / f) for f in self.hashes)
        kept, drawn = draw_stratified(labels, options.images, options.seed, self.name)
        images = images[kept]
        labels = labels[kept]
        train, test = (
            (np.divide(np.pad(x, self.FRAME), 255, dtype=np.float32), y.astype(np.int64))
            for x, y in ((images, labels), (images_test, labels_test))
        )
        # Not shuffled: the files are in random order, and records name the data by a hash of it
        return assemble(
            self.name,
            train,
            test,
            classes=self.classes,
            described=f"{drawn}Padded from 28x28 to 32x32 with black, divided by 255",
            rescale=options.rescale or self.ends,
        )


def _read_idx(path: Path) -> npt.NDArray[np.uint8]:
    """Array of a gzipped idx file: byte 3 is its number of axes; lengths and values follow."""
    content = gzip.decompress(path.read_bytes())
    start = 4 + 4 * content[3]
    lengths = np.frombuffer(content[4:start], ">u4")
    return np.frombuffer(content, np.uint8, offset=start).reshape(lengths)


class _Cifar10(NamedDataset):
    """CIFAR-10 in grey: the official binary archive."""

    BATCHES = (*(f"data_batch_{i}.bin" for i in range(1, 6)), "test_batch.bin")
    options = ("size", "images")

    def load(self, options: Origin) -> Dataset:
        """Load it in its own split; the training part is shuffled."""
        [archive_name] = self.hashes
        with tarfile.open(self.download() / archive_name, "r:gz") as archive:
            contents = {
                Path(member.name).name: file.read()
                for member in archive
                if (file := archive.extractfile(member)) is not None
            }
        # Records of a label, then all reds, all greens and all blues
        *train_parts, test = (
            np.frombuffer(contents[name], np.uint8).reshape(-1, 3073) for name in self.BATCHES
        )
        train = np.concatenate(train_parts)
        kept, drawn = draw_stratified(train[:, 0], options.images, options.seed, "CIFAR-10")
        train = train[kept]
        height, width = options.size or (32, 32)
        sized = f", resized bilinearly to {height}x{width} pixels" if options.size else ""
        return split_arrays(
            (_grey_pictures(train, height, width), train[:, 0]),
            (_grey_pictures(test, height, width), test[:, 0]),
            classes=self.classes,
            name="CIFAR-10",
            seed=options.seed,
            rescale=options.rescale,
            described=f"{drawn}Colours turned to grey{sized}, divided by 255",
        )


def _grey_pictures(
    records: npt.NDArray[np.uint8], height: int, width: int
) -> npt.NDArray[np.uint8]:
    """Grey pictures (n, H, W) of records (n, 3073), a label before three planes of colour."""
    from PIL import Image

    out = np.empty((len(records), height, width), np.uint8)
    for index, colours in enumerate(records[:, 1:].reshape(-1, 3, 32, 32)):
        grey = Image.fromarray(np.ascontiguousarray(colours.transpose(1, 2, 0))).convert("L")
        out[index] = np.asarray(grey.resize((width, height), Image.Resampling.BILINEAR))
    return out


class _IndianPines(NamedDataset):
    """Indian Pines: the scene of the AVIRIS spectrometer, without the bands of water vapour.

    The corrected cube of the Grupo de Inteligencia Computacional, UPV/EHU, has 200 of its 220
    bands; the paper counts AVIRIS's 224. The cube is padded with darkness to 256 bands, as the
    paper pads its own.

    The copy in the package ``tensorly`` (BSD 3-Clause) was once transferred as a text: every byte
    13, a carriage return, became 10, a line feed. None of its 8.4 million bytes is 13. A high byte
    that changed took 768 from a value.
    """

    CUBE = "Indian_pines_corrected"  # name of the file, .npy or .mat; the label map has _gt
    # SHA-256 of the values of a cube that has lost its bytes
    LOST = "36468dd7336c8bd37a80cced54362ea426f226703f3797ba494556fd8134e77f"
    options = ("split",)

    def find(self) -> Path | None:
        """File of the cube in the first folder that has it, of data sets or of the package."""
        spec = find_spec("tensorly")
        installed = spec.submodule_search_locations if spec else None
        folders = [
            *_data_folders(self.folder),
            *(Path(package, "datasets", "data") for package in installed or ()),
        ]
        files = [folder / f"{self.CUBE}{end}" for folder in folders for end in CUBE_ENDINGS]
        return next(filter(Path.is_file, files), None)

    def load(self, options: Origin) -> Dataset:
        """Load its labelled pixels."""
        return self.scene().dataset(options.split, options.seed, 256, options.rescale)

    def scene(self) -> SpectralImage:
        """Whole image."""
        path = self.find()
        if not path:
            raise InputError(
                f"{self.name} is not here: pip install tensorly, which contains it; or put "
                f"{self.CUBE}.mat and Indian_pines_gt.mat into a folder {self.folder}, and set "
                "DEEPFSI_DATA to the folder that holds it"
            )
        words = "Radiance as published, 200 of 220 bands,"
        scene = read_cube(path, name=self.name, classes=self.classes, origin=words)
        cube = scene.cube.astype(np.uint16)
        if hashlib.sha256(cube.tobytes()).hexdigest() != self.LOST:
            return scene
        restored = _restore_high_bytes(cube)
        return replace(scene, cube=restored, origin=f"{words[:-1]} with its lost bytes restored,")


def _restore_high_bytes(cube: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
    """The cube (H, W, B) with the high bytes 13 that became 10."""
    # A bit for each byte 10, band by band, tells whether it was 13. It was predicted from the other
    # bands of the pixel, by `restore_high_bytes` as last in commit fc7d6b34
    with as_file(files(__package__) / "indian_pines.npz") as path, np.load(path) as arrays:
        lost = np.unpackbits(arrays["lost"])
    bands = np.moveaxis(cube, 2, 0).copy()
    unsure = bands >> 8 == 10
    # 768 is 13 − 10 in the high byte
    bands[unsure] += lost[: np.count_nonzero(unsure)] * np.uint16(768)
    return np.ascontiguousarray(np.moveaxis(bands, 0, 2))


_KINDS: dict[str, type[NamedDataset]] = {
    "digits": Digits,
    "mnist": IdxImages,
    "fashion-mnist": IdxImages,
    "cifar10": _Cifar10,
    "indian-pines": _IndianPines,
}

_FACTS = tomllib.loads(files(__package__).joinpath("originals.toml").read_text("utf-8"))

DATASETS = {name: kind(name, **_FACTS[name]) for name, kind in _KINDS.items()}
"""Data sets by their names."""


def load_indian_pines() -> SpectralImage:
    """Whole image of Indian Pines, for maps and overviews."""
    return cast(_IndianPines, DATASETS["indian-pines"]).scene()
