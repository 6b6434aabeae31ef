"""The named designs: which sensing matrix each of them means, before any light law.

Matrices are numpy arrays (m, N), one mask a row, signed unless the design has one rail. Their scale
is arbitrary here (`LightLaw.fit` brings it to a light law) but for `impulse` and
`raster`, whose scale is what defines them. Under several detectors each one's part of the device
has masks of its own, the design of that part, all at once.
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
    """All that the name of a design implies; nobody else compares names."""

    label: str
    title: str
    # Sensing matrix (m, N), float64, of data, a number of masks m and a seed
    make: Callable[[Dataset, int, int], np.ndarray] | None = None
    # Largest number of masks, of a scene's shape and the number of classes
    most: Callable[[Shape, int], int] = lambda shape, classes: math.prod(shape)
    complete: bool = False  # it has the largest number of masks, and no other
    rails: RailsKind | None = None
    every_pixel: bool = False  # it has a detector for each pixel: light law `column`, and no device
    scaled: bool = False  # its scale is what defines it, so that no light law changes it
    specific: bool = False  # its masks are made of the training scenes
    first_of_many: bool = False  # few masks are the first of all
    seeded: bool = False  # its matrix is drawn from the seed
    of_classes: bool = False
    learned: bool = False  # masks are optimised together with the classifier
    learned_under: str | None = None  # noise under which they are, before a classifier of their own
    adaptive: bool = False  # masks are each made from the counts so far
    is_custom: bool = False  # its matrix is the user's

    @property
    def learns_masks(self) -> bool:
        """True if its masks are learned, at once or before its classifier."""
        return self.learned or self.learned_under is not None

    def is_made_whole(self, pixels: int) -> bool:
        """True if all masks are made at once, and a training takes the first."""
        return self.first_of_many and pixels <= FULL_BASIS_PIXELS

    def counts(self, image_shape: Shape, classes: int) -> tuple[int, int]:
        """Smallest and largest number of masks for one detector."""
        most = self.most(image_shape, classes)
        return most if self.complete else 1, most


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
        "HB", "Hadamard basis", _hadamard, most=_padded_pixels, complete=True, rails="dual"
    ),
    "truncated-hadamard": DesignFacts("TH", "truncated Hadamard", _hadamard, most=_padded_pixels),
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
        most=lambda shape, classes: min(classes - 1, math.prod(shape)),
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
        most=_residues,
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
    axes = [sequency_hadamard(side)[:, :own] for side, own in zip(padded, image_shape, strict=True)]
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
    # The largest entry of each component is positive. Where the data has fewer directions than
    # masks are asked for, pixels' own directions complete the basis, those least explained first
    import scipy.linalg

    pixels = x.shape[1]
    varying = np.flatnonzero(x.max(axis=0) != x.min(axis=0))
    few = FULL_BASIS_PIXELS < len(varying) > 4 * masks < len(x)
    lit = x[:, varying]
    mean = lit.mean(axis=0, dtype=np.float64)
    if few:
        power, directions = _leading(lit, mean, masks)
    else:
        power, directions = scipy.linalg.eigh(_scatter(lit, mean))
    known = power > pixels * np.finfo(np.float64).eps * power.max(initial=0)
    rows = np.zeros((min(masks, int(known.sum())), pixels))
    rows[:, varying] = directions[:, known].T[::-1][:masks]
    rows = rows * np.sign(rows[np.arange(len(rows)), np.abs(rows).argmax(axis=1)])[:, None]
    if len(rows) == masks:
        return rows
    unexplained = np.eye(pixels) - rows.T @ rows
    basis, _, _ = scipy.linalg.qr(unexplained, pivoting=True)
    rest = basis[:, : masks - len(rows)].T
    rest = rest * np.sign(rest[np.arange(len(rest)), np.abs(rest).argmax(axis=1)])[:, None]
    return np.concatenate([rows, rest])


def _scatter(x: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Scatter matrix (N, N) of scenes (n, N) about their mean."""
    scatter = np.zeros((len(mean), len(mean)))
    for part in np.array_split(x, -(-len(x) // 8192)):
        centred = part - mean
        scatter += centred.T @ centred
    return scatter


def _leading(x: np.ndarray, mean: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Largest eigenvalues of the scatter matrix of scenes (n, N), rising; vectors (N, count)."""
    from scipy.sparse.linalg import LinearOperator, eigsh

    centred = x - mean.astype(x.dtype)
    scatter = LinearOperator(  # applied and not made
        (x.shape[1], x.shape[1]),
        matvec=lambda vector: centred.T @ (centred @ vector.ravel()),
        dtype=x.dtype,
    )
    # ARPACK's own start differs from call to call
    start = np.random.default_rng(0).standard_normal(x.shape[1], dtype=np.float32)
    power, directions = eigsh(scatter, k=count, v0=start)
    return power.astype(np.float64), directions.astype(np.float64)


def _discriminants(x: np.ndarray, y: np.ndarray, masks: int) -> np.ndarray:
    """Linear discriminant directions, the supervised linear baseline that PCA is not."""
    # Unit rows, at most one fewer than there are classes
    from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

    model = LinearDiscriminantAnalysis(solver="eigen", shrinkage="auto").fit(x, y)
    rows = model.scalings_.T[:masks]
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def _class_pairs(x: np.ndarray, y: np.ndarray, masks: int) -> np.ndarray:
    """Differences of the mean scenes of two classes as unit rows, pairs that differ least first."""
    # As frames of one rail a pair is what one class has more than the other, and the reverse. Where
    # there are fewer pairs of different means than masks, principal components follow. x (n, N); y
    # (n,)
    means = np.stack([x[y == label].mean(axis=0, dtype=np.float64) for label in np.unique(y)])
    first, second = np.triu_indices(len(means), k=1)
    pairs = means[first] - means[second]
    length = np.linalg.norm(pairs, axis=1)
    differ = length > 0
    pairs = pairs[differ]
    length = length[differ]
    order = np.argsort(length, kind="stable")[:masks]
    rows = pairs[order] / length[order, None]
    if len(rows) == masks:
        return rows
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
    # Its order p is `s_matrix_order`; pixels beyond the scene's own are dark. Entries are 0 or 1,
    # and every full row holds (p + 1) / 2 ones
    order = s_matrix_order(pixels)
    row = np.zeros(order)
    row[np.arange(order) ** 2 % order] = 1  # Paley's construction, for p ≡ 3 (mod 4)
    index = np.arange(order)
    return row[(index[:, None] + index[None, :]) % order][:, :pixels]


def _tiles(image_shape: Shape, detectors: DetectorMap) -> Iterator[tuple[np.ndarray, Shape]]:
    """Pixels that each detector sees, as indices, and their shape: of a rectangle, else a row."""
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
    ranges = [DESIGNS[name].counts(shape, len(data.classes)) for shape in shapes]
    return max(low for low, _ in ranges), max(high for _, high in ranges)


def check_count(
    name: str, masks: int, data: Dataset, detectors: DetectorMap = ONE_DETECTOR
) -> None:
    """Raise `InputError` if a design cannot have so many masks on this data."""
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
    """Sensing matrix (m, N) of a fixed design, float64, signed; each detector sees its tile of it.

    Where a tile can have fewer masks, the others are dark there.
    """
    check_count(name, masks, data, detectors)
    facts = DESIGNS[name]
    assert facts.make is not None
    if detectors.count == 1:
        return facts.make(data, masks, seed)
    whole = np.zeros((masks, data.pixels))
    for pixels, shape in _tiles(data.image_shape, detectors):
        x_train = data.x_train[:, pixels]
        scenes = replace(data, x_train=x_train, x_test=data.x_test[:, pixels], image_shape=shape)
        low, high = facts.counts(shape, len(data.classes))
        count = min(max(masks, low), high)
        whole[:count, pixels] = facts.make(scenes, count, seed)
    return np.where(whole > 0, 1 / masks, 0.0) if facts.scaled else whole


def read_matrix(source: str) -> np.ndarray:
    """A user's own masks (m, N), of an array or a MATLAB variable in a file."""
    path, variable = split_variable(source)
    ways = (
        "a .npy file, or a .mat file with one numeric variable (or FILE:VARIABLE), of shape "
        "(m, N) or (m, H, W)"
    )
    if not path.exists():
        raise InputError(f"no matrix at {path}: give {ways}")
    # A small file may claim more than memory holds
    masks = read_array(path, (2, 3), variable)
    if masks.ndim not in (2, 3) or not masks.size:
        raise InputError(f"{path} holds an array of shape {masks.shape}: give {ways}")
    if masks.dtype.kind in "bu" and masks.dtype.itemsize <= 2:  # levels, the last of all light
        full = 1 if masks.max() <= 1 else int(np.iinfo(masks.dtype).max)
        masks = masks / (full * len(masks))
    return masks.reshape(len(masks), -1)
