"""Looks at known masks, whose dwells networks choose; and the looks of a folder of patterns."""

from pathlib import Path

import numpy as np

from deepfsi.base import InputError, hash_file, require_torch
from deepfsi.designfile import DesignFile, read_loop
from deepfsi.hardware.light import Arrivals
from deepfsi.hardware.live.looks import AllOn, Conditions, FrameList, Likeness, LiveLooks
from deepfsi.hardware.patterns.folder import DESIGN, LOOP, read_patterns
from deepfsi.hardware.patterns.sequence import Manifest, Patterns


def read_looks(folder: Path, manifest: Manifest) -> LiveLooks:
    """Looks of a folder of patterns, or `InputError` if its files are damaged."""
    assert manifest.looks is not None
    if not manifest.looks.adaptive:
        patterns = read_patterns(folder)
        if manifest.design_sha256 is not None:
            return KnownMasks(DesignFile.read(folder / DESIGN), patterns)
        rails, image_shape, _ = patterns.realised
        detectors = manifest.detectors and manifest.detectors.cells
        design = read_loop(
            folder / LOOP,
            rails,
            image_shape=image_shape,
            light=manifest.light,
            summed_reflectance=manifest.summed_reflectance,
            detectors=None if detectors is None else np.array(detectors),
        )
        return KnownMasks(design, patterns)
    with require_torch():
        from deepfsi.lab.adaptive import AdaptiveLooks
    if hash_file(folder / DESIGN) != manifest.design_sha256:
        raise InputError(
            f"{folder / DESIGN} is not the design whose first mask is beside it: export the "
            "patterns again"
        )
    return AdaptiveLooks.of_file(folder / DESIGN, manifest)


DECISION_S = 0.4e-3
"""Usual time from the counts to the class and the next dwells, seconds (`benchmarks/live.py`)."""


class KnownMasks:
    """Looks at known masks.

    Its attributes are those of `LiveLooks`.
    """

    def __init__(self, design: DesignFile, patterns: Patterns) -> None:
        manifest = patterns.manifest
        self.design, self.manifest, self._fractions = design, manifest, patterns.fractions
        self.training_scenes, self.scene_model = design.training_scenes, design.scene_model
        self.classes = design.header.classes
        looks = design.looks.looks
        self.shares, self.shortest = (1 / looks,) * looks, design.looks.shortest
        self.photons, self.rule = design.photons, design.stop_rule
        self.decision_s = DECISION_S
        masks = np.array([manifest.frames[at].mask for at in manifest.shown])
        rails = np.array([manifest.frames[at].rail for at in manifest.shown])
        assert manifest.looks is not None
        self.places = manifest.looks.places(masks, rails == "minus")

    def expose(self, scene: int, conditions: Conditions) -> "KnownExposure":
        """Begin an exposure of a scene."""
        return KnownExposure(self, conditions)

    def lit(self, asked: FrameList) -> np.ndarray:
        """Share of each pixel's mirrors that are ON in frames of a look, (F, N)."""
        return self._fractions[np.searchsorted(self.manifest.shown, asked.frames)]


class KnownExposure:
    """One exposure of a scene with known masks."""

    def __init__(self, masks: KnownMasks, conditions: Conditions) -> None:
        self._masks, self._design, self._conditions = masks, masks.design, conditions
        design = masks.design
        self._features, self._dwell = np.zeros(design.feature_count), np.zeros(design.frames)
        self._gates = np.zeros(design.frames, np.int64)  # of the present look
        self._shape = design.rail_count, design.masks, design.detector_count
        self._read, self._noise = np.zeros((2, *self._shape))
        self._look = 0

    def ask(self, look: int) -> FrameList:
        """Frames of the next look, for the dwells that the networks choose."""
        masks, inputs = self._masks, self._design.inputs(self._features, self._dwell)
        exposure_ns = self._conditions.exposure_ns
        asked = self._design.next_dwell(inputs, look, self._conditions.shortest_ns / exposure_ns)
        self._gates, self._look = np.rint(asked * exposure_ns).astype(np.int64), look
        own = self._gates[masks.places]
        kept = own > 0
        return FrameList(look, masks.manifest.shown[kept], own[kept])

    def take(self, asked: FrameList, found: Arrivals) -> np.ndarray:
        """Probabilities (C,) of the classes, from the photons of a look and those before."""
        counts, noise = self._by_rail(found, asked)
        self._read, self._noise = self._read + counts, self._noise + noise
        photons = self._conditions.photons
        self._features += self._design.features(counts) / photons
        self._dwell += self._gates / self._conditions.exposure_ns
        return self._design.chances(self._design.inputs(self._features, self._dwell), photons)

    def compare(self, on: AllOn) -> Likeness | None:
        """Comparison of all counts with the training; none where nothing of it is known."""
        known, design = self._design.distribution, self._design
        if known is None:
            return None
        each = (self._dwell * design.frames).reshape(design.masks, -1).T[:, :, None]
        weights = np.broadcast_to(each, self._read.shape).ravel()
        read, noise, often = (
            np.append(one, last)[None, None]
            for one, last in (
                (self._read, on.counts),
                (self._noise, on.noise),
                (weights, on.seconds / (self._conditions.exposure_ns * 1e-9)),
            )
        )
        budget = np.array([self._conditions.photons])
        found = known.after(self._look).test(read, budget, noise, often)
        detail = f"{found.brightness:.2f} times the counts of its mean scene at this budget"
        return Likeness(float(found.exposures[0]), bool(found.unsure[0]), detail)

    def _by_rail(self, found: Arrivals, shown: FrameList) -> tuple[np.ndarray, np.ndarray]:
        """Counts (rails, m, D) of a look that are a scene's, and noise beyond their own."""
        manifest = self._masks.manifest
        every = np.zeros((2, len(manifest.shown), manifest.inputs))
        rows = np.searchsorted(manifest.shown, shown.frames)
        counts, variance = found.photons.sum(axis=1), found.variance.sum(axis=1)
        seconds = (shown.gate_ns * 1e-9)[:, None]
        ambient, its_noise = self._conditions.ambient[:, rows]
        dark = (self._conditions.dark + ambient) * seconds
        noise = dark.clip(min=0) + its_noise * seconds**2 + (variance - counts).clip(min=0)
        every[:, rows] = counts - dark, noise
        read, noise = manifest.by_readout(every).reshape(2, *self._shape)
        return read, noise
