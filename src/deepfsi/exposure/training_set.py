"""A data set on a device, with what the trainings on it share."""

from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from deepfsi.camera import LIGHT_LAWS, ONE_DETECTOR, DetectorMap, LightLawName, summed_reflectance
from deepfsi.datasets import Dataset
from deepfsi.designfile import TrainingScenes
from deepfsi.jobs import (
    DESIGNS,
    Exposure,
    check_count,
    count_allowed,
    sensing_matrix,
)
from deepfsi.networks.values import Values
from deepfsi.physics import Detection, torch_device

Matrices = dict[tuple[str, int, int, tuple[int, ...] | None], np.ndarray]
"""Sensing matrices (m, N) by design, number of masks, seed and detectors."""


class TrainingSet:
    """A data set on a device, with what several trainings on it share."""

    def __init__(
        self, data: Dataset, device: str | torch.device = "auto", matrices: Matrices | None = None
    ) -> None:
        self.data = data
        self.device = torch_device(device)
        self.summed_reflectance = summed_reflectance(data.x_train)
        self.values = Values.of(data)
        # (n,) classes, or (n, q) standardised values
        truth = torch.from_numpy(np.require(data.y_train, requirements="W"))
        self.labels = (self.values.standardised(truth) if self.values else truth).to(self.device)
        x = np.require(data.x_train, requirements="W")  # a cluster shares arrays read-only
        self.full = torch.from_numpy(x).to(self.device)
        self.matrices = {} if matrices is None else matrices
        self._centred: dict[tuple[torch.dtype, bool, bytes], Tensor] = {}
        self._seen: dict[Exposure, TrainingSet] = {}

    def of(self, data: Dataset) -> "TrainingSet":
        """Other scenes on the same device."""
        return TrainingSet(data, self.device)

    def seen(self, exposure: Exposure) -> "TrainingSet":
        """The scenes as the masks of an exposure see them."""
        if exposure not in self._seen:
            scenes = exposure.view(self.data)
            self._seen[exposure] = self if scenes is self.data else self.of(scenes)
        return self._seen[exposure]

    @cached_property
    def scenes(self) -> TrainingScenes:
        """Hashes of its scenes, which designs keep."""
        return TrainingScenes.of(self.data)

    @cached_property
    def varying(self) -> Tensor:
        """Which pixels (N,) differ anywhere in the training set; the first if none does."""
        varying = (self.full != self.full[0]).any(dim=0)
        varying[0] |= not varying.any()
        return varying

    def pixels(self, light: LightLawName) -> Tensor:
        """Which pixels (N,) learned masks may light."""
        # The light of one that never varies is noise and no information, so it stays dark, except
        # on two arms, where what one does not get the other does
        return torch.ones_like(self.varying) if LIGHT_LAWS[light].arms == 2 else self.varying

    def centred(self, pixels: Tensor, kind: torch.dtype, detection: Detection) -> Tensor:
        """Pixels (N,) of the training scenes, less their mean, and the mean as the last row."""
        # The products of the last row with the masks, added to those of a scene, give the scene's
        # own; centred, little is lost in bfloat16. Exactly 0 where a pixel never varies, so that it
        # moves no mask through rounding. Arranged by the detectors that see them
        key = (kind, bool(pixels.all()), detection.key)
        if key not in self._centred:
            mean = torch.where(self.varying, self.full.mean(dim=0), self.full[0])
            centred = torch.cat([self.full - mean, mean.unsqueeze(0)])
            arranged = detection.of_pixels(pixels).arrange(centred[:, pixels])
            self._centred[key] = arranged.to(kind)
        return self._centred[key]

    @cached_property
    def class_weights(self) -> Tensor:
        """Weight (C,) of each class's scenes with which all classes count alike; 1 in the mean."""
        sizes = torch.bincount(self.labels, minlength=len(self.data.classes)).float()
        present = (sizes > 0).sum()
        return len(self.labels) / (present * sizes.clamp(min=1))

    def prepare(self, name: str) -> None:
        """Compute what the trainings of a design share, so that processes need not each do it."""
        if DESIGNS[name].is_made_whole(self.data.pixels):
            self.matrix(name, 1, 0)

    def matrix(
        self, name: str, masks: int, seed: int, detectors: DetectorMap = ONE_DETECTOR
    ) -> np.ndarray:
        """Sensing matrix of a fixed design; principal components are computed once for all m."""
        # Parameters as for `sensing_matrix`
        check_count(name, masks, self.data, detectors)
        _, most = count_allowed(name, self.data, detectors)
        code = DESIGNS[name]
        whole = most if code.is_made_whole(most) else masks
        key = (name, whole, seed if code.seeded else 0, detectors.cells)
        if key not in self.matrices:
            self.matrices[key] = sensing_matrix(name, whole, self.data, seed, detectors)
        return self.matrices[key][:masks]
