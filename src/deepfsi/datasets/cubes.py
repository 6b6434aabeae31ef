"""Hyperspectral images and their label maps from ``.mat``, ``.npy`` or ENVI files."""

from collections.abc import Sequence
from glob import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from deepfsi.datasets.spectra import SpectralImage
from deepfsi.errors import InputError
from deepfsi.files import open_regular
from deepfsi.tables.array_files import read_array

SUFFIXES = (".mat", ".npy", ".hdr")
"""Ends of the names of files that hold cubes."""

MAX_VALUES = 2**30
"""Values of a cube at most."""


class _Array(NamedTuple):
    values: npt.NDArray[Any]
    wavelengths: npt.NDArray[np.float64] | None = None
    classes: tuple[str, ...] | None = None


def read_cube(
    path: Path,
    labels: Path | None = None,
    *,
    variables: tuple[str | None, str | None] = (None, None),
    name: str | None = None,
    classes: Sequence[str] | None = None,
    origin: str = "Spectra",
) -> SpectralImage:
    """Read a cube and its label map."""
    labels = _find_labels(path) if labels is None else labels
    cube = _read(path, 3, variables[0])
    label_map = _read(labels, 2, variables[1])
    names = label_map.classes[1:] if label_map.classes else None  # ENVI's class 0 is "none"
    return SpectralImage(
        name=name or path.stem,
        cube=cube.values,
        labels=_integers(label_map.values),
        classes=names if classes is None else classes,
        wavelengths=cube.wavelengths,
        origin=origin,
    )


def read_labels(path: Path, variable: str | None = None) -> npt.NDArray[np.integer]:
    """Read a label map alone, as `read_cube` does."""
    return _integers(_read(path, 2, variable).values)


def _integers(labels: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Whole numbers as integers: MATLAB's own are doubles. Others are left for the checks."""
    if labels.dtype.kind == "f" and (np.abs(labels) < 2**31).all() and not (labels % 1).any():
        return labels.astype(np.int64)
    return labels


def _find_labels(path: Path) -> Path:
    stems = [path.stem + "_gt", path.stem.removesuffix("_corrected") + "_gt"]
    for name in (stem + suffix for stem in stems for suffix in SUFFIXES):
        if (path.parent / name).is_file():
            return path.parent / name
    raise InputError(
        f"{path} has no label map beside it: put one there as {stems[-1]} with the ending "
        f"{' or '.join(SUFFIXES)}, 0 where a pixel has no label"
    )


def _read(path: Path, dimensions: int, variable: str | None) -> _Array:
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path} is no {', '.join(SUFFIXES)} file; save it as one of them")
    if not path.exists():
        raise InputError(f"there is no file {path}")
    if path.suffix == ".hdr":
        array = _read_envi(path)
    else:
        advice = f"save a {dimensions}-dimensional one alone"
        array = _Array(
            read_array(path, (dimensions,), variable or "", largest=MAX_VALUES, advice=advice)
        )
    if dimensions == 2 and array.values.ndim == 3 and array.values.shape[2] == 1:
        array = array._replace(values=array.values[..., 0])
    return array


def _read_envi(path: Path) -> _Array:
    try:
        from spectral.io import envi
    except ImportError as error:
        raise InputError(
            f"{path} is an ENVI header, read by the package spectral: pip install spectral"
        ) from error
    for beside in path.parent.glob(f"{escape(path.stem)}*"):  # its data file is one of them
        if not beside.is_dir():
            with open_regular(beside):
                pass
    try:
        image = envi.open(str(path))
        if not image.using_memmap:
            raise ValueError("its data file holds less than the header says")
        values = np.array(image.open_memmap())
    except Exception as error:
        raise InputError(f"cannot read {path} as ENVI ({error}); write it again") from error
    centres = image.bands.centers
    wavelengths = None if centres is None else np.array(centres, float)
    if wavelengths is not None and str(image.bands.band_unit).lower().startswith("micro"):
        wavelengths *= 1000
    names = image.metadata.get("class names")
    return _Array(values, wavelengths, tuple(names) if names else None)
