"""Spectra as scenes: hyperspectral images and their label maps, from files to data sets.

Each labelled pixel is one scene whose "pixels" are its N bands, so that a mask weighs wavelengths.
Neighbouring pixels of one field resemble each other. A random split therefore tests on pixels whose
neighbours were trained on, and flatters; a split in blocks keeps the two parts apart.

Files are ``.mat``, ``.npy`` or ENVI's, of a cube and of its label map beside it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from glob import escape
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from deepfsi.base.errors import InputError, check_choice
from deepfsi.base.files import open_regular
from deepfsi.base.numeric.arrays import check_size, read_array
from deepfsi.base.numeric.tables import parse_number
from deepfsi.datasets.arrays import TEST_SHARE, assemble, check_seed, draw_fifth
from deepfsi.datasets.dataset import Dataset, Ends, Reflectance

Mask: TypeAlias = npt.NDArray[np.bool_]

PIXEL_SPLITS = ("random", "blocks")
"""Ways to divide the pixels for testing."""

BLOCK_SIDE = 9
"""Side of the square blocks, pixels."""

TRIES = 6
"""Shuffles of the blocks, each giving five choices of a fifth."""

GUARD = 1
"""Distance from a test scene at which no training scene is, pixels."""

CUBE_ENDINGS = (".mat", ".npy", ".hdr")
"""Ends of the names of files that hold cubes."""

NOT_APPLIED = ("data gain values", "data offset values", "file compression")
"""Fields of an ENVI header with which a cube is refused."""

HEADER_KEYS = (
    *("data ignore value", "bbl", "reflectance scale factor", "wavelength", "wavelength units"),
    *NOT_APPLIED,
)
"""Fields of an ENVI header that change what its data mean, besides those that spectral reads."""

MAX_VALUES = 2**30
"""Values of a cube at most."""


@dataclass(frozen=True, eq=False)
class SpectralImage:
    """A hyperspectral image with a label for some of its pixels."""

    name: str  # name in tables and records
    cube: npt.NDArray[np.generic]  # (H, W, B), value of each pixel in each band, integers or floats
    labels: npt.NDArray[np.integer]  # (H, W), class of each pixel, 0 where it has none
    classes: Sequence[str] | None = None
    wavelengths: npt.NDArray[np.float64] | None = None  # (B,), centre of each band in nm
    origin: str = "Spectra"  # kind of the values, in a few words, for `Dataset.preprocessing`

    def __post_init__(self) -> None:
        cube = self.cube
        labels = self.labels
        if cube.ndim != 3 or not cube.size or cube.dtype.kind not in "uif":
            raise InputError(
                f"{self.name}: the cube is {cube.dtype} of shape {cube.shape}; give numbers of "
                "shape (height, width, bands)"
            )
        if labels.shape != cube.shape[:2] or labels.dtype.kind not in "ui":
            raise InputError(
                f"{self.name}: the label map is {labels.dtype} of shape {labels.shape}; give "
                f"integers of shape {cube.shape[:2]}, as the cube, 0 where there is no label"
            )
        if not np.isfinite(cube).all():
            raise InputError(f"{self.name}: the cube holds NaN or infinite values; remove them")
        present = np.unique(labels[labels != 0]).tolist()
        if len(present) < 2:
            raise InputError(f"{self.name}: {len(present)} classes are labelled; give two or more")
        if self.classes is not None and not 1 <= present[0] <= present[-1] <= len(self.classes):
            raise InputError(
                f"{self.name}: the labels are {', '.join(map(str, present))} for "
                f"{len(self.classes)} class names; name each class 1, 2, .."
            )
        if self.wavelengths is not None and self.wavelengths.shape != cube.shape[2:]:
            raise InputError(
                f"{self.name}: {len(self.wavelengths)} wavelengths for {cube.shape[2]} bands; "
                "give one for each"
            )

    @cached_property
    def class_names(self) -> tuple[str, ...]:
        """The C names of the classes that have pixels, in the order of the labels."""
        present = np.unique(self.labels[self.labels != 0]).tolist()
        return tuple(str(k) if self.classes is None else self.classes[k - 1] for k in present)

    @cached_property
    def reach(self) -> tuple[float, float]:
        """Values of the cube that become 0 and 1."""
        low = float(self.cube.min())
        high = float(self.cube.max())
        if self.cube.dtype.kind == "f" and 0 <= low <= high <= 1:
            return 0.0, 1.0
        if low == high:
            raise InputError(f"{self.name}: every value of the cube is {low:g}; give spectra")
        return low, high

    def scenes(self, bands: int | None = None) -> Reflectance:
        """Every pixel as a scene, (H W, N) float32 in [0, 1], labelled or not, row by row.

        They are padded with darkness to N = `bands`, by default as many as there are.
        """
        lit = self.cube.shape[2]
        bands = lit if bands is None else bands
        if bands < lit:
            raise InputError(f"{self.name}: {lit} bands cannot be padded to {bands}; give more")
        low, high = self.reach
        spectra = np.zeros((self.labels.size, bands), np.float32)
        spectra[:, :lit] = self.cube.reshape(-1, lit)
        spectra[:, :lit] -= low
        spectra[:, :lit] /= high - low
        return np.clip(spectra, 0, 1, out=spectra)

    def parts(self, split: str = "random", seed: int = 0) -> tuple[Mask, Mask]:
        """Divide the labelled pixels into a training and a test part, where they are in (H, W)."""
        check_seed(seed)
        check_choice("split", split, PIXEL_SPLITS)
        counts = np.unique(self.labels[self.labels != 0], return_counts=True)[1]
        if counts.min() < TEST_SHARE:
            raise InputError(
                f"{self.name}: class '{self.class_names[counts.argmin()]}' has {counts.min()} "
                f"pixels; label {TEST_SHARE} or more of each class"
            )
        if split == "blocks":
            return self._blocks(seed)
        labelled = np.flatnonzero(self.labels)
        _, drawn = draw_fifth(len(labelled), self.labels.ravel()[labelled], seed)
        test = np.zeros(self.labels.shape, bool)
        test.ravel()[labelled[drawn]] = True
        return (self.labels != 0) & ~test, test

    def _blocks(self, seed: int) -> tuple[Mask, Mask]:
        """The best of some stratified choices: most classes in both parts, nearest to a fifth."""
        from scipy.ndimage import binary_dilation
        from sklearn.model_selection import StratifiedGroupKFold

        labels = self.labels
        rows, columns = np.nonzero(labels)
        kinds = np.unique(labels[rows, columns], return_inverse=True)[1]
        rng = np.random.default_rng(seed)
        down, across = rng.integers(0, BLOCK_SIDE, 2)
        blocks = (rows + down) // BLOCK_SIDE * labels.shape[1] + (columns + across) // BLOCK_SIDE
        if len(np.unique(blocks)) < TEST_SHARE:
            raise InputError(
                f"{self.name}: the labelled pixels lie in fewer than {TEST_SHARE} blocks of "
                f"{BLOCK_SIDE}x{BLOCK_SIDE}; split them at random"
            )
        best: tuple[Mask, Mask] | None = None
        merit = (0, 0.0)
        for _ in range(TRIES):
            state = int(rng.integers(2**31))
            folds = StratifiedGroupKFold(TEST_SHARE, shuffle=True, random_state=state)
            for _, chosen in folds.split(rows, kinds, blocks):
                test = np.zeros(labels.shape, bool)
                test[rows[chosen], columns[chosen]] = True
                train = (labels != 0) & ~binary_dilation(test, np.ones((3, 3)), GUARD)
                tested = np.bincount(kinds[test[rows, columns]], minlength=kinds.max() + 1)
                trained = np.bincount(kinds[train[rows, columns]], minlength=kinds.max() + 1)
                if not trained.all():
                    continue
                both = int(np.count_nonzero((tested > 0) & (tested <= trained)))
                distance = float(np.abs(tested / (tested + trained) - 1 / TEST_SHARE).mean())
                if (both, -distance) > merit:
                    best = train, test
                    merit = both, -distance
        if best is None:
            raise InputError(
                f"{self.name}: no choice of blocks leaves pixels of every class to train on; "
                "split them at random, or try another seed"
            )
        return best

    def dataset(
        self,
        split: str = "random",
        seed: int = 0,
        bands: int | None = None,
        rescale: Ends | None = None,
    ) -> Dataset:
        """Make a data set of the labelled pixels."""
        spectra = self.scenes(bands)
        y = np.searchsorted(np.unique(self.labels[self.labels != 0]), self.labels.ravel())
        train, test = (np.flatnonzero(part) for part in self.parts(split, seed))
        train = np.random.default_rng(seed).permutation(train)
        wavelengths = None
        if self.wavelengths is not None:
            wavelengths = np.full(spectra.shape[1], np.nan)
            wavelengths[: len(self.wavelengths)] = self.wavelengths
        low, high = self.reach
        lit = self.cube.shape[2]
        padded = spectra.shape[1]
        scaled = "" if (low, high) == (0, 1) else f" mapped from [{low:g}, {high:g}] to [0, 1]"
        dark = "" if padded == lit else f", padded with darkness to {padded}"
        apart = {
            "random": "a random stratified fifth of the labelled pixels is for testing",
            "blocks": f"about a fifth of the blocks of {BLOCK_SIDE}x{BLOCK_SIDE} pixels is for "
            "testing, training pixels beside them are left out",
        }[split]
        return assemble(
            self.name,
            (spectra[train], y[train].astype(np.int64)),
            (spectra[test], y[test].astype(np.int64)),
            classes=self.class_names,
            described=f"{self.origin}{scaled}, {lit} bands{dark}; {apart}",
            rescale=rescale,
            wavelengths=wavelengths,
        )


# ---------------------------------------------------------------- files


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
    numbers = label_map.values
    # MATLAB's own whole numbers are doubles; others are left for the checks
    if numbers.dtype.kind == "f" and (np.abs(numbers) < 2**31).all() and not (numbers % 1).any():
        numbers = numbers.astype(np.int64)
    if cube.missing is not None and cube.missing.shape == numbers.shape:
        numbers = np.where(cube.missing, 0, numbers)
    return SpectralImage(
        name=name or path.stem,
        cube=cube.values,
        labels=numbers,
        classes=names if classes is None else classes,
        wavelengths=cube.wavelengths,
        origin=origin + (f" ({', '.join(cube.notes)})" if cube.notes else ""),
    )


def _find_labels(path: Path) -> Path:
    stems = [path.stem + "_gt", path.stem.removesuffix("_corrected") + "_gt"]
    files = {file.name.lower(): file for file in path.parent.iterdir() if file.is_file()}
    for name in (stem + suffix for stem in stems for suffix in CUBE_ENDINGS):
        if labels := files.get(name.lower()):
            return labels
    raise InputError(
        f"{path} has no label map beside it: put one there as {stems[-1]} with the ending "
        f"{' or '.join(CUBE_ENDINGS)}, 0 where a pixel has no label"
    )


def _read(path: Path, dimensions: int, variable: str | None) -> _Array:
    if path.suffix.lower() not in CUBE_ENDINGS:
        raise InputError(f"{path} is no {', '.join(CUBE_ENDINGS)} file; save it as one of them")
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
    for file in path.parent.glob(f"{escape(path.stem)}*"):  # its data file is one of them
        if not file.is_dir():
            with open_regular(file):
                pass
    try:
        image = envi.open(str(path))
        if not image.using_memmap:
            raise ValueError("its data file holds less than the header says")
        mapped = image.open_memmap()
        check_size(str(path), mapped.shape, mapped.dtype.itemsize, MAX_VALUES)
        values = np.array(mapped)
        fields = {key: image.metadata.get(key) for key in HEADER_KEYS}
        if dimensions == 3:
            array = by_header(values, fields)
        else:
            ignored = _missing(values, fields)
            array = _Array(values if ignored is None else np.where(ignored[..., None], 0, values))
    except InputError:
        raise
    except Exception as error:  # spectral raises almost anything on a damaged header
        raise InputError(f"cannot read {path} as ENVI ({error}); write it again") from error
    names = image.metadata.get("class names")
    return array._replace(classes=tuple(names) if names else None)


def by_header(values: npt.NDArray[Any], header: Mapping[str, Any]) -> _Array:
    """Cube (height, width, bands) of stored values of this shape, as its ENVI header says.

    Bands that the header calls bad are left out, numbers become reflectance by the scale factor,
    and pixels with the data ignore value in any band are without data.
    """
    notes = []
    for key in NOT_APPLIED:
        if header.get(key) not in (None, "0"):
            raise ValueError(f"its header has {key!r}, which is not applied: save it without")
    bands = values.shape[2]
    centres = _field(header, "wavelength", bands)
    good = _field(header, "bbl", bands)
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
    if (factor := header.get("reflectance scale factor")) is not None:
        if not 0 < float(factor) < np.inf:
            raise ValueError(f"its reflectance scale factor is {factor}")
        values = values / float(factor)
        notes.append(f"divided by the reflectance scale factor {float(factor):g}")
    if values.dtype == np.float64:
        values = values.astype(np.float32)
    unit = str(header.get("wavelength units") or "").lower()
    nanometres = None  # where the unit is none of length, or not there and not plausible
    if centres is not None and np.isfinite(centres).all():
        if unit.startswith(("micro", "um", "\u00b5m", "\u03bcm")):
            nanometres = centres * 1000
        elif unit.startswith(("nano", "nm")) or (
            unit in ("", "none", "unknown") and centres.min() > 100
        ):
            nanometres = centres
    return _Array(values, nanometres, missing=missing, notes=tuple(notes))


def _missing(values: npt.NDArray[Any], header: Mapping[str, Any]) -> Mask | None:
    """Pixels that have the data ignore value in any band; None where the header has no such."""
    if (value := header.get("data ignore value")) is None:
        return None
    ignored = float(value)
    missing: Mask = (np.isnan(values) if np.isnan(ignored) else values == ignored).any(axis=2)
    return missing


def _field(header: Mapping[str, Any], key: str, bands: int) -> npt.NDArray[Any] | None:
    """Numbers of a field, one for each band; None where the header has no such field."""
    if (words := header.get(key)) is None:
        return None
    numbers = np.array([parse_number(str(word)) for word in np.atleast_1d(words)], float)
    if numbers.shape != (bands,) or not np.isfinite(numbers).all():
        raise ValueError(f"its field {key!r} does not hold a number for each of {bands} bands")
    return numbers
