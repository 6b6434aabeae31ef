"""The named designs: which sensing matrix each of them means, before any light law.

Matrices are numpy arrays (m, N), one mask a row, signed unless the design has one rail. Their scale
is arbitrary here, as `LightLaw.fit` brings it to a light law; the scale of `impulse` and `raster`
defines them. With several detectors each sees a tile of the device. A tile has the design's masks
for its own pixels, and all tiles are shown at once.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from deepfsi.base.arrays import read_array, split_variable
from deepfsi.base.errors import InputError, check_choice
from deepfsi.camera.detectors import ONE_DETECTOR, DetectorMap
from deepfsi.camera.names import RailsKind
from deepfsi.datasets.dataset import Dataset

FULL_BASIS_PIXELS = 2048
"""Pixels up to which all principal components are computed at once, which takes their cube."""

Shape = tuple[int, ...]
"""(H, W) of an image, (B,) of a spectrum."""


@dataclass(frozen=True)
class DesignFacts:
    """Facts that the name of a design implies; no other code compares names."""

    label: str
    title: str
    # Makes the sensing matrix (m, N), float64, from data, a number of masks m and a seed
    make: Callable[[Dataset, int, int], np.ndarray] | None = None
    # Largest number of masks, by a scene's shape and the number of classes
    highest: Callable[[Shape, int], int] = lambda shape, classes: math.prod(shape)
    complete: bool = False  # it has the largest number of masks, and no other
    rails: RailsKind | None = None
    every_pixel: bool = False  # it has a detector for each pixel: light law `column`, and no device
    scaled: bool = False  # its scale is what defines it, so that no light law changes it
    specific: bool = False  # its masks are made of the training scenes
    first_of_many: bool = False  # m masks are the first m of all
    seeded: bool = False  # its matrix is drawn from the seed
    of_classes: bool = False  # it needs scenes with classes, not values
    learned: bool = False  # masks are optimised together with the classifier
    learned_under: str | None = None  # noise under which masks are learned, before the classifier
    adaptive: bool = False  # each mask is made from the counts so far
    is_custom: bool = False  # its matrix is the user's

    @property
    def learns_masks(self) -> bool:
        """True if its masks are learned, at once or before its classifier."""
        return self.learned or self.learned_under is not None

    def is_made_at_once(self, pixels: int) -> bool:
        """True if all masks are made at once, and a training takes the first."""
        return self.first_of_many and pixels <= FULL_BASIS_PIXELS

    def count_range(self, image_shape: Shape, classes: int) -> tuple[int, int]:
        """Smallest and largest number of masks for one detector."""
        high = self.highest(image_shape, classes)
        return high if self.complete else 1, high


def _hadamard(data: Dataset, masks: int, seed: int) -> np.ndarray:
    return hadamard_masks(data.image_shape, masks)


def _residues(shape: Shape, classes: int) -> int:
    return s_matrix_order(math.prod(shape))


def _padded_pixels(shape: Shape, classes: int) -> int:
    return math.prod(padded_shape(shape))


DESIGNS: dict[str, DesignFacts] = {
    "impulse": DesignFacts(
        "II",
        "impulse imaging",
        lambda data, masks, seed: np.eye(data.pixels),
        complete=True,
        rails="single",
        every_pixel=True,
    ),
    "raster": DesignFacts(
        "RS",
        "raster scan",
        lambda data, masks, seed: np.eye(data.pixels) / data.pixels,
        complete=True,
        rails="single",
        scaled=True,
    ),
    "hadamard": DesignFacts(
        "HB", "Hadamard basis", _hadamard, highest=_padded_pixels, complete=True, rails="dual"
    ),
    "truncated-hadamard": DesignFacts(
        "TH", "truncated Hadamard", _hadamard, highest=_padded_pixels
    ),
    "pca": DesignFacts(
        "FSI",
        "PCA",
        lambda data, masks, seed: principal_components(data.x_train, masks),
        specific=True,
        first_of_many=True,
    ),
    "deepfsi": DesignFacts("DFSI", "DeepFSI", specific=True, learned=True),
    "control": DesignFacts("CG", "control group", specific=True, learned_under="gaussian"),
    "random": DesignFacts(
        "RND",
        "random ±1",
        lambda data, masks, seed: np.random.default_rng(seed).choice(
            [-1.0, 1.0], size=(masks, data.pixels)
        ),
        seeded=True,
    ),
    "lda": DesignFacts(
        "LDA",
        "linear discriminants",
        lambda data, masks, seed: _discriminants(np.asarray(data.x_train), data.y_train, masks),
        highest=lambda shape, classes: min(classes - 1, math.prod(shape)),
        specific=True,
        of_classes=True,
    ),
    "class-pairs": DesignFacts(
        "CP",
        "differences of class means",
        lambda data, masks, seed: _class_pairs(data.x_train, data.y_train, masks),
        specific=True,
        of_classes=True,
    ),
    "s-matrix": DesignFacts(
        "S",
        "S-matrix",
        lambda data, masks, seed: s_matrix(data.pixels),
        highest=_residues,
        complete=True,
        rails="single",
    ),
    "adaptive": DesignFacts("AM", "adaptive masks", specific=True, of_classes=True, adaptive=True),
    "custom": DesignFacts("USER", "own matrix", is_custom=True),
}
"""The named designs."""

EVERY_PIXEL = {name for name, facts in DESIGNS.items() if facts.every_pixel}
"""Designs with a detector for each pixel, which no camera of one device has."""


ADAPTIVE = {name for name, facts in DESIGNS.items() if facts.adaptive}
"""Designs whose masks are made during the exposure."""


def check_design(name: str) -> str:
    """Return the name of a design, or raise `InputError` that names the closest."""
    check_choice("design", name, DESIGNS)
    return name


def mask_count(ratio: float, pixels: float) -> int:
    """Number of masks at a compression ratio m / N, max(1, round(ratio · N))."""
    return max(1, round(ratio * pixels))


def padded_shape(image_shape: tuple[int, ...]) -> tuple[int, ...]:
    """Shape with each axis padded (dark) to a power of two, as Hadamard codes need."""
    return tuple(1 << (side - 1).bit_length() for side in image_shape)


def sequency_hadamard(order: int) -> np.ndarray:
    """Walsh functions ±1, (order, order): Hadamard rows by their number of sign changes."""
    import scipy.linalg

    rows = scipy.linalg.hadamard(order).astype(np.float64)
    # Sign changes of Walsh functions are all different: 0 to order − 1
    return rows[np.argsort((np.diff(rows, axis=1) != 0).sum(axis=1), kind="stable")]


def hadamard_masks(image_shape: tuple[int, ...], masks: int) -> np.ndarray:
    """Lowest sequencies of the Hadamard basis, ±1, float64 (masks, N).

    For images these are 2-D sequencies (i, j) in the order of (i + j, max(i, j), i), so that at
    most one mask lacks its transpose; for spectra 1-D sequencies.
    """
    padded = padded_shape(image_shape)
    # Padding is dark: those columns are cut off
    axes = [sequency_hadamard(side)[:, :n] for side, n in zip(padded, image_shape, strict=True)]
    if len(axes) == 1:
        return axes[0][:masks]
    height, width = padded
    order = sorted(
        ((i, j) for i in range(height) for j in range(width)),
        key=lambda ij: (ij[0] + ij[1], max(ij), ij[0]),
    )
    return np.stack([np.outer(axes[0][i], axes[1][j]).ravel() for i, j in order[:masks]])


def principal_components(x: np.ndarray, masks: int) -> np.ndarray:
    """Leading principal components (masks, N) of training scenes (n, N), conventional FSI."""
    import scipy.linalg

    pixels = x.shape[1]
    # A pixel that is the same in all scenes is in no component
    varying = np.flatnonzero(x.max(axis=0) != x.min(axis=0))
    # A full decomposition takes the cube of the pixels, a few components much less
    few = FULL_BASIS_PIXELS < len(varying) > 4 * masks < len(x)
    lit = x[:, varying]
    mean = lit.mean(axis=0, dtype=np.float64)
    if few:
        power, directions = _leading(lit, mean, masks)
    else:
        power, directions = scipy.linalg.eigh(_scatter(lit, mean))
    # Below rounding a direction is arbitrary
    real = power > pixels * np.finfo(np.float64).eps * power.max(initial=0)
    rows = np.zeros((min(masks, int(real.sum())), pixels))
    rows[:, varying] = directions[:, real].T[::-1][:masks]
    # The sign is free: by convention the largest entry is positive
    rows = rows * np.sign(rows[np.arange(len(rows)), np.abs(rows).argmax(axis=1)])[:, None]
    if len(rows) == masks:
        return rows
    # Too few directions: axes of pixels complete the basis, the least explained first
    unexplained = np.eye(pixels) - rows.T @ rows
    basis, _, _ = scipy.linalg.qr(unexplained, pivoting=True)
    rest = basis[:, : masks - len(rows)].T
    rest = rest * np.sign(rest[np.arange(len(rest)), np.abs(rest).argmax(axis=1)])[:, None]
    return np.concatenate([rows, rest])


def _scatter(x: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Scatter matrix (N, N) of scenes (n, N) about their mean."""
    scatter = np.zeros((len(mean), len(mean)))
    # In chunks, as centred scenes are float64
    for chunk in np.array_split(x, -(-len(x) // 8192)):
        centred = chunk - mean
        scatter += centred.T @ centred
    return scatter


def _leading(x: np.ndarray, mean: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Largest eigenvalues of the scatter matrix of scenes (n, N), rising; vectors (N, count)."""
    from scipy.sparse.linalg import LinearOperator, eigsh

    centred = x - mean.astype(x.dtype)
    # Applied, and never formed: it has N² entries
    scatter = LinearOperator(
        (x.shape[1], x.shape[1]),
        matvec=lambda vector: centred.T @ (centred @ vector.ravel()),
        dtype=x.dtype,
    )
    # ARPACK draws another start at each call
    start = np.random.default_rng(0).standard_normal(x.shape[1], dtype=np.float32)
    power, directions = eigsh(scatter, k=count, v0=start)
    return power.astype(np.float64), directions.astype(np.float64)


def _discriminants(x: np.ndarray, y: np.ndarray, masks: int) -> np.ndarray:
    """Linear discriminants (masks, N), unit rows, of x (n, N) and y (n,): at most C − 1."""
    from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

    # Without shrinkage constant pixels leave the scatter singular
    model = LinearDiscriminantAnalysis(solver="eigen", shrinkage="auto").fit(x, y)
    rows = model.scalings_.T[:masks]
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def _class_pairs(x: np.ndarray, y: np.ndarray, masks: int) -> np.ndarray:
    """Differences of two classes' mean scenes, (masks, N), unit rows, of x (n, N) and y (n,)."""
    means = np.stack([x[y == label].mean(axis=0, dtype=np.float64) for label in np.unique(y)])
    first, second = np.triu_indices(len(means), k=1)
    pairs = means[first] - means[second]
    length = np.linalg.norm(pairs, axis=1)
    differ = length > 0
    pairs = pairs[differ]
    length = length[differ]
    # Pairs that differ least come first
    order = np.argsort(length, kind="stable")[:masks]
    rows = pairs[order] / length[order, None]
    if len(rows) == masks:
        return rows
    # There are fewer pairs of different means than masks
    return np.concatenate([rows, principal_components(x, masks - len(rows))])


@lru_cache
def s_matrix_order(pixels: int) -> int:
    """Smallest prime p ≡ 3 (mod 4) that is at least `pixels`: an S-matrix of that order exists."""
    order = max(pixels, 3)
    while order % 4 != 3 or any(order % k == 0 for k in range(3, int(order**0.5) + 1, 2)):
        order += 1
    return order


def s_matrix(pixels: int) -> np.ndarray:
    """Cyclic S-matrix (p, pixels) from quadratic residues, the non-negative Hadamard code."""
    # Entries are 0 or 1. A full row has (p + 1) / 2 ones; pixels beyond the scene's own are dark
    order = s_matrix_order(pixels)
    row = np.zeros(order)
    row[np.arange(order) ** 2 % order] = 1  # Paley's construction, for p ≡ 3 (mod 4)
    index = np.arange(order)
    return row[(index[:, None] + index[None, :]) % order][:, :pixels]


def _tiles(image_shape: Shape, detectors: DetectorMap) -> Iterator[tuple[np.ndarray, Shape]]:
    """Yield indices of the pixels of each detector, and their shape: a rectangle or a row."""
    labels = detectors.labels
    if labels is None:
        yield np.arange(math.prod(image_shape)), image_shape
        return
    for detector in range(detectors.count):
        pixels = np.flatnonzero(labels == detector)
        box = tuple(int(np.ptp(axis)) + 1 for axis in np.unravel_index(pixels, image_shape))
        yield pixels, box if math.prod(box) == len(pixels) else (len(pixels),)


def count_allowed(
    name: str, data: Dataset, detectors: DetectorMap = ONE_DETECTOR
) -> tuple[int, int]:
    """Smallest and largest number of masks of a design, for its largest tile."""
    shapes = {shape for _, shape in _tiles(data.image_shape, detectors)}
    ranges = [DESIGNS[name].count_range(shape, len(data.classes)) for shape in shapes]
    return max(low for low, _ in ranges), max(high for _, high in ranges)


def check_count(
    name: str, masks: int, data: Dataset, detectors: DetectorMap = ONE_DETECTOR
) -> None:
    """Raise `InputError` if a design cannot have this number of masks on this data."""
    low, high = count_allowed(name, data, detectors)
    if not low <= masks <= high:
        allowed = f"exactly {low}" if low == high else f"a whole number from {low} to {high}"
        many = f" with {detectors.count} detectors" if detectors.count > 1 else ""
        raise InputError(
            f"{masks} masks are not allowed for {name} on {data.name}{many}: give {allowed}"
        )


def sensing_matrix(
    name: str, masks: int, data: Dataset, seed: int = 0, detectors: DetectorMap = ONE_DETECTOR
) -> np.ndarray:
    """Sensing matrix (m, N) of a fixed design, float64, signed; each detector sees its tile.

    Where a tile can have fewer masks, the others are dark there.
    """
    check_count(name, masks, data, detectors)
    facts = DESIGNS[name]
    assert facts.make is not None
    if detectors.count == 1:
        return facts.make(data, masks, seed)
    matrix = np.zeros((masks, data.pixels))
    for pixels, shape in _tiles(data.image_shape, detectors):
        x_train = data.x_train[:, pixels]
        scenes = replace(data, x_train=x_train, x_test=data.x_test[:, pixels], image_shape=shape)
        low, high = facts.count_range(shape, len(data.classes))
        count = min(max(masks, low), high)
        matrix[:count, pixels] = facts.make(scenes, count, seed)
    # A mask takes 1 / m of the time in every tile, also in one of fewer pixels
    return np.where(matrix > 0, 1 / masks, 0.0) if facts.scaled else matrix


def read_matrix(source: str) -> np.ndarray:
    """A user's own masks (m, N), from an array or a MATLAB variable in a file."""
    path, variable = split_variable(source)
    ways = (
        "a .npy file, or a .mat file with one numeric variable (or FILE:VARIABLE), of shape "
        "(m, N) or (m, H, W)"
    )
    if not path.exists():
        raise InputError(f"no matrix at {path}: give {ways}")
    masks = read_array(path, (2, 3), variable)
    if masks.ndim not in (2, 3) or not masks.size:
        raise InputError(f"{path} holds an array of shape {masks.shape}: give {ways}")
    # Grey levels: the highest passes all light, for 1 / m of the time
    if masks.dtype.kind in "bu" and masks.dtype.itemsize <= 2:
        full = 1 if masks.max() <= 1 else int(np.iinfo(masks.dtype).max)
        masks = masks / (full * len(masks))
    return masks.reshape(len(masks), -1)
