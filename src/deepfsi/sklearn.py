"""A design as a classifier of scikit-learn: for its pipelines, searches and cross-validation."""

import zlib
from collections import Counter
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import torch
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.utils import Tags, check_random_state
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, check_non_negative, validate_data

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT
from deepfsi.camera.camera import CameraSource
from deepfsi.datasets.arrays import from_arrays
from deepfsi.physics.surroundings import library_defaults
from deepfsi.training.learning import learn


class DeepFSIClassifier(ClassifierMixin, BaseEstimator):  # type: ignore[misc]  # it has no types
    """Classifier of scenes by what a single-pixel camera counts of them, for scikit-learn.

    `fit` learns masks and network together. `predict` and `predict_proba` simulate an exposure of
    each scene under the camera's noise. Its draws follow from `random_state` and the scene, so that
    both see the same counts, in any order; a scene that is given twice is exposed twice.

    Parameters
    ----------
    photons : float, optional
        Budget Φ of an exposure: expected photons on the device. None is the camera's.
    masks : int
        Number of masks, m; of scenes with fewer pixels as many as these.
    design : str
        As for `learn`: ``"deepfsi"`` learns its masks, ``"pca"``, … have fixed ones.
    camera : Camera, str, path or mapping, optional
        A camera, a preset's name, a TOML file or fields. Default: ``"dmd"``.
    epochs : int, optional
        Passes over the training scenes. Default: that of the design.
    image_shape : (int, int), optional
        Height and width of the scenes, where detectors, patches or a device need them. Default:
        scenes have one axis.
    random_state : int, RandomState instance or None
        Seed of the training and of the noise.

    Attributes
    ----------
    classes_ : array, shape (C,)
        Labels of the classes.
    design_ : Design
        What was learned: to save it, export it or test it at other budgets.
    white_ : float
        Value that is reflectance 1: the largest of the training scenes, and at least 1.
    n_features_in_ : int
        Pixels of a scene, N.

    Examples
    --------
    >>> import deepfsi
    >>> from sklearn.datasets import load_digits
    >>> x, y = load_digits(n_class=2, return_X_y=True)
    >>> classifier = deepfsi.DeepFSIClassifier(photons=1e4, masks=4, epochs=5, random_state=0)
    >>> classifier.fit(x / 16, y).predict_proba(x[:3] / 16).shape
    (3, 2)
    """

    def __init__(
        self,
        photons: float | None = 1e4,
        masks: int = 10,
        *,
        design: str = "deepfsi",
        camera: CameraSource = None,
        epochs: int | None = None,
        image_shape: tuple[int, int] | None = None,
        random_state: int | np.random.RandomState | None = None,
    ) -> None:
        self.photons = photons
        self.masks = masks
        self.design = design
        self.camera = camera
        self.epochs = epochs
        self.image_shape = image_shape
        self.random_state = random_state

    def __sklearn_tags__(self) -> Tags:
        """Facts for scikit-learn: scenes are light, 0 or more."""
        tags = super().__sklearn_tags__()
        tags.input_tags.positive_only = True
        return tags

    def fit(self, X: npt.ArrayLike, y: npt.ArrayLike) -> Self:
        """Learn masks and network of scenes (n, N) in [0, 1] and their labels (n,)."""
        x, y = validate_data(self, X, y, dtype=np.float64, ensure_min_samples=2)
        check_non_negative(x, "DeepFSIClassifier")
        check_classification_targets(y)
        self.classes_, labels = np.unique(y, return_inverse=True)
        self.white_ = max(1.0, float(x.max()))
        self.seed_ = int(check_random_state(self.random_state).randint(2**31))
        shape = self.image_shape or (x.shape[1],)
        if np.prod(shape) != x.shape[1]:
            raise InputError(f"scenes of {x.shape[1]} pixels do not fit the image shape {shape}")
        scenes = self._scenes(x).reshape(-1, *shape)
        # Nothing is held out: scikit-learn tests with scenes of its own
        data = from_arrays(scenes, labels, scenes, labels, seed=self.seed_)
        self.design_ = learn(
            data,
            design=self.design,
            masks=min(self.masks, x.shape[1]),
            photons=self.photons,
            camera=self.camera,
            training=None if self.epochs is None else {"epochs": self.epochs},
            seed=self.seed_,
            report=SILENT,
        ).to("cpu")
        return self

    def predict(self, X: npt.ArrayLike) -> npt.NDArray[Any]:
        """Labels (n,) of scenes (n, N), each from one exposure."""
        best = self.predict_proba(X).argmax(axis=1)
        return self.classes_[best]

    @library_defaults(grad=False)
    def predict_proba(self, X: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Probabilities (n, C) of the classes of scenes (n, N), each from one exposure."""
        check_is_fitted(self)
        scenes = self._scenes(validate_data(self, X, dtype=np.float64, reset=False))
        camera = self.design_.camera
        budget = self.design_.info["job"]["photons"]
        times: Counter[int] = Counter()
        rows = []
        for scene in scenes:
            key = zlib.crc32(scene.tobytes(), self.seed_)
            times[key] += 1
            generator = torch.Generator().manual_seed(zlib.crc32(b"%d" % times[key], key))
            expose = self.design_.exposures(torch.from_numpy(scene[None]), camera)
            rows.append(expose(budget, generator)[0].probabilities[0].numpy())
        return np.array(rows, np.float64)

    def _scenes(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
        """Reflectance (n, N) in [0, 1]."""
        return np.clip(x / self.white_, 0, 1).astype(np.float32)
