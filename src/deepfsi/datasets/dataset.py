"""Labelled scenes in a training and a test part, and what loads them again."""

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from deepfsi.base.errors import InputError
from deepfsi.base.models import Count
from deepfsi.datasets.alike import Groups, deal, groups_of_alike

Reflectance: TypeAlias = npt.NDArray[np.float32]
Labels: TypeAlias = npt.NDArray[np.int64]
Truth: TypeAlias = npt.NDArray[Any]
"""Classes (n,) int64, or values (n, q) float32."""

Ends: TypeAlias = tuple[float, float]
"""Low and high."""

MeasureTitle = Literal["accuracy", "R²"]
"""What the answers to a data set are measured by."""


class Origin(BaseModel):
    """Name or path of a data set, and the options it was loaded with."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    data: str  # name, or absolute path
    # As in `load_dataset`; white is the one in force, where the type of the values has none
    size: tuple[Count, Count] | None = None
    seed: int = Field(default=0, ge=0, lt=2**32)  # as scikit-learn takes it
    rescale: Ends | None = None
    images: int | None = None
    split: str | None = None
    white: float | None = None
    # Files of earlier versions have these two, of options that left
    skip_bad: bool = False
    normal: None = None
    # Absolute path of the calibration folder of the camera that sees the scenes
    view: str | None = None
    # Which of how many folds its test part is, from 0; None, and left out of files, for none
    fold: tuple[int, int] | None = Field(default=None, exclude_if=lambda fold: fold is None)

    @property
    def words(self) -> str:
        """Name or path, with size and camera."""
        size = f" at {self.size[0]}x{self.size[1]}" if self.size else ""
        view = f" as the camera of {self.view} sees it" if self.view else ""
        fold = f", fold {self.fold[0] + 1} of {self.fold[1]}" if self.fold else ""
        return f"{self.data}{size}{view}{fold}"


@dataclass(frozen=True, eq=False, repr=False)
class Dataset:
    """Scenes in a training and a test part, with the class or the values of each.

    Attributes
    ----------
    name : str
        Name in tables and records.
    x_train, x_test : array, shape (n, N), float32
        Reflectance after preprocessing, dimensionless in [0, 1].
    y_train, y_test : array
        Class of each scene, 0 .. C-1, (n,) int64; or its values, (n, q) float32.
    image_shape : tuple of int
        (H, W) for images, (B,) for spectra of B bands; its product is N.
    classes : tuple of str
        The C class names, in the order of the labels; none where scenes have values.
    preprocessing : str
        Changes made to the source's values, in one sentence.
    white : float or None
        Value of the source that became reflectance 1, where its type alone does not say it.
    origin : Origin or None
        What loads it again; None for arrays in memory, and for scenes changed after loading.
    held_out : int
        Training scenes that `hold_out` left out.
    values : tuple of str
        Names of the q values of a scene, such as its position; empty if scenes have classes.
    drawn : bool
        Whether the test part was drawn from the scenes at random, so that `folds` may draw others.

    Examples
    --------
    >>> import deepfsi
    >>> data = deepfsi.load_dataset("digits")
    >>> data.pixels, len(data.classes), data.x_train.shape
    (64, 10, (1437, 64))
    >>> data.hold_out(437).x_train.shape
    (1000, 64)
    """

    name: str
    x_train: Reflectance
    y_train: Truth
    x_test: Reflectance
    y_test: Truth
    image_shape: tuple[int, ...]
    classes: tuple[str, ...]
    preprocessing: str
    white: float | None = None
    origin: Origin | None = None
    held_out: int = 0
    values: tuple[str, ...] = ()
    drawn: bool = False

    def __repr__(self) -> str:
        shape = "x".join(map(str, self.image_shape))
        answers = f"{len(self.classes)} classes" if self.classes else ", ".join(self.values)
        return (
            f"<Dataset {self.name}: {len(self.x_train)} training and {len(self.x_test)} test "
            f"scenes of {shape}, {answers}>"
        )

    @property
    def pixels(self) -> int:
        """Number of pixels (or bands) of a scene, N."""
        return int(self.x_train.shape[1])

    @property
    def answers(self) -> int:
        """Number of a network's outputs: one for each class, or for each value."""
        return len(self.classes or self.values)

    @property
    def groups(self) -> Labels:
        """Class of each training scene (n,); scenes with values share one."""
        return self.y_train if self.classes else np.zeros(len(self.y_train), dtype=np.int64)

    @cached_property
    def alike(self) -> Groups:
        """Group (n,) of each training scene: pictures that are alike share one."""
        return groups_of_alike(self.x_train.reshape(-1, *self.image_shape), self.groups)

    @property
    def measure(self) -> MeasureTitle:
        """Accuracy; of values R², the share of their variance that the answers explain."""
        return "R²" if self.values else "accuracy"

    @property
    def chance(self) -> float:
        """Measure of guessing: the share of the commonest class of the test; 0 R²."""
        if self.measure == "accuracy":
            return float(np.bincount(self.y_test).max() / len(self.y_test))
        return 0.0

    @cached_property
    def hash(self) -> str:
        """SHA-256 in hex over the arrays, their shapes and the names of classes or values."""
        arrays = (self.x_train, self.y_train, self.x_test, self.y_test)
        # Other scenes may have the same bytes in another shape
        shapes = [array.shape for array in arrays]
        words = json.dumps([shapes, self.image_shape, self.classes or self.values])
        digest = hashlib.sha256(words.encode())
        for array in arrays:
            digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()

    def hold_out(self, count: int | None = None) -> "Dataset":
        """Set the last training scenes aside for validation; the test scenes are left out.

        The test part is then those `count` scenes, by default one sixth (10 000 of MNIST's 60 000),
        the training part the rest; both are views. Raises `InputError` if that leaves nothing to
        validate on, or some class nothing to train on.
        """
        n = len(self.x_train)
        count = n // 6 if count is None else count
        rest = n - count
        sizes = np.bincount(self.groups[: max(rest, 0)], minlength=len(self.classes))
        if not (0 < count < n and sizes.all()):
            raise InputError(
                f"{self.name}: {count} of {n} training scenes held out for validation; hold out 1 "
                "or more, and leave some of each class to train on"
            )
        return replace(
            self,
            x_train=self.x_train[:rest],
            y_train=self.y_train[:rest],
            x_test=self.x_train[rest:],
            y_test=self.y_train[rest:],
            held_out=count,
            drawn=False,
        )

    def folds(self, count: int, seed: int = 0) -> list["Dataset"]:
        """Divide the scenes anew into folds, in which each is a test scene once.

        Each fold has its share of every class. Raises `InputError` if the test part was not drawn
        from the scenes, or they are too few.
        """
        if not self.drawn:
            raise InputError(
                f"{self.name} has a test part of its own: it has no folds, leave `folds` out or "
                "give 1"
            )
        x = np.concatenate([self.x_train, self.x_test])
        y = np.concatenate([self.y_train, self.y_test])
        labels = y if self.classes else np.zeros(len(y), dtype=np.int64)
        groups = groups_of_alike(x.reshape(-1, *self.image_shape), labels)
        _, first = np.unique(groups, return_index=True)
        fewest = int(np.bincount(labels[first]).min())
        if not 2 <= count <= fewest:
            least = "scenes of the smallest class" if self.classes else "scenes"
            raise InputError(
                f"{self.name}: {count} folds of {fewest} {least}: give 2 to {max(fewest, 2)}"
            )
        order = np.random.default_rng(seed).permutation(len(y))
        # The scenes of a class go to the folds in turn, so that each has its share
        fold = np.empty(len(y), dtype=np.int64)
        fold[np.argsort(labels[order], kind="stable")] = np.arange(len(y)) % count
        if len(first) < len(y):
            fold = deal(groups, labels, count, seed)[order]
        return [
            replace(
                self,
                name=f"{self.name}, fold {number + 1} of {count}",
                x_train=x[order[fold != number]],
                y_train=y[order[fold != number]],
                x_test=x[order[fold == number]],
                y_test=y[order[fold == number]],
                origin=self.origin and self.origin.model_copy(update={"fold": (number, count)}),
                drawn=False,
            )
            for number in range(count)
        ]
