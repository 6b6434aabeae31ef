"""Looks of a live run with adaptive masks: each mask from the posterior of the counts so far.

A mask that is made is loaded before its look. Masks of a dictionary are frames of the folder, which
the device holds from the start: a look names one, and nothing is loaded.
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
from deepfsi.base.files import hash_file, read_regular
from deepfsi.counting.acquisition import StopRule
from deepfsi.counting.flux import Arrivals
from deepfsi.design.design import Design
from deepfsi.lab.results import FrameList
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.manifest import Brightness, LookPlan, Manifest
from deepfsi.patterns.rails import DesignRails
from deepfsi.physics.surroundings import library_defaults

ADAPTIVE_DECISION_S = 4e-3
"""Usual time of a decision, seconds, by `benchmarks/adaptive.py --latency` with 8192 scenes."""

DECISION_A_SCENE_S = 1.35e-7
"""Time that each scene of the prior adds to it, seconds, by the same with 60 000 scenes."""

DICTIONARY_DECISION_S = 0.5e-3
"""Usual time from the counts to a mask of a dictionary, seconds: most of it counts and light.

The choice takes 0.06 to 0.2 ms of it, by `benchmarks/adaptive.py --latency --dictionary 2000`, and
counts 0.3 ms (`benchmarks/live.py decision` of commit 5d24e83b).
"""

DICTIONARY_DECISION_A_SCENE_S = 5e-9
"""Time that each scene of the prior adds to it, seconds; a run asks for chances at each look."""

SAME_LIGHT = 0.02
"""Relative difference of budgets within which the tables of a dictionary serve for both.

All-ON frames tell a budget no better: they differ with the brightness of scenes.
"""


class AdaptiveLooks:
    """Looks of a design of adaptive masks, as a live run needs them.

    Attributes are shares of the exposure, one for each look, and seconds that a decision takes.
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
        scenes = len(exposure.prior)
        self.decision_s = ADAPTIVE_DECISION_S + DECISION_A_SCENE_S * scenes
        self.stored = exposure.dictionary if manifest.looks and manifest.looks.dictionary else None
        if self.stored is not None:
            self.decision_s = DICTIONARY_DECISION_S + DICTIONARY_DECISION_A_SCENE_S * scenes
        self._tabled: LookOptics | None = None
        self.training_scenes = design.training_scenes
        self.scene_model = exposure.prior.model

    @classmethod
    def read(cls, patterns: Patterns) -> "AdaptiveLooks":
        """Looks of the patterns of a first mask, or of a dictionary, and their design."""
        folder = patterns.folder
        assert folder is not None
        if patterns.manifest.looks is None:
            raise InputError(
                f"{folder} has the patterns of a design whose masks are known before: learn one of "
                '`design="adaptive"` masks, or record it with `deepfsi camera simulate` or '
                "`import`"
            )
        if hash_file(folder / Patterns.DESIGN) != patterns.manifest.design_sha256:
            raise InputError(
                f"{folder / Patterns.DESIGN} is not the design whose masks are beside it: "
                "export the patterns again"
            )
        return cls(Design.load(folder / Patterns.DESIGN), patterns.manifest)

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
        """Optics of the tables of a dictionary: those of an earlier scene of the run, if alike.

        To compute tables takes a hundred times as long as all looks at a scene, and the light that
        is measured changes a little with each scene.
        """
        last = self._tabled
        if scene == 0 or last is None or not _nearly_alike(last, optics):
            self._tabled = last = optics
        return last


def _nearly_alike(one: LookOptics, other: LookOptics) -> bool:
    """True if budgets, and the dark counts beside them, differ by less than is known of them."""
    most = SAME_LIGHT * one.photons
    close = abs(other.photons - one.photons) <= most
    return close and abs(other.dark_sum - one.dark_sum) <= SAME_LIGHT * (most + one.dark_sum)


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
        counts = torch.from_numpy(arrivals.photons.sum(axis=1)).float()
        share = float(asked.gate_ns[0]) / self._exposure_ns
        masks = torch.from_numpy(asked.masks).float()
        self._look = asked.look
        if self._usual is not None:
            self._misfit += float(self._posterior.misfit(masks, counts, share))
        self._posterior.update(masks, counts, share)
        return self._posterior.chances[0].double().numpy()

    def compare(self) -> tuple[float, str] | None:
        """Chance of a misfit as that of all looks, by training scenes, and the misfit in words.

        None where that of training scenes is not known.
        """
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
        """Misfit of all looks, found after the last one: that takes longer than a decision."""
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
    """Masks of a design file that its patterns begin with, as rails.

    That of the first look at the budget of the training, or all of a dictionary. The time of an
    exposure is then divided among them in equal parts.
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
