"""Looks of a live run with adaptive masks: each mask from the posterior of the counts so far.

A new mask is loaded before its look. The device holds masks of a dictionary from the start.
"""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepfsi.adaptive.dictionary import DictionaryPosterior
from deepfsi.adaptive.posterior import AdaptivePosterior, LookOptics
from deepfsi.base.arrays import LARGEST_TENSORS
from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.files import read_regular
from deepfsi.counting.acquisition import StopRule
from deepfsi.counting.flux import Arrivals
from deepfsi.design.design import Design
from deepfsi.lab.results import FrameList
from deepfsi.patterns.manifest import Brightness, LookPlan, Manifest
from deepfsi.patterns.rails import DesignRails
from deepfsi.physics.surroundings import library_defaults


class AdaptiveLooks:
    """Looks of a live run with a design of adaptive masks."""

    def __init__(self, design: Design, manifest: Manifest) -> None:
        exposure = design.prior_exposure
        until = exposure.settings.until
        self.exposure = exposure
        self.frames = manifest.shown
        self.shares = tuple(exposure.settings.shares)  # of the exposure, for each look
        self.classes = design.classes
        self.photons: float | None = design.info["job"].get("photons")
        self.rule = None if until == 1 else StopRule(threshold=until)
        scenes = len(exposure.prior)
        self.stored = exposure.dictionary if manifest.looks and manifest.looks.dictionary else None
        if self.stored is None:
            # By `benchmarks/adaptive.py --latency` with 8192 and 60 000 scenes
            self.decision_s = 4e-3 + 1.35e-7 * scenes
        else:
            # By the same with `--dictionary 2000`: counts and light take most of it
            self.decision_s = 0.5e-3 + 5e-9 * scenes
        self._tabled: LookOptics | None = None
        self.training_scenes = design.training_scenes
        self.scene_model = exposure.prior.model

    def expose(
        self, scene: int, photons: float, exposure_ns: int, dark: np.ndarray
    ) -> "_AdaptiveLiveExposure":
        """Begin an exposure at a budget and dark counts/s (inputs,); a run begins with scene 0."""
        kind = _AdaptiveLiveExposure if self.stored is None else _StoredMaskExposure
        return kind(self, scene, photons, exposure_ns, dark)

    def lit(self, asked: FrameList) -> np.ndarray:
        """Pixels of the mask of a look that are ON, (1, N)."""
        if self.stored is not None:
            return self.stored.masks[self.row_of(asked)][None].double().numpy()
        assert asked.masks is not None
        return asked.masks.astype(float)

    def row_of(self, asked: FrameList) -> int:
        """Index in the dictionary of the mask of a look."""
        return int(np.searchsorted(self.frames, asked.frames[0]))

    def tabled(self, scene: int, optics: LookOptics) -> LookOptics:
        """Optics of a dictionary's tables, an earlier scene's if nearly alike."""
        # Tables take a hundred times as long as all looks at a scene, and the light that is
        # measured changes a little with each scene
        last = self._tabled
        if scene == 0 or last is None or not _nearly_alike(last, optics):
            self._tabled = last = optics
        return last


def _nearly_alike(one: LookOptics, other: LookOptics) -> bool:
    """True if budgets, and the dark counts beside them, differ by less than is known of them."""
    # All-ON frames tell a budget no better than 2 %: they differ with the brightness of scenes
    most = 0.02 * one.photons
    close = abs(other.photons - one.photons) <= most
    return close and abs(other.dark_sum - one.dark_sum) <= 0.02 * (most + one.dark_sum)


class _AdaptiveLiveExposure:
    """One exposure of a scene with masks that are made."""

    def __init__(
        self,
        looks: AdaptiveLooks,
        scene: int,
        photons: float,
        exposure_ns: int,
        dark_s: np.ndarray,
    ) -> None:
        exposure = looks.exposure
        dark = torch.from_numpy(dark_s.clip(min=0) * exposure_ns * 1e-9)
        self._optics = replace(exposure.optics_at(photons), dark=dark.float())
        self._looks = looks
        self._photons = photons
        self._exposure_ns = exposure_ns
        tabled = self._optics if looks.stored is None else looks.tabled(scene, self._optics)
        self._posterior = exposure.posterior(1, tabled)
        self._generator = torch.Generator().manual_seed(scene)
        self._usual = exposure.usual_misfit
        self._misfit = 0.0
        self._look = 0

    @library_defaults(grad=False)
    def ask(self, look: int) -> FrameList:
        """Frame of the mask that tells most of the class, as far as it is known."""
        share = self._looks.shares[look]
        masks = self._posterior.next_masks(share, self._generator)
        gate = np.array([round(share * self._exposure_ns)])
        return FrameList(look, self._looks.frames, gate, masks.bool().numpy())

    @library_defaults(grad=False)
    def take(self, asked: FrameList, arrivals: Arrivals) -> np.ndarray:
        """Probabilities (C,) of the classes, from the photons of a look and those before."""
        assert asked.masks is not None
        counts = torch.from_numpy(arrivals.photons).float()
        share = float(asked.gate_ns[0]) / self._exposure_ns
        masks = torch.from_numpy(asked.masks).float()
        self._look = asked.look
        if self._usual is not None:
            self._misfit += float(self._posterior.misfit(masks, counts, share))
        self._posterior.update(masks, counts, share)
        return self._posterior.chances[0].double().numpy()

    def compare(self) -> tuple[float, str] | None:
        """Chance that a training scene's misfit is as large, and a text; None if it is unknown."""
        if self._usual is None:
            return None
        chance = self._usual.chance(self._misfit, self._look, self._photons)
        return chance, f"a misfit of {self._misfit:.3g} in {self._look + 1} looks"


class _StoredMaskExposure(_AdaptiveLiveExposure):
    """One exposure of a scene with masks of a dictionary, which stay on the device."""

    _posterior: DictionaryPosterior

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._rows: list[int] = []
        self._counts: list[float] = []
        self._logs: list[torch.Tensor] = []  # of the scenes, before each look

    def ask(self, look: int) -> FrameList:
        """Frame of the mask of the dictionary that tells most of the class."""
        gate = np.array([round(self._looks.shares[look] * self._exposure_ns)])
        return FrameList(look, self._looks.frames[self._posterior.choose()], gate)

    @library_defaults(grad=False)
    def take(self, asked: FrameList, arrivals: Arrivals) -> np.ndarray:
        """Probabilities (C,) of the classes, from the photons of a look and those before."""
        self._rows.append(self._looks.row_of(asked))
        self._counts.append(float(arrivals.photons.sum()))
        self._logs.append(self._posterior.logs.clone())
        self._look = asked.look
        self._posterior.take(self._rows[-1:], self._counts[-1:])
        return self._posterior.chances[0].double().numpy()

    @library_defaults(grad=False)
    def compare(self) -> tuple[float, str] | None:
        """Add up the misfits after the last look: that takes longer than a decision."""
        stored = self._looks.stored
        if self._usual is not None and stored is not None:
            before = AdaptivePosterior(self._looks.exposure.prior, len(self._rows), self._optics)
            before.logs = torch.cat(self._logs)
            masks = stored.masks[self._rows]
            counts = torch.tensor(self._counts)[:, None]
            share = self._looks.shares[0]
            self._misfit = float(before.misfit(masks, counts, share).sum())
        return super().compare()


@library_defaults(grad=False)
def adaptive_rails(path: str | os.PathLike[str]) -> DesignRails:
    """Rails of the first look's mask at the training's budget, or of a whole dictionary.

    Masks of a dictionary divide the time of an exposure into equal parts.
    """
    design = Design.load(path)
    exposure = design.prior_exposure
    camera = exposure.camera
    share = exposure.settings.shares[0]
    optics = exposure.optics_at(float(design.info["job"]["photons"]))
    stored = exposure.dictionary
    if stored is not None:
        if not bool(stored.masks.any(dim=1).all()):
            raise InputError(f"{path} has a mask without light in its dictionary: make it again")
        rails = stored.masks.double()[None] / len(stored)
    else:
        state = exposure.posterior(1, optics)
        mask = state.next_masks(share, torch.Generator().manual_seed(0))
        rails = (torch.stack([mask, 1 - mask]) if optics.arms == 2 else mask[None]) * share
    detectors = camera.detector_map(design.image_shape)
    with as_input_error(str(path)):
        brightness = Brightness.of(design.info)
    return DesignRails(
        rails=rails.numpy(),
        light=camera.light,
        image_shape=design.image_shape,
        summed_reflectance=design.summed_reflectance,
        file=read_regular(Path(path), LARGEST_TENSORS, "give a design"),
        brightness=brightness,
        detectors=detectors if detectors.count > 1 else None,
        looks=LookPlan(
            count=design.masks,
            first=(share,) * rails.shape[1],
            dictionary=stored is not None,
        ),
    )
