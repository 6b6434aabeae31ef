"""Looks of a live run with adaptive masks: each mask from the posterior of the counts so far."""

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from deepfsi.adaptive import candidate_masks, next_masks, squared_distance
from deepfsi.base import InputError, as_input_error, hash_file, read_regular
from deepfsi.base.numeric import LARGEST_TENSORS
from deepfsi.camera import StopRule
from deepfsi.design import Design
from deepfsi.designfile import UNSURE
from deepfsi.hardware.light import Arrivals
from deepfsi.hardware.live import (
    AllOnCounts,
    ExposureState,
    FrameList,
    SceneComparison,
)
from deepfsi.hardware.patterns import (
    Brightness,
    DesignRails,
    LookPlan,
    Manifest,
    Patterns,
)
from deepfsi.physics import library_defaults

ADAPTIVE_DECISION_S = 4e-3
"""Usual time of a decision, seconds, by `benchmarks/adaptive.py --latency` with 8192 scenes."""

DECISION_A_SCENE_S = 1.35e-7
"""Time that each scene of the prior adds to it, seconds, by the same with 60 000 scenes."""

MIRRORS_ROUNDED = 0.02
"""Share of a candidate's mirrors that may differ by rounding: those at its threshold.

Of 3200 looks at MNIST torch's kernels for AVX2 chose another candidate than those for AVX-512 in
464, since many tell as much, most of them when nothing was left to tell. The mask shown was always
one of the candidates, but for 4 of 784 mirrors of one mask. This leaves a factor of 4.
"""


class AdaptiveLooks:
    """Looks of a design of adaptive masks; attributes are those of `LookChooser`.

    Parameters
    ----------
    design : Design
        Of adaptive masks.
    manifest : Manifest
        Patterns of its first mask, whose frame is loaded anew for each look.
    """

    def __init__(self, design: Design, manifest: Manifest) -> None:
        exposure = design.prior_exposure
        until = exposure.settings.until
        self.exposure = exposure
        self.frames = manifest.shown
        self.shares = tuple(exposure.settings.shares)
        self.classes = design.classes
        self.photons: float | None = design.info["job"].get("photons")
        self.rule = None if until == 1 else StopRule(threshold=until)
        self.shortest = 0.0
        self.decision_s = ADAPTIVE_DECISION_S + DECISION_A_SCENE_S * len(exposure.prior)
        self.training_scenes = design.training_scenes
        self.scene_model = exposure.prior.model

    @classmethod
    def read(cls, folder: Path, manifest: Manifest) -> "AdaptiveLooks":
        """Looks of a folder of patterns of a first mask, which has the design's file.

        Parameters
        ----------
        folder : path
            Of the patterns.
        manifest : Manifest
            Of these.

        Raises
        ------
        InputError
            If files are damaged, or the design is not the one whose mask is beside it.
        """
        if hash_file(folder / Patterns.DESIGN) != manifest.design_sha256:
            raise InputError(
                f"{folder / Patterns.DESIGN} is not the design whose first mask is beside it: "
                "export the patterns again"
            )
        return cls(Design.load(folder / Patterns.DESIGN), manifest)

    def expose(self, scene: int, state: ExposureState) -> "_AdaptiveLiveExposure":
        """Begin an exposure of a scene."""
        return _AdaptiveLiveExposure(self, scene, state)

    def lit(self, asked: FrameList) -> np.ndarray:
        """Pixels of the mask of a look that are ON, (1, N)."""
        assert asked.masks is not None
        return asked.masks.astype(float)


class _AdaptiveLiveExposure:
    """One exposure of a scene with adaptive masks."""

    def __init__(self, looks: AdaptiveLooks, scene: int, state: ExposureState) -> None:
        exposure = looks.exposure
        dark = torch.from_numpy(state.dark.clip(min=0) * state.exposure_ns * 1e-9)
        optics = exposure.optics_at(state.photons)
        self._looks = looks
        self._state = state
        self._posterior = exposure.posterior(1, replace(optics, dark=dark.float()))
        self._generator = torch.Generator().manual_seed(scene)
        self._usual = exposure.usual_misfit
        self._misfit = 0.0
        self._look = 0

    @library_defaults(grad=False)
    def ask(self, look: int) -> FrameList:
        """Frame of the mask that tells most of the class, as far as it is known."""
        share = self._looks.shares[look]
        masks = next_masks(self._posterior, share, self._generator)
        gate = np.array([round(share * self._state.exposure_ns)])
        return FrameList(look, self._looks.frames, gate, masks.bool().numpy())

    @library_defaults(grad=False)
    def may_be(self, asked: FrameList, shown: FrameList) -> bool:
        """True if a processor that rounds differently may ask for what was shown.

        Of the candidates one is shown, and rounding decides between two that tell as much.
        """
        assert shown.masks is not None
        gates = np.array_equal(shown.gate_ns, asked.gate_ns)
        if shown.look != asked.look or not gates or len(shown.masks) != 1:
            return False
        masks = candidate_masks(self._posterior)[0].bool().numpy()  # (P, N)
        mirrors = (masks != shown.masks).sum(axis=1).min()
        return bool(mirrors <= math.ceil(MIRRORS_ROUNDED * masks.shape[1]))

    @library_defaults(grad=False)
    def take(self, asked: FrameList, arrivals: Arrivals) -> np.ndarray:
        """Probabilities (C,) of the classes, from the photons of a look and those before."""
        assert asked.masks is not None
        counts = torch.from_numpy(arrivals.photons.sum(axis=1)).float()
        share = float(asked.gate_ns[0]) / self._state.exposure_ns
        masks = torch.from_numpy(asked.masks).float()
        self._look = asked.look
        if self._usual is not None:
            self._misfit += float(squared_distance(self._posterior, masks, counts, share))
        self._posterior.update(masks, counts, share)
        return self._posterior.chances[0].double().numpy()

    def compare(self, on: AllOnCounts) -> SceneComparison | None:
        """Misfit of all looks against that of training scenes; none where that is not known."""
        if self._usual is None:
            return None
        chance = self._usual.chance(self._misfit, self._look, self._state.photons)
        detail = f"a misfit of {self._misfit:.3g} in {self._look + 1} looks"
        return SceneComparison(chance, chance < UNSURE, detail)


@library_defaults(grad=False)
def adaptive_rails(path: str | os.PathLike[str]) -> DesignRails:
    """Mask of the first look of a design file, at the budget of its training, as rails."""
    design = Design.load(path)
    exposure = design.prior_exposure
    camera = exposure.camera
    share = exposure.settings.shares[0]
    optics = exposure.optics_at(float(design.info["job"]["photons"]))
    state = exposure.posterior(1, optics)
    mask = next_masks(state, share, torch.Generator().manual_seed(0))
    rails = torch.stack([mask, 1 - mask]) if optics.arms == 2 else mask[None]
    detectors = camera.detector_map(design.image_shape)
    with as_input_error(str(path)):
        brightness = Brightness.of(design.info)
    return DesignRails(
        rails=(rails * share).numpy(),
        light=camera.light,
        image_shape=design.image_shape,
        summed_reflectance=design.summed_reflectance,
        file=read_regular(Path(path), LARGEST_TENSORS, "give a design"),
        brightness=brightness,
        detectors=detectors if detectors.count > 1 else None,
        looks=LookPlan(
            count=design.masks, each_rail=False, first=(share,), shortest=0, loop_sha256=None
        ),
    )
