"""Spectra as scenes: data sets of a hyperspectral image and its label map.

Each labelled pixel is one scene whose "pixels" are its N bands, so that a mask weighs wavelengths.
Neighbouring pixels of one field resemble each other. A random split therefore tests on pixels whose
neighbours were trained on, and flatters; a split in blocks keeps the two parts apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from deepfsi.base import InputError, check_choice
from deepfsi.datasets.arrays import TEST_SHARE, Range, assemble, check_seed
from deepfsi.datasets.dataset import Dataset, Reflectance

Mask: TypeAlias = npt.NDArray[np.bool_]

SPLITS = ("random", "blocks")
"""Ways to divide the pixels for testing."""

BLOCK = 9
"""Side of the square blocks, pixels."""

TRIES = 6
"""Shuffles of the blocks, each giving five choices of a fifth."""

GUARD = 1
"""Distance from a test scene at which no training scene is, pixels."""


@dataclass(frozen=True, eq=False)
class SpectralImage:
    """A hyperspectral image with a label for some of its pixels."""

    name: str  # name in tables and records
    # (H, W, B): Value of each pixel in each band, integers or floats. Floats in [0, 1] are
    # reflectance; any other cube is mapped linearly from its lowest and highest value to [0, 1]
    cube: npt.NDArray[np.generic]
    labels: npt.NDArray[np.integer]  # (H, W): Class of each pixel, an integer, 0 where it has none
    # Names of the classes 1, 2, ..; by default the labels themselves. Those without a pixel are
    # left out
    classes: Sequence[str] | None = None
    wavelengths: npt.NDArray[np.float64] | None = None  # (B,): Centre of each band in nm
    origin: str = "Spectra"  # kind of the values, in a few words, for `Dataset.preprocessing`

    def __post_init__(self) -> None:
        cube, labels = self.cube, self.labels
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
        low, high = float(self.cube.min()), float(self.cube.max())
        if self.cube.dtype.kind == "f" and 0 <= low <= high <= 1:
            return 0.0, 1.0
        if low == high:
            raise InputError(f"{self.name}: every value of the cube is {low:g}; give spectra")
        return low, high

    def scenes(self, bands: int | None = None) -> Reflectance:
        """Every pixel as a scene, (H W, N) float32 in [0, 1], labelled or not, row by row."""
        # The spectra are padded with darkness to N = `bands`, by default as many as there are.
        # Raises `InputError` if there are more
        given = self.cube.shape[2]
        bands = given if bands is None else bands
        if bands < given:
            raise InputError(f"{self.name}: {given} bands cannot be padded to {bands}; give more")
        low, high = self.reach
        spectra = np.zeros((self.labels.size, bands), np.float32)
        spectra[:, :given] = self.cube.reshape(-1, given)
        spectra[:, :given] -= low
        spectra[:, :given] /= high - low
        return np.clip(spectra, 0, 1, out=spectra)

    def parts(self, split: str = "random", seed: int = 0) -> tuple[Mask, Mask]:
        """Divide the labelled pixels into a training and a test part, where they are in (H, W)."""
        # ``"random"``: a stratified fifth is for testing. ``"blocks"``: so are the pixels of about
        # a fifth of the 9x9 blocks into which the image is cut: of thirty draws the one with the
        # most classes in both parts. Training pixels that touch a test pixel are left out. A class
        # that lies in one block is not tested. Raises `InputError` if the split is unknown or the
        # classes are too small for it
        check_seed(seed)
        check_choice("split", split, SPLITS)
        counts = np.unique(self.labels[self.labels != 0], return_counts=True)[1]
        if counts.min() < TEST_SHARE:
            raise InputError(
                f"{self.name}: class '{self.class_names[counts.argmin()]}' has {counts.min()} "
                f"pixels; label {TEST_SHARE} or more of each class"
            )
        return _random(self.labels, seed) if split == "random" else self._blocks(seed)

    def _blocks(self, seed: int) -> tuple[Mask, Mask]:
        """The best of some stratified choices: most classes in both parts, nearest to a fifth."""
        from scipy.ndimage import binary_dilation
        from sklearn.model_selection import StratifiedGroupKFold

        labels = self.labels
        rows, columns = np.nonzero(labels)
        kinds = np.unique(labels[rows, columns], return_inverse=True)[1]
        rng = np.random.default_rng(seed)
        down, across = rng.integers(0, BLOCK, 2)
        blocks = (rows + down) // BLOCK * labels.shape[1] + (columns + across) // BLOCK
        if len(np.unique(blocks)) < TEST_SHARE:
            raise InputError(
                f"{self.name}: the labelled pixels lie in fewer than {TEST_SHARE} blocks of "
                f"{BLOCK}x{BLOCK}; split them at random"
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
                    best, merit = (train, test), (both, -distance)
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
        rescale: Range | None = None,
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
        return assemble(
            self.name,
            (spectra[train], y[train].astype(np.int64)),
            (spectra[test], y[test].astype(np.int64)),
            classes=self.class_names,
            described=self._describe(split, spectra.shape[1]),
            rescale=rescale,
            wavelengths=wavelengths,
        )

    def _describe(self, split: str, bands: int) -> str:
        low, high = self.reach
        given = self.cube.shape[2]
        scaled = "" if (low, high) == (0, 1) else f" mapped from [{low:g}, {high:g}] to [0, 1]"
        padded = "" if bands == given else f", padded with darkness to {bands}"
        apart = {
            "random": "a random stratified fifth of the labelled pixels is for testing",
            "blocks": f"about a fifth of the blocks of {BLOCK}x{BLOCK} pixels is for testing, "
            "training pixels beside them are left out",
        }[split]
        return f"{self.origin}{scaled}, {given} bands{padded}; {apart}"


def _random(labels: npt.NDArray[np.integer], seed: int) -> tuple[Mask, Mask]:
    from sklearn.model_selection import train_test_split

    known = np.flatnonzero(labels)
    _, chosen = train_test_split(
        known, test_size=1 / TEST_SHARE, stratify=labels.ravel()[known], random_state=seed
    )
    test = np.zeros(labels.shape, bool)
    test.ravel()[chosen] = True
    return (labels != 0) & ~test, test
