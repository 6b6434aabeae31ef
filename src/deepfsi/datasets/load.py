"""A name, a path or arrays: `load_dataset` finds out which, and the module that reads it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from deepfsi.datasets import cifar, idx, indian_pines
from deepfsi.datasets.arrays import Range, from_arrays, load_npz, split_arrays
from deepfsi.datasets.catalog import CIFAR, NAMES
from deepfsi.datasets.cubes import SUFFIXES, read_cube
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.pictures import load_pictures
from deepfsi.datasets.spectra import SpectralImage
from deepfsi.errors import InputError, closest

DIM_BLACK = (0.3, 1.0)  # black still reflects, so that every pixel sends photons


def load_dataset(
    source: str | os.PathLike[str] | tuple[Any, ...],
    *,
    size: int | tuple[int, int] | None = None,
    seed: int = 0,
    rescale: Range | None = None,
    images: int | None = None,
    split: str | None = None,
) -> Dataset:
    """Load a data set by its name, from a path, or from arrays.

    Parameters
    ----------
    source
        One of

        - ``"digits"`` (8x8, embedded in scikit-learn), ``"mnist"`` or ``"fashion-mnist"`` (32x32):
          the original files, found in ``$DEEPFSI_DATA/NAME/`` or else downloaded once;
        - ``"cifar10"`` (32x32, grey): the official binary or Python archive, or the unpacked
          ``cifar-10-batches-bin/``, found in ``$DEEPFSI_DATA/cifar10/`` or ``$DEEPFSI_DATA``, or
          else downloaded once; ``"cifar10-jpeg"``: its images decoded from lossy JPEG, from
          ``$DEEPFSI_DATA/cifar10/cifar10-jpeg.zip``;
        - ``"indian-pines"`` (220 bands), ``"indian-pines-corrected"`` (200 bands): the ``.mat``
          files in ``$DEEPFSI_DATA/indian_pines/``, each labelled pixel a scene, padded with
          darkness to 256 bands; ``"indian-pines-surrogate"``: the same with simulated spectra, from
          ``Indian_pines_gt.mat`` and ``92AV3C.spc`` there;
        - the path of a folder or ``.zip`` file with one sub-folder of images for each class, or
          with such folders within its own ``train/`` and ``test/`` (anything else beside those two
          is ignored). Images are turned to grey; of an animation the first frame is used;
        - the path of a hyperspectral cube (``.mat``, ``.npy`` or ENVI's ``.hdr``), whose label map
          lies beside it under the same name with ``_gt`` added, as in `read_cube`;
        - the path of an ``.npz`` file with `x`, `y` and, if it has its own test part, `x_test`,
          `y_test`, as in `from_arrays`;
        - a tuple ``(x, y)`` or ``(x, y, x_test, y_test)`` of arrays, as in `from_arrays`.

        A name goes before a folder of that name: write ``./mnist`` for the folder.
    size
        Side, or (H, W), in pixels, to which images are brought: those of a folder or zip file by
        averaging over areas, CIFAR-10's bilinearly. Needed where they differ in size.
    seed
        Draws the test part where the source has none, the order of the training scenes and the
        `images` to keep, 0 .. 2**32 - 1. MNIST and Fashion-MNIST keep their own split and order,
        known to be random.
    rescale
        (low, high) to which [0, 1] is mapped. By default (0.3, 1) for digits, MNIST and
        Fashion-MNIST, no change for others; (0, 1) is no change for all.
    images
        How many training images to keep of CIFAR-10, or of a folder or zip file with its own test
        part: drawn with the seed, of each class its share. By default all: at 64x64 the whole of
        CIFAR-10 takes 1 GB, and twice that while it is loaded.
    split
        For hyperspectral images ``"random"`` (default) or ``"blocks"``, as in
        `SpectralImage.parts`.

    Returns
    -------
    Dataset

    Raises
    ------
    InputError
        If `source` is unknown, missing, damaged or cannot be downloaded; if its scenes are not
        reflectance in [0, 1], differ in shape or are all dark; if there are fewer than two classes
        or too few scenes in one; or if an option cannot be used.
    """
    name = "arrays" if isinstance(source, tuple) else os.fspath(source)
    path = None if isinstance(source, tuple) or name in NAMES else _existing(name)
    pictures = name in CIFAR or (
        path is not None and (path.is_dir() or path.suffix.lower() == ".zip")
    )
    spectra = name in indian_pines.SOURCES or (path is not None and path.suffix in SUFFIXES)
    if not pictures:
        _refuse(size, "a size", name, "images of a folder, a zip file or CIFAR-10 take")
        _refuse(images, "a number of images", name, "a folder, a zip file or CIFAR-10 takes")
    if not spectra:
        _refuse(split, "a split", name, "a hyperspectral image takes")

    if isinstance(source, tuple):
        if len(source) not in (2, 4):
            raise InputError(
                f"a tuple of {len(source)} arrays was given; give (x, y) or (x, y, x_test, y_test)"
            )
        return from_arrays(*source, seed=seed, rescale=rescale)
    if spectra:
        bands = indian_pines.BANDS if path is None else None
        return load_spectra(source).dataset(split or "random", seed, bands, rescale)
    if path is not None:
        if pictures:
            return load_pictures(path, size, seed, rescale, images)
        return load_npz(path, seed, rescale)
    if name in CIFAR:
        return cifar.load(name, size, seed, rescale, images)
    if name == "digits":
        return _load_digits(seed, rescale or DIM_BLACK)
    return idx.load(name, rescale or DIM_BLACK)


def load_spectra(source: str | os.PathLike[str]) -> SpectralImage:
    """Load a hyperspectral image with its label map, as a whole: for maps and overviews.

    Parameters
    ----------
    source
        One of the names that begin with ``indian-pines``, or the path of a cube, as in
        `load_dataset`.

    Returns
    -------
    SpectralImage
        Its `dataset` makes the scenes that `load_dataset` gives.

    Raises
    ------
    InputError
        As `load_dataset`.
    """
    name = os.fspath(source)
    if name in indian_pines.SOURCES:
        return indian_pines.load_scene(name)
    return read_cube(_existing(name))


def _existing(name: str) -> Path:
    path = Path(name).expanduser()
    if name and path.exists():
        return path
    if path.suffix or len(path.parts) > 1:
        raise InputError(
            f"there is no folder and no file at '{name}': give a folder or .zip of images, a cube "
            f"({', '.join(SUFFIXES)}) or an .npz file"
        )
    raise InputError(
        f"unknown data set '{name}': {closest(name, NAMES)}; "
        "or the path of a folder of images, a .zip of them, a cube or an .npz file"
    )


def _refuse(option: object, what: str, name: str, who: str) -> None:
    if option is not None:
        raise InputError(f"{Path(name).name}: {what} was given; only {who} one, leave it out")


def _load_digits(seed: int, rescale: Range) -> Dataset:
    from sklearn.datasets import load_digits

    digits = load_digits()
    return split_arrays(
        digits.images / 16,
        digits.target,
        name="digits",
        seed=seed,
        rescale=rescale,
        values="Divided by 16",
    )
