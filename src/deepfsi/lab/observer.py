"""Decisions of a live run, from counts alone: the class of each scene, and the next mask.

Each scene begins and ends with an all-ON and an all-OFF frame. A scene whose first all-ON frame is
no brighter than the all-OFF ones is dark, and gets no class. Scenes differ in brightness, so all-ON
frames of all lit scenes since the lamp changed give the budget; all-OFF frames that agree give the
dark counts. After the last look `LightMonitor` tests the light as in recorded scenes, and the
counts are compared with the training. A scene that fails has faults and no class.

Each mask is chosen by the posterior of the counts so far, and loaded before its look. A device
holds the masks of a dictionary from the start.

Counts are corrected for dead time frame by frame, up to a highest rate. An all-ON frame beyond it
ends the run; a short gate beyond it, by chance, is corrected as at that rate.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from deepfsi.adaptive.posterior import AdaptivePosterior, LookOptics, confidence_of
from deepfsi.base.arrays import LARGEST_TENSORS
from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.files import read_regular
from deepfsi.counting.acquisition import Acquisition
from deepfsi.counting.checks import SPOILING, Fault, LightMonitor, find_late
from deepfsi.counting.counts import Corrections
from deepfsi.counting.flux import Arrivals
from deepfsi.design.design import Design
from deepfsi.designfile.view_test import SceneReadouts, ViewResult
from deepfsi.lab.count_test import CountTest
from deepfsi.lab.results import MARGIN_NS, OFF, Decision, FrameList
from deepfsi.patterns.manifest import Brightness, LookPlan, Manifest
from deepfsi.patterns.rails import DesignRails
from deepfsi.physics.surroundings import library_defaults

SCENE_ENDS = -1
"""`look` of the lists of frames that begin and end each scene."""


class SceneObserver:
    """Decisions on scene after scene of a live run with a design of adaptive masks."""

    def __init__(self, design: Design, manifest: Manifest, acquisition: Acquisition) -> None:
        assert acquisition.live is not None
        self._exposure = design.prior_exposure
        self._manifest = manifest
        self._table_optics: LookOptics | None = None
        self._settings = acquisition.live
        self._exposure_ns = round(acquisition.exposure_s * 1e9)
        self._scenes = len(acquisition.scenes)
        self._light = LightMonitor(manifest, acquisition.inputs, self._scenes)
        self.test = CountTest(design)
        self._to_be_dark = self.test.to_be_dark(acquisition.scenes)
        self._ends = _scene_ends(manifest, acquisition.settle_s)

    def observe(self, scene: int, count: Callable[[FrameList], np.ndarray]) -> Iterator[Decision]:
        """Decisions after each look at the next scene, the last with its faults.

        `count` shows a list of frames and counts them. A run begins with scene 0.
        """
        begin = self._arrivals(count, self._ends)
        labelled = bool(self._to_be_dark[scene])
        lit, changes = self._light.begin(begin, dark=labelled)
        late = find_late(self._to_be_dark[: scene + 1], self._light.on)
        if not lit:
            seen = "no light: the all-ON frame is not brighter than the all-OFF ones"
            dark = Fault(kind="dark", scene=scene, detail="labelled so" if labelled else seen)
            yield Decision(scene, -1, np.zeros(0), None, 0.0, final=True, faults=(*late, dark))
            return
        photons = float(self._light.flux * self._exposure_ns * 1e-9)
        self._begin(scene, photons)
        arrivals: list[Arrivals] = []
        last = self._exposure.settings.looks - 1
        rule = self._settings.rule
        for look in range(last + 1):
            asked = self._next_frames(look)
            arrivals.append(self._arrivals(count, asked))
            probabilities = self._take(arrivals[-1])
            light_s = sum(self._gates_ns) * 1e-9
            decision = Decision(scene, look, probabilities, photons, light_s, final=False)
            confidence = float(confidence_of(torch.from_numpy(probabilities)))
            sure = rule is not None and confidence > rule.threshold
            if sure or look == last:
                break
            yield decision
        end = self._arrivals(count, self._ends)
        faults = self._light.end([begin, *arrivals, end])
        doubts = late + self.test.find_dim(np.array([photons]), first=scene)
        doubts += self._find_unlike(scene, [begin, end])
        view = None
        # With other faults the counts tell nothing of how the camera sees scenes
        kinds = {fault.kind for fault in (*faults, *doubts)} - {"unlike"}
        if not kinds & set(SPOILING):
            view = self._see(photons, arrivals)
        if view is not None and view.refused:
            faults += (Fault(kind="view", detail=view.refusal),)
        yield replace(decision, final=True, faults=(*changes, *faults, *doubts), view=view)

    def _begin(self, scene: int, photons: float) -> None:
        """Begin an exposure at a budget."""
        dark = torch.from_numpy(self._light.dark.clip(min=0) * self._exposure_ns * 1e-9)
        self._optics = replace(self._exposure.optics_at(photons), dark=dark.float())
        # Tables of a dictionary take a hundred times as long as all looks at a scene, and the light
        # that is measured changes a little with each scene: they stay while it is nearly alike
        last = self._table_optics
        if not (self._exposure.dictionary and scene and last and _alike(last, self._optics)):
            self._table_optics = last = self._optics
        self._posterior = self._exposure.posterior(1, last)
        self._generator = torch.Generator().manual_seed(scene)
        self._misfit = 0.0
        self._masks: list[torch.Tensor] = []  # of the looks so far
        self._gates_ns: list[int] = []
        self._counts: list[torch.Tensor] = []
        self._log_weights: list[torch.Tensor] = []  # of the scenes, before each look

    @library_defaults(grad=False)
    def _next_frames(self, look: int) -> FrameList:
        """Frame of the mask that tells most of the class, by the posterior so far."""
        share = self._exposure.settings.shares[look]
        mask = self._posterior.next_masks(share, self._generator)
        self._masks.append(mask)
        self._gates_ns.append(round(share * self._exposure_ns))
        gate = np.array(self._gates_ns[-1:])
        frames = self._manifest.mask_frames
        if self._exposure.dictionary is not None:
            return FrameList(look, frames[self._exposure.dictionary.indices(mask)], gate)
        return FrameList(look, frames, gate, mask.bool().numpy())

    @library_defaults(grad=False)
    def _take(self, arrivals: Arrivals) -> np.ndarray:
        """Probabilities (C,) of the classes, from the photons of this look and earlier ones."""
        counts = torch.from_numpy(arrivals.photons).float()
        mask = self._masks[-1]
        share = self._gates_ns[-1] / self._exposure_ns
        if self._exposure.dictionary is not None:
            self._log_weights.append(self._posterior.log_weights.clone())
        elif self._exposure.usual_misfit is not None:
            self._misfit += float(self._posterior.misfit(mask, counts, share))
        self._counts.append(counts)
        self._posterior.update(mask, counts, share)
        return self._posterior.probabilities[0].double().numpy()

    def _arrivals(self, count: Callable[[FrameList], np.ndarray], asked: FrameList) -> Arrivals:
        """Arrivals in the gates of a list, as corrected from its counts."""
        counts = count(asked)
        frames = tuple(self._manifest.frames[index] for index in asked.frames)
        gate_s = asked.gate_ns * 1e-9
        corrections = Corrections.of(self._settings.dead_time, self._manifest)
        rates = counts / gate_s[:, None]
        if asked.look == SCENE_ENDS:
            corrections.check(rates[None], frames, range(self._manifest.inputs), "a scene")
        factors = corrections.factors(rates)
        return Arrivals(frames, counts * factors.arrivals, counts * factors.variance, gate_s)

    def _see(self, photons: float, arrivals: list[Arrivals]) -> ViewResult | None:
        """View of the camera on all scenes so far, this one included."""
        arms = np.arange(self._manifest.arms)
        lit = torch.cat(self._masks).double().numpy()
        gates_ns = np.array(self._gates_ns)[:, None]
        counts = np.concatenate([arrived.photons for arrived in arrivals])
        variance = np.concatenate([arrived.variance for arrived in arrivals])
        dark = self._light.dark * (gates_ns * 1e-9)
        gain = photons * (gates_ns / self._exposure_ns) / self._exposure.summed_reflectance
        labels = self._exposure.detection.labels
        return self.test.see(
            SceneReadouts.of(
                gain[..., None] * np.stack([lit, 1 - lit][: len(arms)], axis=1),
                (counts - dark)[None],
                dark.clip(min=0) + (variance - counts).clip(min=0),
                None if labels is None else labels.numpy(),
                np.broadcast_to(arms, (len(lit), len(arms))),
            )
        )

    @library_defaults(grad=False)
    def _find_unlike(self, scene: int, ends: list[Arrivals]) -> list[Fault]:
        """Faults of counts that do not look like the training's, all-ON frames at both ends too."""
        usual = self.test.usual
        model = self.test.model
        if usual is None or model is None:
            return []
        looks = len(self._masks)
        misfit = self._misfit
        if self._log_weights:
            # The misfit takes longer than a decision by tables: once, after all looks
            # each look is an exposure of its own here, with the weights before it
            before = AdaptivePosterior(self._exposure.prior, looks, self._optics)
            before.log_weights = torch.cat(self._log_weights)
            share = self._exposure.settings.shares[0]
            counts = torch.cat(self._counts)
            misfit = float(before.misfit(torch.cat(self._masks), counts, share).sum())
        photons = self._optics.photons
        inputs = self._manifest.on_inputs
        shares = sum(end.seconds[0] for end in ends) * 1e9 / self._exposure_ns  # of all-ON frames
        dark = self._light.dark[inputs].sum() * shares * self._exposure_ns * 1e-9
        lit = sum(end.photons[0, inputs].sum() for end in ends) - dark
        gain = photons * shares / self._exposure.summed_reflectance
        frame = SceneReadouts.all_on(np.array([lit]), gain, max(dark, 0.0), model.means.shape[1])
        light = model.light(frame, usual.light[0])
        p_value = usual.p_values(np.array([misfit]), looks, photons, light)
        return self.test.find_unlike(scene, self._scenes, float(p_value[0]))[0]


def _scene_ends(manifest: Manifest, settle_s: float) -> FrameList:
    """All-ON and all-OFF frame that begin and end a scene, counted while they last."""
    rest_ns = round((settle_s + manifest.usual_tolerance_s) * 1e9) + MARGIN_NS
    ends = np.array([0, OFF])
    gates = np.array([manifest.frames[index].picture_us * 1000 - rest_ns for index in ends])
    if gates.min() < 1:
        raise InputError(
            f"all-ON and all-OFF frames of {manifest.frames[0].picture_us} µs are too short "
            "to be counted: export with a longer --exposure"
        )
    return FrameList(SCENE_ENDS, ends, gates)


def _alike(one: LookOptics, other: LookOptics) -> bool:
    """True if budgets, and dark counts, differ by less than their own errors."""
    # All-ON frames tell a budget no better than 2 %: they differ with the brightness of scenes
    most = 0.02 * one.photons
    close = abs(other.photons - one.photons) <= most
    return close and abs(other.dark_sum - one.dark_sum) <= 0.02 * (most + one.dark_sum)


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
