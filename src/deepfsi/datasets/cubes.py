"""Hyperspectral images and their label maps from ``.mat``, ``.npy`` or ENVI files."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from glob import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from deepfsi.base import WINDOWS_ENCODING, InputError, open_regular, read_text
from deepfsi.base.numeric import parse_number, read_array
from deepfsi.datasets.spectra import Mask, SpectralImage

SUFFIXES = (".mat", ".npy", ".hdr")
"""Ends of the names of files that hold cubes."""

HEADER_KEYS = (
    *("data ignore value", "bbl", "data gain values", "data offset values", "file compression"),
    *("reflectance scale factor", "wavelength", "wavelength units"),
)
"""Fields of an ENVI header that change what its data mean, besides those that spectral reads."""

MAX_HEADER = 2**26
"""Bytes of a header at most."""

MAX_VALUES = 2**30
"""Values of a cube at most."""


class _Array(NamedTuple):
    values: npt.NDArray[Any]
    wavelengths: npt.NDArray[np.float64] | None = None
    classes: tuple[str, ...] | None = None
    missing: Mask | None = None  # pixels without data
    notes: tuple[str, ...] = ()  # what the header made of the values, in words


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
    known = _integers(label_map.values)
    if cube.missing is not None and cube.missing.shape == known.shape:
        known = np.where(cube.missing, 0, known)
    return SpectralImage(
        name=name or path.stem,
        cube=cube.values,
        labels=known,
        classes=names if classes is None else classes,
        wavelengths=cube.wavelengths,
        origin=origin + (f" ({', '.join(cube.notes)})" if cube.notes else ""),
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
    there = {each.name.lower(): each for each in path.parent.iterdir() if each.is_file()}
    for name in (stem + suffix for stem in stems for suffix in SUFFIXES):
        if found := there.get(name.lower()):
            return found
    raise InputError(
        f"{path} has no label map beside it: put one there as {stems[-1]} with the ending "
        f"{' or '.join(SUFFIXES)}, 0 where a pixel has no label"
    )


def _read(path: Path, dimensions: int, variable: str | None) -> _Array:
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path} is no {', '.join(SUFFIXES)} file; save it as one of them")
    if not path.exists():
        raise InputError(f"there is no file {path}")
    if path.suffix.lower() == ".hdr":
        array = _read_envi(path, dimensions)
    else:
        advice = f"save a {dimensions}-dimensional one alone"
        array = _Array(
            read_array(path, (dimensions,), variable or "", largest=MAX_VALUES, advice=advice)
        )
    if dimensions == 2 and array.values.ndim == 3 and array.values.shape[2] == 1:
        array = array._replace(values=array.values[..., 0])
    return array


def _read_envi(path: Path, dimensions: int) -> _Array:
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
        with _plain_header(path) as (header, data):
            image = envi.open(str(header), data)
        if not image.using_memmap:
            raise ValueError("its data file holds less than the header says")
        values = np.array(image.open_memmap())
        said = {key: image.metadata.get(key) for key in HEADER_KEYS}
        made = by_header(values, said) if dimensions == 3 else _labels_by_header(values, said)
    except Exception as error:
        raise InputError(f"cannot read {path} as ENVI ({error}); write it again") from error
    names = image.metadata.get("class names")
    return made._replace(classes=tuple(names) if names else None)


@contextmanager
def _plain_header(path: Path) -> Iterator[tuple[Path, str | None]]:
    """Header as spectral reads it, and the data file where it would not be found."""
    # It reads UTF-8 without a byte order mark alone, and looks for data beside the header
    text = read_text(path, MAX_HEADER, "write it again", WINDOWS_ENCODING)
    if text.isascii() and path.read_bytes()[:1] == b"E":
        yield path, None
        return
    kinds = ("", ".img", ".dat", ".raw", ".bip", ".bil", ".bsq", ".sli", ".bin", ".hyspex")
    beside = {each.name.lower(): each for each in path.parent.iterdir() if each.is_file()}
    data = next(
        (found for kind in kinds if (found := beside.get((path.stem + kind).lower()))), None
    )
    if data is None:
        raise ValueError(f"there is no data file such as {path.stem}.raw")
    with TemporaryDirectory() as folder:
        header = Path(folder) / "header.hdr"
        header.write_text(text, errors="replace")  # as spectral reads it: in the locale's encoding
        yield header, str(data)


def by_header(values: npt.NDArray[Any], header: Mapping[str, Any]) -> _Array:
    """Cube (height, width, bands) as its ENVI header says that it is to be read.

    Bands that the header calls bad are left out, numbers become radiance by gain and offset and
    reflectance by the scale factor, and pixels with the data ignore value in any band are without
    data.

    Parameters
    ----------
    values : array, shape (H, W, B)
        Values as they are stored.
    header : mapping
        Fields of the header: words, or lists of words.

    Raises
    ------
    ValueError
        If a field does not fit the cube, or leaves nothing of it.
    """
    notes = []
    if header.get("file compression") not in (None, "0"):
        raise ValueError("its data are compressed, which is not read: save it without compression")
    bands = values.shape[2]
    centres, good = _field(header, "wavelength", bands), _field(header, "bbl", bands)
    if good is not None and not good.all():
        if not good.any():
            raise ValueError("its list of bad bands (bbl) leaves none")
        values = values[..., good != 0]
        centres = None if centres is None else centres[good != 0]
        notes.append(f"{np.count_nonzero(good == 0)} bad bands left out")
    missing = _missing(values, header)
    if missing is not None and missing.any():
        if missing.all():
            raise ValueError("every pixel has its data ignore value in some band")
        values[missing] = values[~missing][0]  # so that it sets no range
        notes.append(f"{np.count_nonzero(missing)} pixels without data left out")
    for key, what in {"data gain values": "gains", "data offset values": "offsets"}.items():
        each = _field(header, key, bands)
        if each is not None:
            each = each if good is None else each[good != 0]
            values = values * each if what == "gains" else values + each
            notes.append(f"with the header's {what}")
    if (factor := header.get("reflectance scale factor")) is not None:
        if not 0 < float(factor) < np.inf:
            raise ValueError(f"its reflectance scale factor is {factor}")
        values = values / float(factor)
        notes.append(f"divided by the reflectance scale factor {float(factor):g}")
    if values.dtype == np.float64:
        values = values.astype(np.float32)
    unit = str(header.get("wavelength units") or "").lower()
    return _Array(values, _nanometres(centres, unit), None, missing, tuple(notes))


def _nanometres(centres: npt.NDArray[Any] | None, unit: str) -> npt.NDArray[Any] | None:
    """Wavelengths in nm; None where the unit is none of length, or not given and not plausible."""
    if centres is None or not np.isfinite(centres).all():
        return None
    if unit.startswith(("micro", "um", "\u00b5m", "\u03bcm")):
        return centres * 1000
    named = unit.startswith(("nano", "nm"))
    return centres if named or (unit in ("", "none", "unknown") and centres.min() > 100) else None


def _missing(values: npt.NDArray[Any], header: Mapping[str, Any]) -> Mask | None:
    """Pixels that have the data ignore value in any band; None where the header has no such."""
    if (given := header.get("data ignore value")) is None:
        return None
    ignored = float(given)
    same = np.isnan(values) if np.isnan(ignored) else values == ignored
    found: Mask = same.any(axis=2)
    return found


def _labels_by_header(values: npt.NDArray[Any], header: Mapping[str, Any]) -> _Array:
    """Label map without the labels that its header says to ignore."""
    missing = _missing(values, header)
    if missing is not None:
        values[missing] = 0
    return _Array(values)


def _field(header: Mapping[str, Any], key: str, bands: int) -> npt.NDArray[Any] | None:
    """Numbers of a field, one for each band; None where the header has no such field."""
    if (given := header.get(key)) is None:
        return None
    numbers = np.array([parse_number(str(each)) for each in np.atleast_1d(given)], float)
    if numbers.shape != (bands,) or not np.isfinite(numbers).all():
        raise ValueError(f"its field {key!r} does not hold a number for each of {bands} bands")
    return numbers
