"""A `Dataset` of arrays in memory or in an ``.npz`` file; every other source ends here too."""

import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from deepfsi.datasets.dataset import Dataset, Labels, Reflectance
from deepfsi.errors import InputError

Range: TypeAlias = tuple[float, float]
Scenes: TypeAlias = tuple[npt.ArrayLike, npt.ArrayLike]
"""Scenes (n, H, W) or (n, N), and their labels (n,)."""


class Options(NamedTuple):
    """Options of `load_dataset`, which says what they are."""

    size: int | tuple[int, int] | None
    seed: int
    rescale: Range | None
    images: int | None
    split: str | None


SPLIT_MINIMUM = 5
"""Scenes of a class at least where a test part is drawn: a fifth of fewer may be none."""

ROUNDING = 1e-6
"""Distance of a float from [0, 1] at most, after scaling done elsewhere."""


def from_arrays(
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    x_test: npt.ArrayLike | None = None,
    y_test: npt.ArrayLike | None = None,
    *,
    classes: Sequence[str] | None = None,
    name: str = "arrays",
    seed: int = 0,
    rescale: Range | None = None,
) -> Dataset:
    """Make a data set of arrays in memory. The training scenes are shuffled with the seed.

    Parameters
    ----------
    x : array, shape (n, H, W) for images, (n, N) for spectra
        Scenes. Floats are reflectance in [0, 1]; uint8 is divided by 255.
    y : array, shape (n,)
        Labels, integers or strings. Their sorted values become the classes 0 .. C-1.
    x_test, y_test : array, optional
        The test part, kept in its order. Without it, a stratified fifth is drawn with the seed.
    classes : sequence of str, optional
        Class names. Integer labels then count into them from 0; string labels are among them.
    name : str
        Name of the data set in tables and records.
    seed : int
        Draws the test part and the order of the training scenes, 0 .. 2**32 - 1.
    rescale : (float, float), optional
        Low and high, to which [0, 1] is mapped.

    Returns
    -------
    Dataset

    Raises
    ------
    InputError
        If the arrays do not fit each other or the rules above, or a class has too few scenes.

    Examples
    --------
    >>> import deepfsi
    >>> x, y = [[0.1, 0.9], [0.8, 0.3]] * 10, ["dark", "bright"] * 10
    >>> data = deepfsi.from_arrays(x, y)
    >>> data.classes, data.x_train.shape, data.x_test.shape
    (('bright', 'dark'), (16, 2), (4, 2))
    """
    values = "Divided by 255" if np.asarray(x).dtype == np.uint8 else "As given"
    test = None if x_test is None or y_test is None else (x_test, y_test)
    if test is None and not (x_test is None and y_test is None):
        raise InputError(f"{name}: only one of x_test and y_test is there; give both or neither")
    return split_arrays(
        (x, y), test, classes=classes, name=name, seed=seed, rescale=rescale, values=values
    )


def split_arrays(
    train: Scenes,
    test: Scenes | None,
    *,
    classes: Sequence[str] | None = None,
    name: str,
    seed: int,
    rescale: Range | None,
    values: str,
) -> Dataset:
    """`from_arrays` with a description of the values, for `Dataset.preprocessing`.

    Parameters as of `from_arrays`; without a test part, it is drawn from the training part.
    """
    check_seed(seed)
    x, y = _scenes_and_labels(train, name, "")
    names, numbers = _classes(y, classes, name)
    labels = _class_numbers(y, numbers, f"{name}: y")
    fewest = np.bincount(labels, minlength=len(names)).argmin()
    count = np.count_nonzero(labels == fewest)
    if test is None:
        if count < SPLIT_MINIMUM:
            raise InputError(
                f"{name}: class '{names[fewest]}' has {count} scenes; to draw a test part give "
                f"{SPLIT_MINIMUM} or more of each class, or a test part of your own"
            )
        from sklearn.model_selection import train_test_split

        order, drawn = train_test_split(
            np.arange(len(labels)), test_size=0.2, stratify=labels, random_state=seed
        )
        tested = x[drawn], labels[drawn]
    else:
        if count == 0:
            raise InputError(f"{name}: class '{names[fewest]}' has no training scenes; give some")
        order = np.random.default_rng(seed).permutation(len(labels))
        x_test, y_test = _scenes_and_labels(test, name, "_test")
        tested = x_test, _class_numbers(y_test, numbers, f"{name}: y_test")
        if x_test.shape[1:] != x.shape[1:]:
            raise InputError(
                f"{name}: a scene has shape {x.shape[1:]} in x but {x_test.shape[1:]} in x_test; "
                "bring both to one shape"
            )
    trained = x[order], labels[order]
    return assemble(name, trained, tested, classes=names, values=values, rescale=rescale)


def check_seed(seed: int) -> None:
    """Raise `InputError` for what scikit-learn cannot take as a seed."""
    if not (isinstance(seed, int | np.integer) and 0 <= seed < 2**32):
        raise InputError(f"seed {seed!r}: give an integer from 0 to 2**32 - 1")


def _scenes_and_labels(
    part: Scenes, name: str, suffix: str
) -> tuple[Reflectance, npt.NDArray[Any]]:
    """Reflectance but for rounding, (n, H, W) or (n, N); labels, (n,) integers or strings."""
    scenes, labels = map(np.asarray, part)
    x_name, y_name = f"{name}: x{suffix}", f"{name}: y{suffix}"
    if scenes.ndim not in (2, 3) or scenes.size == 0:
        raise InputError(
            f"{x_name} has shape {scenes.shape}; give (n, H, W) for grey images, (n, N) for spectra"
        )
    if scenes.dtype == np.uint8:
        scenes = unit(scenes)
    elif scenes.dtype.kind == "f":
        low, high = scenes.min(), scenes.max()
        if not (np.isfinite(low) and np.isfinite(high)):
            raise InputError(f"{x_name} holds NaN or infinite values; remove those scenes")
        if low < -ROUNDING or high > 1 + ROUNDING:
            raise InputError(
                f"{x_name} reaches from {low:.4g} to {high:.4g}; reflectance lies in [0, 1]: "
                "rescale it"
            )
        scenes = scenes.astype(np.float32)
    else:
        raise InputError(f"{x_name} is {scenes.dtype}; give floats in [0, 1], or uint8 (0 to 255)")

    if labels.dtype == object and all(isinstance(label, str) for label in labels.flat):
        labels = labels.astype(str)
    if labels.shape != scenes.shape[:1]:
        raise InputError(
            f"{y_name} has shape {labels.shape} for {len(scenes)} scenes; give one label for each"
        )
    if labels.dtype.kind not in "iuU":
        raise InputError(f"{y_name} is {labels.dtype}; give labels that are integers or strings")
    return scenes, labels


def unit(values: npt.NDArray[np.uint8]) -> Reflectance:
    """Reflectance of bytes: a 255th of them."""
    return np.divide(values, 255, dtype=np.float32)


def _classes(
    labels: npt.NDArray[Any], classes: Sequence[str] | None, name: str
) -> tuple[tuple[str, ...], dict[int | str, int]]:
    """Class names, and the class number of each label."""
    known = np.unique(labels).tolist()
    names = tuple(str(label) for label in known) if classes is None else tuple(classes)
    if len(names) < 2:
        raise InputError(f"{name}: only one class, {', '.join(names)}; give two or more")
    if len(set(names)) < len(names):
        raise InputError(f"{name}: classes {', '.join(names)}; give each its own name")
    if classes is not None:
        known = list(names if labels.dtype.kind == "U" else range(len(names)))
    return names, {label: number for number, label in enumerate(known)}


def _class_numbers(labels: npt.NDArray[Any], numbers: dict[int | str, int], what: str) -> Labels:
    unknown = set(labels.tolist()) - numbers.keys()
    if unknown:
        raise InputError(
            f"{what} holds the label {min(unknown)!r}; "
            f"the classes to train on are {', '.join(map(repr, numbers))}"
        )
    return np.array([numbers[label] for label in labels.tolist()], dtype=np.int64)


def assemble(
    name: str,
    train: tuple[Reflectance, Labels],
    test: tuple[Reflectance, Labels],
    *,
    classes: tuple[str, ...],
    values: str,
    rescale: Range | None,
    wavelengths: npt.NDArray[np.float64] | None = None,
) -> Dataset:
    """Data set of scenes that are ready but for rescaling, which is done in place.

    Parameters as of `split_arrays` and `Dataset`; each part is reflectance, (n, H, W) or (n, N),
    and classes, (n,).
    """
    low, high = (0.0, 1.0) if rescale is None else rescale
    if not 0 <= low < high <= 1:
        raise InputError(f"rescale ({low}, {high}): give low and high with 0 <= low < high <= 1")
    if not train[0].any():
        raise InputError(f"{name}: every training scene is dark, all 0; give scenes with light")
    for x, _ in (train, test):
        x *= high - low
        x += low
        np.clip(x, low, high, out=x)
    mapped = "" if (low, high) == (0, 1) else f", then mapped from [0, 1] to [{low:g}, {high:g}]"
    return Dataset(
        name=name,
        x_train=train[0].reshape(len(train[0]), -1),
        y_train=train[1],
        x_test=test[0].reshape(len(test[0]), -1),
        y_test=test[1],
        image_shape=train[0].shape[1:],
        classes=classes,
        preprocessing=f"{values}{mapped}.",
        wavelengths=wavelengths,
    )


def draw_stratified(
    labels: npt.ArrayLike, count: int, seed: int, name: str
) -> npt.NDArray[np.intp]:
    """Sorted indices of scenes drawn so that each class has as nearly its share as can be.

    Parameters
    ----------
    labels : array, shape (n,)
    count : int
        How many scenes to draw, at least one of each class.
    seed : int
    name : str
        Name of the data set, for messages.
    """
    check_seed(seed)
    labels = np.asarray(labels)
    values, numbers, sizes = np.unique(labels, return_inverse=True, return_counts=True)
    if not len(values) <= count <= len(labels):
        raise InputError(
            f"{name}: {count} of {len(labels)} training images were asked for; give "
            f"{len(values)} (one of each class) to {len(labels)}"
        )
    order = np.random.default_rng(seed).permutation(len(labels))
    order = order[np.argsort(numbers[order], kind="stable")]
    rank = np.concatenate([np.arange(size) for size in sizes]) / np.repeat(sizes, sizes)
    return np.sort(order[np.argsort(rank, kind="stable")[:count]])


def load_npz(path: Path, options: Options) -> Dataset:
    """Data set of the arrays `x` and `y`, and of a test part where it is there."""
    if not zipfile.is_zipfile(path):
        raise InputError(f"{path} is no .npz file, or not all of one; write it with numpy.savez")
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (EOFError, OSError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(
            f"cannot read {path} ({error}); "
            "write plain arrays of numbers or strings with numpy.savez"
        ) from error
    if not {"x", "y"} <= arrays.keys() <= {"x", "y", "x_test", "y_test"}:
        raise InputError(
            f"{path} holds {', '.join(arrays) or 'nothing'}; "
            "give x and y, optionally x_test and y_test, and no other names"
        )
    return from_arrays(**arrays, name=path.stem, seed=options.seed, rescale=options.rescale)
