"""Spectra as scenes: hyperspectral images and their label maps, from files to data sets.

Each labelled pixel is one scene whose "pixels" are its N bands, so that a mask weighs wavelengths.
Neighbouring pixels of a field resemble each other. A random split therefore tests on pixels whose
neighbours were trained on, and flatters; a split in blocks keeps the two parts apart.

Files are ``.mat`` or ``.npy``, of a cube and of its label map beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from deepfsi.base.arrays import read_array
from deepfsi.base.errors import InputError, check_choice
from deepfsi.datasets.arrays import TEST_FOLDS, assemble, draw_fifth
from deepfsi.datasets.dataset import Dataset, Ends

Mask: TypeAlias = npt.NDArray[np.bool_]

BLOCK_SIDE = 9
"""Side of the square blocks, pixels."""

CUBE_ENDINGS = (".mat", ".npy")
"""Ends of the names of files that hold cubes."""


@dataclass(frozen=True, eq=False)
class SpectralImage:
    """A hyperspectral image with a label for some of its pixels."""

    name: str  # name in tables and records
    cube: npt.NDArray[np.generic]  # (H, W, B), value of each pixel in each band, integers or floats
    labels: npt.NDArray[np.integer]  # (H, W), class of each pixel, 0 where it has none
    classes: Sequence[str] | None = None
    origin: str = "Spectra"  # kind of the values, in a few words, for `Dataset.preprocessing`

    def __post_init__(self) -> None:
        cube = self.cube
        labels = self.labels
        fits = cube.ndim == 3 and cube.size and labels.shape == cube.shape[:2]
        labelled = labels.dtype.kind in "ui" and len(self.present) > 1
        # False of NaN; float32 holds the range
        if not (fits and labelled and 1e-30 < float(cube.max()) - float(cube.min()) < 1e30):
            raise InputError(
                f"{self.name}: the cube is of shape {cube.shape}, the label map {labels.dtype} of "
                f"shape {labels.shape}; give (height, width, bands) of different finite numbers, "
                "and integers (height, width) of two classes or more, 0 where there is no label"
            )

    @cached_property
    def present(self) -> npt.NDArray[np.integer]:
        """Labels (C,) of the classes that have pixels, in rising order."""
        return np.unique(self.labels[self.labels != 0])

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names of the C classes that have pixels."""
        names = self.classes
        return tuple(str(k) if names is None else names[k - 1] for k in self.present.tolist())

    def parts(self, split: str = "random", seed: int = 0) -> tuple[Mask, Mask]:
        """Masks (H, W) of the labelled pixels to train on, and of those to test on."""
        check_choice("split", split, ("random", "blocks"))
        counts = np.unique(self.labels[self.labels != 0], return_counts=True)[1]
        if counts.min() < TEST_FOLDS:
            raise InputError(
                f"{self.name}: class '{self.class_names[counts.argmin()]}' has {counts.min()} "
                f"pixels; label {TEST_FOLDS} or more of each class"
            )
        if split == "blocks":
            return self._blocks(seed)
        labelled = np.flatnonzero(self.labels)
        _, drawn = draw_fifth(len(labelled), self.labels.ravel()[labelled], seed)
        test = np.zeros(self.labels.shape, bool)
        test.ravel()[labelled[drawn]] = True
        return (self.labels != 0) & ~test, test

    def _blocks(self, seed: int) -> tuple[Mask, Mask]:
        """The best of thirty stratified choices: with most classes in both of its masks (H, W)."""
        from scipy.ndimage import binary_dilation
        from sklearn.model_selection import StratifiedGroupKFold

        labels = self.labels
        rows, columns = np.nonzero(labels)
        classes = np.unique(labels[rows, columns], return_inverse=True)[1]
        rng = np.random.default_rng(seed)
        # The grid of blocks begins anywhere, so that seeds differ in it
        down, across = rng.integers(0, BLOCK_SIDE, 2)
        blocks = (rows + down) // BLOCK_SIDE * labels.shape[1] + (columns + across) // BLOCK_SIDE
        best: tuple[Mask, Mask] | None = None
        merit = (0, 0.0)
        # Each shuffle has five choices of a fifth; fewer blocks have none
        shuffles = 6 if len(np.unique(blocks)) >= TEST_FOLDS else 0
        for _ in range(shuffles):
            state = int(rng.integers(2**31))
            folds = StratifiedGroupKFold(TEST_FOLDS, shuffle=True, random_state=state)
            for _, chosen in folds.split(rows, classes, blocks):
                test = np.zeros(labels.shape, bool)
                test[rows[chosen], columns[chosen]] = True
                # A pixel beside a tested one resembles it, and is left out
                train = (labels != 0) & ~binary_dilation(test, np.ones((3, 3)))
                tested = np.bincount(classes[test[rows, columns]], minlength=classes.max() + 1)
                trained = np.bincount(classes[train[rows, columns]], minlength=classes.max() + 1)
                if not trained.all():
                    continue
                # More classes count first, then shares of the test nearest to a fifth
                both = int(np.count_nonzero((tested > 0) & (tested <= trained)))
                distance = float(np.abs(tested / (tested + trained) - 1 / TEST_FOLDS).mean())
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
        low, high = float(self.cube.min()), float(self.cube.max())
        if self.cube.dtype.kind == "f" and 0 <= low <= high <= 1:
            low, high = 0.0, 1.0
        lit = self.cube.shape[2]
        x = np.zeros((self.labels.size, bands or lit), np.float32)  # padded with darkness
        x[:, :lit] = self.cube.reshape(-1, lit)
        x[:, :lit] -= low
        x[:, :lit] /= high - low
        np.clip(x, 0, 1, out=x)
        y = np.searchsorted(self.present, self.labels.ravel()).astype(np.int64)
        train, test = (np.flatnonzero(mask) for mask in self.parts(split, seed))
        # The last training scenes must be a fair sample to validate on
        train = np.random.default_rng(seed).permutation(train)
        scaled = "" if (low, high) == (0, 1) else f" mapped from [{low:g}, {high:g}] to [0, 1]"
        dark = "" if x.shape[1] == lit else f", padded with darkness to {x.shape[1]}"
        return assemble(
            self.name,
            (x[train], y[train]),
            (x[test], y[test]),
            classes=self.class_names,
            described=f"{self.origin}{scaled}, {lit} bands{dark}; {split} split",
            rescale=rescale,
        )


# ---------------------------------------------------------------- files


def read_cube(
    path: Path,
    *,
    name: str | None = None,
    classes: Sequence[str] | None = None,
    origin: str = "Spectra",
) -> SpectralImage:
    """Read a cube and the label map beside it."""
    label_files = [
        path.with_name(f"{path.stem.removesuffix('_corrected')}_gt{ending}")
        for ending in CUBE_ENDINGS
    ]
    label_file = next(filter(Path.is_file, label_files), None)
    if label_file is None:
        names = " or ".join(file.name for file in label_files)
        raise InputError(
            f"{path} has no label map beside it: put one there as {names}, 0 where a pixel has no "
            "label"
        )
    advice = "save it alone"
    cube = read_array(path, (3,), advice=advice)
    labels = read_array(label_file, (2,), advice=advice)
    # MATLAB saves whole numbers as doubles; the check of the image refuses other floats
    if labels.dtype.kind == "f" and (np.abs(labels) < 2**31).all() and not (labels % 1).any():
        labels = labels.astype(np.int64)
    return SpectralImage(name or path.stem, cube, labels, classes=classes, origin=origin)
