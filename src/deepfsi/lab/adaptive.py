"""Looks of a live run with adaptive masks: each mask from the posterior of the counts so far."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from deepfsi.base import as_input_error, read_regular
from deepfsi.base.numeric import LARGEST_TENSORS
from deepfsi.camera import StopRule
from deepfsi.design.adaptive.choice import next_masks
from deepfsi.design.adaptive.design import AdaptiveDesign
from deepfsi.design.adaptive.misfit import squared_distance
from deepfsi.design.adaptive.posterior import AdaptivePosterior, LookOptics
from deepfsi.designfile import UNSURE
from deepfsi.hardware.light import Arrivals
from deepfsi.hardware.live.looks import AllOn, Conditions, FrameList, Likeness
from deepfsi.hardware.patterns.folder import DesignRails
from deepfsi.hardware.patterns.looks import Looks
from deepfsi.hardware.patterns.sequence import Brightness, Manifest
from deepfsi.optics.surroundings import library_defaults

DECISION_S, DECISION_A_SCENE_S = 4e-3, 1.35e-7
"""Usual time of a decision, seconds, and what each scene of the prior adds.

Measured by `benchmarks/adaptive.py --latency` with 8192 and with 60 000 scenes.
"""


class AdaptiveLooks:
    """Looks of a design of adaptive masks; attributes are those of `LiveLooks`."""

    def __init__(self, design: AdaptiveDesign, manifest: Manifest) -> None:
        self.design, self.frames = design, manifest.shown
        self.training_scenes = design.training_scenes
        self.classes, self.shortest = design.classes, 0.0
        self.shares = tuple(design.settings.shares)
        self.photons: float | None = design.info["job"].get("photons")
        self.decision_s = DECISION_S + DECISION_A_SCENE_S * len(design.prior)
        self.scene_model = design.scene_model
        until = design.settings.until
        self.rule = None if until == 1 else StopRule(threshold=until)

    @classmethod
    def of_file(cls, path: Path, manifest: Manifest) -> "AdaptiveLooks":
        """Looks of a design file, of which the manifest's frames are the first mask."""
        return cls(AdaptiveDesign.load(path), manifest)

    def expose(self, scene: int, conditions: Conditions) -> "AdaptiveExposure":
        """Begin an exposure of a scene."""
        return AdaptiveExposure(self, scene, conditions)

    def lit(self, asked: FrameList) -> np.ndarray:
        """Pixels of the mask of a look that are ON, (1, N)."""
        assert asked.masks is not None
        return asked.masks.astype(float)


class AdaptiveExposure:
    """One exposure of a scene with adaptive masks."""

    def __init__(self, looks: AdaptiveLooks, scene: int, conditions: Conditions) -> None:
        design, self._looks, self._conditions = looks.design, looks, conditions
        dark = torch.from_numpy(conditions.dark.clip(min=0) * conditions.exposure_ns * 1e-9)
        optics = LookOptics.of(design.camera, design.image_shape, conditions.photons)
        self._state = AdaptivePosterior(design.prior, 1, replace(optics, dark=dark.float()))
        self._generator = torch.Generator().manual_seed(scene)
        self._usual, self._misfit, self._look = design.usual_misfit, 0.0, 0

    @torch.no_grad()
    @library_defaults()
    def ask(self, look: int) -> FrameList:
        """Frame of the mask that tells most of the class, as far as it is known."""
        share = self._looks.shares[look]
        masks = next_masks(self._state, share, self._generator)
        gate = np.array([round(share * self._conditions.exposure_ns)])
        return FrameList(look, self._looks.frames, gate, masks.bool().numpy())

    @torch.no_grad()
    @library_defaults()
    def take(self, asked: FrameList, found: Arrivals) -> np.ndarray:
        """Probabilities (C,) of the classes, from the photons of a look and those before."""
        assert asked.masks is not None
        counts = torch.from_numpy(found.photons.sum(axis=1)).float()
        share = float(asked.gate_ns[0]) / self._conditions.exposure_ns
        masks = torch.from_numpy(asked.masks).float()
        self._look = asked.look
        if self._usual is not None:
            self._misfit += float(squared_distance(self._state, masks, counts, share))
        self._state.update(masks, counts, share)
        return self._state.chances[0].double().numpy()

    def compare(self, on: AllOn) -> Likeness | None:
        """Misfit of all looks against that of training scenes; none where that is not known."""
        if self._usual is None:
            return None
        chance = self._usual.chance(self._misfit, self._look, self._conditions.photons)
        detail = f"a misfit of {self._misfit:.3g} in {self._look + 1} looks"
        return Likeness(chance, chance < UNSURE, detail)


@torch.no_grad()
@library_defaults()
def adaptive_rails(path: str | os.PathLike[str]) -> DesignRails:
    """Mask of the first look of a design file, at the budget of its training, as rails."""
    design = AdaptiveDesign.load(path)
    file = read_regular(Path(path), LARGEST_TENSORS, "give a design")
    camera, share = design.camera, design.settings.shares[0]
    optics = LookOptics.of(camera, design.image_shape, float(design.info["job"]["photons"]))
    state = AdaptivePosterior(design.prior, 1, optics)
    mask = next_masks(state, share, torch.Generator().manual_seed(0))
    rails = torch.stack([mask, 1 - mask]) if optics.arms == 2 else mask[None]
    detectors = camera.detector_map(design.image_shape)
    with as_input_error(str(path)):
        brightness = Brightness.of(design.info)
    return DesignRails(
        (rails * share).numpy(),
        camera.light,
        design.image_shape,
        design.prior.summed_reflectance,
        file,
        brightness,
        detectors if detectors.count > 1 else None,
        looks=Looks(
            count=design.masks, each_rail=False, first=(share,), shortest=0, loop_sha256=None
        ),
    )
