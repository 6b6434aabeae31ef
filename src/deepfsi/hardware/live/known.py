"""Looks at known masks, whose dwells networks choose; and the looks of a folder of patterns."""

from pathlib import Path

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import hash_file
from deepfsi.base.plugins import torch_needed
from deepfsi.design.file_content import damaged, read_content
from deepfsi.design.training_data import HASHES, TrainingScenes
from deepfsi.hardware.counting.readouts import by_readout
from deepfsi.hardware.light import Arrivals
from deepfsi.hardware.live.looks import AllOn, Conditions, FrameList, Likeness, LiveLooks
from deepfsi.hardware.live.loop import Loop, read_loop
from deepfsi.hardware.patterns.folder import DESIGN, LOOP, read_patterns
from deepfsi.hardware.patterns.sequence import Manifest, Patterns


def read_looks(folder: Path, manifest: Manifest) -> LiveLooks:
    """Looks of a folder of patterns, or `InputError` if its files are damaged."""
    assert manifest.looks is not None
    if not manifest.looks.adaptive:
        known = manifest.design_sha256 is not None
        held = read_content(folder / DESIGN, (HASHES,))[1] if known else {}
        try:
            trained = TrainingScenes.restored(held)
        except ValueError as error:
            raise damaged(folder / DESIGN) from error
        return KnownMasks(read_loop(folder / LOOP), read_patterns(folder), trained)
    with torch_needed():
        from deepfsi.design.adaptive.design import AdaptiveDesign
        from deepfsi.lab.adaptive import AdaptiveLooks
    if hash_file(folder / DESIGN) != manifest.design_sha256:
        raise InputError(
            f"{folder / DESIGN} is not the design whose first mask is beside it: export the "
            "patterns again"
        )
    return AdaptiveLooks(AdaptiveDesign.load(folder / DESIGN), manifest)


DECISION_S = 0.4e-3
"""Usual time from the counts to the class and the next dwells, seconds (`benchmarks/live.py`)."""


class KnownMasks:
    """Looks at known masks.

    Its attributes are those of `LiveLooks`.
    """

    def __init__(
        self, loop: Loop, patterns: Patterns, training_scenes: TrainingScenes | None = None
    ) -> None:
        header, manifest = loop.header, patterns.manifest
        self.training_scenes, self.scene_model = training_scenes, loop.scene_model
        self._fractions = patterns.fractions
        self.loop, self.classes = loop, header.classes
        self.shares = (1 / header.looks,) * header.looks
        self.photons, self.rule, self.shortest = header.photons, header.rule, header.shortest
        self.manifest, self.decision_s = manifest, DECISION_S
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
        header = masks.loop.header
        self._masks, self._loop, self._conditions = masks, masks.loop, conditions
        self._features, self._dwell = np.zeros(header.features), np.zeros(header.frames)
        self._gates = np.zeros(header.frames, np.int64)  # of the present look
        self._read, self._noise = np.zeros((2, header.rails, header.masks, header.detectors))
        self._look = 0

    def ask(self, look: int) -> FrameList:
        """Frames of the next look, for the dwells that the networks choose."""
        masks, inputs = self._masks, self._loop.inputs(self._features, self._dwell)
        exposure_ns = self._conditions.exposure_ns
        asked = self._loop.choose(inputs, look, self._conditions.shortest_ns / exposure_ns)
        self._gates, self._look = np.rint(asked * exposure_ns).astype(np.int64), look
        own = self._gates[masks.places]
        kept = own > 0
        return FrameList(look, masks.manifest.shown[kept], own[kept])

    def take(self, asked: FrameList, found: Arrivals) -> np.ndarray:
        """Probabilities (C,) of the classes, from the photons of a look and those before."""
        counts, noise = self._by_rail(found, asked)
        self._read, self._noise = self._read + counts, self._noise + noise
        photons = self._conditions.photons
        self._features += self._loop.features(counts) / photons
        self._dwell += self._gates / self._conditions.exposure_ns
        return self._loop.classify(self._loop.inputs(self._features, self._dwell), photons)

    def compare(self, on: AllOn) -> Likeness | None:
        """Comparison of all counts with the training; none where nothing of it is known."""
        known, header = self._loop.distribution, self._loop.header
        if known is None:
            return None
        each = (self._dwell * header.frames).reshape(header.masks, -1).T[:, :, None]
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
        manifest, header = self._masks.manifest, self._loop.header
        every = np.zeros((2, len(manifest.shown), manifest.inputs))
        rows = np.searchsorted(manifest.shown, shown.frames)
        counts, variance = found.photons.sum(axis=1), found.variance.sum(axis=1)
        seconds = (shown.gate_ns * 1e-9)[:, None]
        ambient, its_noise = self._conditions.ambient[:, rows]
        dark = (self._conditions.dark + ambient) * seconds
        noise = dark.clip(min=0) + its_noise * seconds**2 + (variance - counts).clip(min=0)
        every[:, rows] = counts - dark, noise
        held = by_readout(manifest, every)
        read, noise = held.reshape(2, header.rails, header.masks, header.detectors)
        return read, noise
