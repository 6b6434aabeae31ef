"""Arrays in memory or in an ``.npz`` file become a `Dataset`; every other source ends here too."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from deepfsi.datasets.dataset import Dataset, Labels, Reflectance
from deepfsi.errors import InputError

Range: TypeAlias = tuple[float, float]

SPLIT_MINIMUM = 5  # scenes per class: a fifth of fewer may be none
ROUNDING = 1e-6  # how far a float may lie outside [0, 1] after scaling done elsewhere


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
    x
        Scenes: (n, H, W) for images, (n, N) for spectra. Floats are reflectance in [0, 1];
        uint8 is divided by 255.
    y
        Labels, (n,) integers or strings. Their sorted values become the classes 0 .. C-1.
    x_test, y_test
        The test part, kept in its order. Without it, a stratified fifth of the scenes, drawn with
        the seed, is set aside.
    classes
        Class names. Integer labels then count into them from 0; string labels are among them.
    name
        What the data set is called.
    seed
        Draws the test part and the order of the training scenes, 0 .. 2**32 - 1.
    rescale
        (low, high) to which [0, 1] is mapped; by default no change.

    Returns
    -------
    Dataset

    Raises
    ------
    InputError
        If the arrays do not fit each other or the rules above; if there are fewer than two
        classes, none to learn from in one of them, or, where a test part is to be drawn, fewer
        than five scenes in one.
    """
    return split_arrays(
        x,
        y,
        x_test,
        y_test,
        classes=classes,
        name=name,
        seed=seed,
        rescale=rescale,
        values="Divided by 255" if np.asarray(x).dtype == np.uint8 else "As given",
    )


def split_arrays(
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    x_test: npt.ArrayLike | None = None,
    y_test: npt.ArrayLike | None = None,
    *,
    classes: Sequence[str] | None = None,
    name: str,
    seed: int,
    rescale: Range | None,
    values: str,
) -> Dataset:
    """`from_arrays`, where `values` says how the values given came about."""
    check_seed(seed)
    scenes, labels = _scenes_and_labels(x, y, f"{name}: x", f"{name}: y")
    names, numbers = _classes(labels, classes, name)
    y_all = _class_numbers(labels, numbers, f"{name}: y")
    fewest = np.bincount(y_all, minlength=len(names)).argmin()
    count = np.count_nonzero(y_all == fewest)

    if x_test is None and y_test is None:
        if count < SPLIT_MINIMUM:
            raise InputError(
                f"{name}: class '{names[fewest]}' has {count} scenes; to draw a test part give "
                f"{SPLIT_MINIMUM} or more of each class, or a test part of your own"
            )
        from sklearn.model_selection import train_test_split

        train, test = train_test_split(
            np.arange(len(y_all)), test_size=0.2, stratify=y_all, random_state=seed
        )
        scenes_test, y_test_part = scenes[test], y_all[test]
    elif x_test is None or y_test is None:
        raise InputError(f"{name}: only one of x_test and y_test is there; give both or neither")
    else:
        if count == 0:
            raise InputError(f"{name}: class '{names[fewest]}' has no training scenes; give some")
        train = np.random.default_rng(seed).permutation(len(y_all))
        scenes_test, labels_test = _scenes_and_labels(
            x_test, y_test, f"{name}: x_test", f"{name}: y_test"
        )
        y_test_part = _class_numbers(labels_test, numbers, f"{name}: y_test")
        if scenes_test.shape[1:] != scenes.shape[1:]:
            raise InputError(
                f"{name}: a scene has shape {scenes.shape[1:]} in x but {scenes_test.shape[1:]} "
                "in x_test; bring both to one shape"
            )
    return assemble(
        name, scenes[train], y_all[train], scenes_test, y_test_part, names, values, rescale
    )


def check_seed(seed: int) -> None:
    """Refuse what scikit-learn cannot take as a seed."""
    if not (isinstance(seed, int | np.integer) and 0 <= seed < 2**32):
        raise InputError(f"seed {seed!r}: give an integer from 0 to 2**32 - 1")


def _scenes_and_labels(
    x: npt.ArrayLike, y: npt.ArrayLike, x_name: str, y_name: str
) -> tuple[Reflectance, npt.NDArray[Any]]:
    """Reflectance but for rounding, (n, H, W) or (n, N); labels, (n,) integers or strings."""
    scenes, labels = np.asarray(x), np.asarray(y)
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
    """Bytes as reflectance: divided by 255."""
    return np.divide(values, 255, dtype=np.float32)


def _classes(
    labels: npt.NDArray[Any], classes: Sequence[str] | None, name: str
) -> tuple[tuple[str, ...], dict[int | str, int]]:
    """Find the class names, and the class number of each label."""
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
    x_train: Reflectance,
    y_train: Labels,
    x_test: Reflectance,
    y_test: Labels,
    classes: tuple[str, ...],
    values: str,
    rescale: Range | None,
    wavelengths: npt.NDArray[np.float64] | None = None,
) -> Dataset:
    """Flatten and rescale, in place, scenes that are otherwise ready."""
    low, high = (0.0, 1.0) if rescale is None else rescale
    if not 0 <= low < high <= 1:
        raise InputError(f"rescale ({low}, {high}): give low and high with 0 <= low < high <= 1")
    if not x_train.any():
        raise InputError(f"{name}: every training scene is dark, all 0; give scenes with light")
    for x in (x_train, x_test):
        x *= high - low
        x += low
        np.clip(x, low, high, out=x)
    mapped = "" if (low, high) == (0, 1) else f", then mapped from [0, 1] to [{low:g}, {high:g}]"
    return Dataset(
        name=name,
        x_train=x_train.reshape(len(x_train), -1),
        y_train=y_train,
        x_test=x_test.reshape(len(x_test), -1),
        y_test=y_test,
        image_shape=x_train.shape[1:],
        classes=classes,
        preprocessing=f"{values}{mapped}.",
        wavelengths=wavelengths,
    )


def draw_stratified(
    labels: npt.ArrayLike, count: int, seed: int, name: str
) -> npt.NDArray[np.intp]:
    """Draw `count` scenes, of each class as nearly its share as can be; sorted indices."""
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


def load_npz(path: Path, seed: int, rescale: Range | None) -> Dataset:
    """Load `x` and `y`, and the test part where it is there, from an ``.npz`` file."""
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
    return from_arrays(**arrays, name=path.stem, seed=seed, rescale=rescale)
