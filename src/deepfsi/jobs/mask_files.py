"""A user's own masks: an array, a MATLAB variable or a stack of images becomes a sensing matrix."""

import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from deepfsi.base.arrays import read_array, split_variable
from deepfsi.base.errors import InputError
from deepfsi.base.files import check_unpacked, open_regular
from deepfsi.datasets.levels import PICTURE_FORMATS, check_depth

IMAGES = (".png", ".tif", ".tiff", ".bmp", ".pgm", ".gif")
"""Ends of the names of image files that lose nothing."""


LARGEST = 2**28
"""Values of a matrix at most: a small file may claim more than memory holds."""

WAYS = (
    "a .npy file, or a .mat file with one numeric variable (or FILE:VARIABLE), of shape "
    "(m, N) or (m, H, W), a folder of images, or a TIFF of m pages"
)
"""All that can be read, as the end of an error message."""


def read_matrix(source: str) -> np.ndarray:
    """Read masks from a file or a folder."""
    path, variable = split_variable(source)
    if not path.exists():
        raise InputError(f"no matrix at {path}: give {WAYS}")
    if path.is_dir() or path.suffix.lower() in IMAGES:
        masks = _read_images(path)
    else:
        masks = read_array(path, (2, 3), variable, largest=LARGEST)
    if masks.ndim not in (2, 3) or not masks.size:
        raise InputError(f"{path} holds an array of shape {masks.shape}: give {WAYS}")
    if masks.dtype.kind in "bu" and masks.dtype.itemsize <= 2:  # levels, the last of all light
        full = 1 if masks.max() <= 1 else int(np.iinfo(masks.dtype).max)
        masks = masks / (full * len(masks))
    return masks.reshape(len(masks), -1)


def _read_images(path: Path) -> np.ndarray:
    files = [path]
    if path.is_dir():
        files = sorted(
            file
            for file in path.iterdir()
            if file.suffix.lower() in IMAGES and not file.name.startswith(".")
        )
    if not files:
        raise InputError(f"no images in {path}: give some ({' '.join(IMAGES)}), a mask each")
    masks: list[np.ndarray] = []
    for file in files:
        for page in _pages(file):
            if masks and (page.shape, page.dtype) != (masks[0].shape, masks[0].dtype):
                raise InputError(
                    f"images differ: {file} has {_kind(page)}, {files[0]} {_kind(masks[0])}: bring "
                    "them to one size and kind"
                )
            if page.size * (len(masks) + 1) > LARGEST:
                raise InputError(f"{path} holds more than {LARGEST} pixels: give fewer")
            masks.append(page)
    return np.stack(masks)


def _kind(page: np.ndarray) -> str:
    return f"{page.shape[0]}x{page.shape[1]} pixels of {page.dtype}"


def _pages(file: Path) -> Iterator[np.ndarray]:
    """Every page of an image as (H, W), in the levels of its file."""
    from PIL import Image, ImageSequence

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            opened = open_regular(file, 2**31, "replace it")
            with opened as stream, Image.open(stream, formats=PICTURE_FORMATS) as image:
                pixels = image.width * image.height * getattr(image, "n_frames", 1)
                check_unpacked(pixels, file.stat().st_size, str(file), "replace it")
                for page in ImageSequence.Iterator(image):
                    check_depth(page, str(file))
                    if page.mode == "I":
                        raise InputError(
                            f"{file} has 32 bits a pixel, of unknown full scale: save it with 8 "
                            "or 16 bits, or as floats"
                        )
                    if page.mode.startswith("I;16"):
                        yield np.asarray(page).astype(np.uint16)
                    else:
                        yield np.asarray(page if page.mode in ("1", "F") else page.convert("L"))
    except InputError:
        raise
    except Exception as error:  # Pillow's decoders raise almost anything on a damaged file
        raise InputError(f"cannot read the image {file} ({error}): replace it") from None
