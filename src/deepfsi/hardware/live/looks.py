"""Looks of a live run: which frames come next, and the classes that their counts tell.

A design chooses its looks: with networks the dwells of masks that do not change (`FixedMaskLooks`),
or each mask itself. A run hands counts to whatever keeps to `LookChooser`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.camera.stop_rule import StopRule
from deepfsi.designfile.design_file import DesignFile
from deepfsi.designfile.loop_file import read_loop
from deepfsi.designfile.provenance import TrainingScenes
from deepfsi.designfile.view_test import SceneModel
from deepfsi.hardware.counting.streaming import FrameCounts
from deepfsi.hardware.light.curves import Arrivals
from deepfsi.hardware.patterns.folder import Patterns, read_patterns
from deepfsi.hardware.patterns.manifest import Manifest

DECISION_S = 0.4e-3
"""Usual time from the counts to the class and the next dwells, seconds (`benchmarks/live.py`)."""


GATE_STEP_NS = 1
"""Step of the gates, by which a dwell near its middle is rounded up or down, ns."""

GATE_ROUNDING = 1e-5
"""Share by which dwells differ that two processors choose from the same counts.

Networks choose them in float32. Four kernels of OpenBLAS (SkylakeX, Haswell, Sandybridge, Prescott)
gave dwells that differ by 6e-7 at most: ten steps of 2⁻²⁴, in 100 exposures of 60 masks in four
looks. This leaves a factor of 16 for larger networks; no count changes by 0.01 of its noise below
10⁶ photons.
"""


@dataclass(frozen=True)
class FrameList:
    """Frames that are shown one after another, and counted."""

    look: int  # from 0
    frames: np.ndarray  # places among the frames of the manifest
    gate_ns: np.ndarray  # for how long each is counted
    masks: np.ndarray | None = None


class FrameSource(Protocol):
    """Source of counts of frames: devices that show and count them, or the record of a run."""

    def count(self, asked: FrameList) -> FrameCounts:
        """Counts of the frames of a list."""


class ShownLooks(Protocol):
    """Looks of a scene that a run showed: its replay decides from these, not from its own."""

    @property
    def ended(self) -> bool:
        """True if no look was shown after those that were followed."""

    def follow(self, asked: FrameList, exposure: "LiveExposure") -> FrameList:
        """The next look as it was shown; `InputError` if not by rounding alone another one."""


class SceneSignal(NamedTuple):
    """Counts of frames that are a scene's, and the variance beyond that of Poisson counts."""

    counts: np.ndarray  # (F, inputs)
    noise: np.ndarray  # (F, inputs)


@dataclass(frozen=True)
class ExposureState:
    """Conditions of one exposure, as far as they are measured when it begins."""

    photons: float  # budget of all looks together, counts
    exposure_ns: int  # time of all looks together
    shortest_ns: int
    dark: np.ndarray  # dark counts, counts/s
    ambient: np.ndarray

    def signal(self, asked: FrameList, rows: np.ndarray, arrivals: Arrivals) -> SceneSignal:
        """Counts of a look less those that are no scene's, of frames at some of the masks' rows."""
        ambient, its_noise = self.ambient[:, rows]
        counts = arrivals.photons.sum(axis=1)
        variance = arrivals.variance.sum(axis=1)
        seconds = (asked.gate_ns * 1e-9)[:, None]
        dark = (self.dark + ambient) * seconds
        noise = dark.clip(min=0) + its_noise * seconds**2 + (variance - counts).clip(min=0)
        return SceneSignal(counts - dark, noise)


@dataclass(frozen=True)
class AllOnCounts:
    """Counts of the all-ON frames of a scene, all together."""

    counts: float  # less what is no scene's
    noise: float  # variance beyond the counts' own
    seconds: float  # time of the frames


@dataclass(frozen=True)
class SceneComparison:
    """Comparison of a scene's counts with those of the training."""

    chance: float
    unsure: bool  # True if it is below that of a sound scene's false alarm
    detail: str


class LiveExposure(Protocol):
    """One exposure of a scene, look after look."""

    def ask(self, look: int) -> FrameList:
        """Frames of the next look."""

    def take(self, asked: FrameList, arrivals: Arrivals) -> np.ndarray:
        """Probabilities (C,) of the classes, from the photons of a look and those before."""

    def may_be(self, asked: FrameList, shown: FrameList) -> bool:
        """True if a processor that rounds differently may ask for what was shown."""

    def compare(self, on: AllOnCounts) -> SceneComparison | None:
        """Comparison of all counts with the training; none where nothing of it is known."""


class LookChooser(Protocol):
    """Looks of a design, as a live run needs them."""

    shares: tuple[float, ...]  # of the exposure that each look takes
    classes: tuple[str, ...]
    photons: float | None  # budget of the training
    rule: StopRule | None  # of the design, where it has one
    shortest: float  # dwell that it was made for, a share of the exposure
    decision_s: float  # usual time of a decision on one core, seconds
    training_scenes: TrainingScenes | None  # hashes of the scenes that the design was made with
    scene_model: SceneModel | None  # of the training; none where runs are not tested against it

    def expose(self, scene: int, state: ExposureState) -> LiveExposure:
        """Begin an exposure of a scene."""

    def lit(self, asked: FrameList) -> np.ndarray:
        """Share of each pixel's mirrors that are ON in frames of a look, (F, N)."""


class FixedMaskLooks:
    """Looks at masks that do not change, whose dwells networks choose.

    Its attributes are those of `LookChooser`.

    Parameters
    ----------
    design : DesignFile
        Of several looks.
    patterns : Patterns
        Frames of its masks.
    """

    def __init__(self, design: DesignFile, patterns: Patterns) -> None:
        manifest = patterns.manifest
        looks = design.looks.looks
        assert manifest.looks is not None
        self.design = design
        self.manifest = manifest
        self.shares = (design.looks.cap / looks,) * looks
        self.classes = design.header.classes
        self.photons = design.photons
        self.rule = design.stop_rule
        self.shortest = design.looks.cap * design.looks.shortest
        self.decision_s = DECISION_S
        self.training_scenes = design.training_scenes
        self.scene_model = design.scene_model
        masks = np.array([manifest.frames[at].mask for at in manifest.shown])
        rails = np.array([manifest.frames[at].rail for at in manifest.shown])
        self.dwell_of_frame = manifest.looks.places(masks, rails == "minus")
        self._fractions = patterns.fractions

    @classmethod
    def read(cls, folder: Path, patterns: Patterns | None = None) -> "FixedMaskLooks":
        """Looks of a folder of patterns.

        Parameters
        ----------
        folder : path
            Patterns of a design of several looks, with its file, or in folders of earlier versions
            with its networks alone.
        patterns : Patterns, optional
            These, where they were read.

        Raises
        ------
        InputError
            If the files are damaged, or of fixed dwells or adaptive masks.
        """
        patterns = patterns or read_patterns(folder)
        manifest = patterns.manifest
        if manifest.looks is None:
            raise InputError(
                "{folder} has the patterns of a design of fixed dwells: learn one of several "
                "{looks}, or record it with `deepfsi camera simulate` or `prepare`",
                setting="looks",
                folder=folder,
            )
        if manifest.looks.adaptive:
            raise InputError(
                "{folder} has adaptive masks, and the design says which comes next: give its "
                "{looks}",
                setting="looks",
                folder=folder,
            )
        if manifest.design_sha256 is not None:
            return cls(DesignFile.read(folder / Patterns.DESIGN), patterns)
        rails, image_shape, _ = patterns.realised
        detectors = manifest.detectors and manifest.detectors.cells
        design = read_loop(
            folder / Patterns.LOOP,
            rails,
            image_shape=image_shape,
            light=manifest.light,
            summed_reflectance=manifest.summed_reflectance,
            detectors=None if detectors is None else np.array(detectors),
        )
        return cls(design, patterns)

    def expose(self, scene: int, state: ExposureState) -> "FixedMaskExposure":
        """Begin an exposure of a scene."""
        return FixedMaskExposure(self, state)

    def lit(self, asked: FrameList) -> np.ndarray:
        """Share of each pixel's mirrors that are ON in frames of a look, (F, N)."""
        return self._fractions[rows_of(self.manifest, asked)]


def rows_of(manifest: Manifest, asked: FrameList) -> np.ndarray:
    """Places (F,) of a look's frames among those of the masks."""
    return np.searchsorted(manifest.shown, asked.frames)


class FixedMaskExposure:
    """One exposure of a scene with masks that do not change."""

    def __init__(self, looks: FixedMaskLooks, state: ExposureState) -> None:
        design = looks.design
        self._looks = looks
        self._design = design
        self._state = state
        self._whole_ns = design.looks.cap * state.exposure_ns  # dwells are shares of it
        self._features = np.zeros(design.feature_count)
        self._dwell = np.zeros(design.frames)
        self._gates = np.zeros(design.frames, np.int64)  # of the present look
        self._shape = design.rail_count, design.masks, design.detector_count
        self._counts, self._noise = np.zeros((2, *self._shape))
        self._look = 0

    def ask(self, look: int) -> FrameList:
        """Frames of the next look, for the dwells that the networks choose."""
        inputs = self._design.inputs(self._features, self._dwell)
        dwell = self._design.next_dwell(inputs, look, self._state.shortest_ns / self._whole_ns)
        self._gates = np.rint(dwell * self._whole_ns).astype(np.int64)
        self._look = look
        gates = self._gates[self._looks.dwell_of_frame]
        lit = gates > 0
        return FrameList(look, self._looks.manifest.shown[lit], gates[lit])

    def may_be(self, asked: FrameList, shown: FrameList) -> bool:
        """True if a processor that rounds differently may ask for what was shown."""
        if shown.look != asked.look:
            return False
        frames = np.union1d(shown.frames, asked.frames)
        gates = np.zeros((2, len(frames)))
        gates[0, np.searchsorted(frames, shown.frames)] = shown.gate_ns
        gates[1, np.searchsorted(frames, asked.frames)] = asked.gate_ns
        both = gates.min(axis=0) > 0
        if not both.any():
            return False
        one, other = gates[:, both]
        if not both.all():
            # Rounding decides if a frame of the shortest gate is shown. Where it is not, its time
            # is shared out among the others in proportion to theirs
            one = one * (other.sum() / one.sum())
        lone = gates[:, ~both].max(axis=0)
        return (
            _differ_by_rounding(one, other)
            and _differ_by_rounding(lone, self._state.shortest_ns)
            and _differ_by_rounding(gates[0].sum(), gates[1].sum(), steps=len(frames))
        )

    def take(self, asked: FrameList, arrivals: Arrivals) -> np.ndarray:
        """Probabilities (C,) of the classes, from the photons of a look and those before."""
        counts, noise = self._by_rail(asked, arrivals)
        self._counts = self._counts + counts
        self._noise = self._noise + noise
        photons = self._state.photons
        self._features += self._design.features(counts) / photons
        # The network is told the gates that were shown, not the dwells that it asked for
        shown = np.zeros(len(self._looks.manifest.shown), np.int64)
        shown[rows_of(self._looks.manifest, asked)] = asked.gate_ns
        self._gates[self._looks.dwell_of_frame] = shown
        self._dwell += self._gates / self._whole_ns
        return self._design.chances(self._design.inputs(self._features, self._dwell), photons)

    def compare(self, on: AllOnCounts) -> SceneComparison | None:
        """Comparison of all counts with the training; none where nothing of it is known."""
        design = self._design
        distribution = design.distribution
        if distribution is None:
            return None
        dwell = (self._dwell * design.frames).reshape(design.masks, -1).T[:, :, None]
        dwell = np.broadcast_to(dwell, self._counts.shape).ravel()
        on_dwell = on.seconds / (self._state.exposure_ns * 1e-9)
        result = distribution.after(self._look).test(
            np.append(self._counts, on.counts)[None, None],
            np.array([self._state.photons]),
            np.append(self._noise, on.noise)[None, None],
            np.append(dwell, on_dwell)[None, None],
        )
        detail = f"{result.brightness:.2f} times the counts of its mean scene at this budget"
        return SceneComparison(float(result.exposures[0]), bool(result.unsure[0]), detail)

    def _by_rail(self, asked: FrameList, arrivals: Arrivals) -> np.ndarray:
        """Counts of a look that are a scene's, and noise beyond their own: (2, rails, m, D)."""
        manifest = self._looks.manifest
        rows = rows_of(manifest, asked)
        every = np.zeros((2, len(manifest.shown), manifest.inputs))
        every[:, rows] = self._state.signal(asked, rows, arrivals)
        return manifest.by_readout(every).reshape(2, *self._shape)


def _differ_by_rounding(gates_ns: Any, others_ns: Any, steps: int = 1) -> bool:
    """True if no gate (F,), each a sum of so many, is further from another than by rounding."""
    return bool(
        (abs(gates_ns - others_ns) <= steps * GATE_STEP_NS + GATE_ROUNDING * gates_ns).all()
    )
