"""Spectra as scenes: hyperspectral images and their label maps, from files to data sets.

Each labelled pixel is one scene whose "pixels" are its N bands, so that a mask weighs wavelengths.
Neighbouring pixels of one field resemble each other. A random split therefore tests on pixels whose
neighbours were trained on, and flatters; a split in blocks keeps the two parts apart.

Files are ``.mat``, ``.npy`` or ENVI's, of a cube and of its label map beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from glob import escape
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from deepfsi.base.arrays import check_size, read_array
from deepfsi.base.errors import InputError, check_choice
from deepfsi.base.files import open_regular
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
        if cube.ndim != 3 or not cube.size:
            raise InputError(
                f"{self.name}: the cube is of shape {cube.shape}; give (height, width, bands)"
            )
        if labels.shape != cube.shape[:2] or labels.dtype.kind not in "ui":
            raise InputError(
                f"{self.name}: the label map is {labels.dtype} of shape {labels.shape}; give "
                f"integers of shape {cube.shape[:2]}, as the cube, 0 where there is no label"
            )
        if not np.isfinite(cube).all():
            raise InputError(f"{self.name}: the cube holds NaN or infinite values; remove them")
        present = np.unique(labels[labels != 0])
        if len(present) < 2:
            raise InputError(f"{self.name}: {len(present)} classes are labelled; give two or more")
        if self.classes is not None and not 1 <= present[0] <= present[-1] <= len(self.classes):
            raise InputError(
                f"{self.name}: the labels reach from {present[0]} to {present[-1]} for "
                f"{len(self.classes)} class names; name each class 1, 2, .."
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
        split: str | None = None,
        seed: int = 0,
        bands: int | None = None,
        rescale: Ends | None = None,
    ) -> Dataset:
        """Make a data set of the labelled pixels."""
        split = split or "random"
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
        origin=origin,
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
        check_size(str(path), image.shape, 4, MAX_VALUES)
        values = np.array(image.open_memmap(), np.float32) / image.scale_factor
        array = _by_header(values, image) if dimensions == 3 else _Array(values.astype(np.int64))
    except InputError:
        raise
    except Exception as error:  # spectral raises almost anything on a damaged header
        raise InputError(f"cannot read {path} as ENVI ({error}); write it again") from error
    names = image.metadata.get("class names")
    return array._replace(classes=tuple(names) if names else None)


def _by_header(values: npt.NDArray[np.float32], image: Any) -> _Array:
    """Cube (height, width, bands) without what its ENVI header calls bad.

    Bands of the list of bad ones are left out, and pixels with the data ignore value in any band.
    """
    header = image.metadata
    if any(header.get(key) not in (None, "0") for key in NOT_APPLIED):
        raise ValueError(f"its header has {', '.join(NOT_APPLIED)}, which are not applied")
    centres = image.bands.centers and np.array(image.bands.centers, float)
    good = np.array(header.get("bbl", np.ones(values.shape[2])), float) != 0
    missing = None
    if (ignored := header.get("data ignore value")) is not None:
        value = np.float32(float(ignored) / image.scale_factor)
        missing = ((values == value) | (np.isnan(value) & np.isnan(values))).any(axis=2)
        values[missing] = values[~missing][0]  # so that it sets no range
    unit = str(image.bands.band_unit).lower()
    scale = 1000.0 if unit.startswith(("micro", "um", "\u00b5m")) else 1.0
    known = centres is not None and unit.startswith(("micro", "um", "\u00b5m", "nano", "nm"))
    return _Array(values[..., good], centres[good] * scale if known else None, missing=missing)
