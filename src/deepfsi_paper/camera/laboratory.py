"""The paper's camera in a virtual laboratory, and what the paper could not vary there.

A display, perspective, blur and vignetting, a micromirror device, one photon counter. As a lab
would, we calibrate with spots, train on the camera's view of MNIST at one assumed budget, export
the patterns, and test with gates of four exposures in the same frames. The protocol is the paper's
(ten test digits, one of each, ten exposures each), repeated for many draws of the ten digits.
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from deepfsi.base.intervals import Difference, mean_of_trials
from deepfsi.base.progress import Progress
from deepfsi.camera.device import find_device
from deepfsi.camera.layout import DmdLayout, find_grid
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.counting.acquisition import Calibration
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import load_dataset
from deepfsi.design.design import Design
from deepfsi.lab.calibration import fit_calibration, scan_rails, spot_scenes
from deepfsi.lab.design_data import view_dataset
from deepfsi.lab.virtual_optics import (
    CAMERAS,
    VirtualCamera,
    arrival_rates,
)
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.manifest import GatePlan
from deepfsi.patterns.rails import DesignRails
from deepfsi.sweeps.results import Point, Results
from deepfsi.sweeps.workers import cores, processes
from deepfsi_paper.camera.gate_counts import draw, draw_counts

FLUX = 1e7
"""Photons/s on the device from a mean scene."""

EXPOSURES = (1e-1, 1e-2, 1e-3, 1e-4)
"""Total exposure of one test, seconds."""

ASSUMED = 1e4
"""Budget for which all designs are trained, photons."""

SWEPT = (1e-2, 1e-3)
"""Exposures at which effects are varied, seconds."""

DRAWS = 20
"""Draws of ten digits."""

REPEATS = 10
"""Exposures of each digit."""

DEVICE = find_device("dlp7000")
"""The micromirror device of the paper."""

LAYOUT = DmdLayout(stretch=True)
"""Cells of the paper fill the device: 24 x 32 mirrors each."""

OURS = "deepfsi"
"""Name of DeepFSI with equal dwells among the tests."""

FREE = "deepfsi-free-dwell"
"""Name of DeepFSI with dwells of its own among the tests."""

LABELS = {OURS: "DeepFSI, equal dwell", FREE: "DeepFSI, free dwell"}
"""Names of the two in figures, tables and claims; all others have their own."""

LAB = CAMERAS["pmt"].model_copy(
    update={
        "efficiency": 1.0,
        "view": ((0.95, 0.03, 0.01), (-0.02, 0.94, 0.035), (0.015, -0.02, 1.0)),
        "blur": 8.0,
        "vignetting": 0.2,
    }
)
"""The laboratory: a photomultiplier behind a tilted, slightly blurred view of the display.

Its efficiency is 1, so that fluxes and budgets are of photons that can be counted.
"""

EFFECTS: dict[str, tuple[float, ...]] = {
    "ambient": (0.0, 1e5, 3e5, 1e6, 3e6, 1e7),
    "dark": (0.0, 1e4, 1e5, 3e5, 1e6),
    "dead_time_s": (0.0, 20e-9, 50e-9, 100e-9, 200e-9),
}
"""Effects varied one at a time: photons/s on the device, counts/s, seconds."""


@dataclass(frozen=True)
class DigitTest:
    """Success rates of one design, trained several times, with the ten digits of every draw."""

    design: str
    label: str
    specific: bool  # whether the design is feature-specific
    masks: int
    assumed: float  # photon budget assumed in training
    effect: str  # what the laboratory varies, or "none"
    value: float  # of the effect, in its unit
    exposure_s: float
    rates: Sequence[Sequence[Sequence[float]]]
    commonest: float

    @property
    def by_draw(self) -> np.ndarray:
        """Accuracy of each draw of the digits, mean over trainings."""
        return np.mean(self.rates, axis=(0, 2))

    @property
    def by_training(self) -> np.ndarray:
        """Accuracy of each training, mean over draws."""
        return np.mean(self.rates, axis=(1, 2))

    @property
    def by_digit(self) -> np.ndarray:
        """Success rates (draws, digits), mean over trainings."""
        return np.mean(self.rates, axis=0)

    @property
    def single(self) -> np.ndarray:
        """Success rates (trainings x draws, digits): each row one experiment as the paper's."""
        rates = np.asarray(self.rates)
        return rates.reshape(-1, rates.shape[-1])

    @property
    def accuracy(self) -> Difference:
        """Mean over draws, with its error; the error covers draws of digits, not trainings."""
        return mean_of_trials(self.by_draw.tolist())

    def less(self, other: "DigitTest") -> Difference:
        """Accuracy less another design's on the same digits, with its error over draws."""
        return mean_of_trials((self.by_draw - other.by_draw).tolist())


@dataclass(frozen=True)
class Measures:
    """Everything that is measured in the laboratory, as `hardware.json` holds it."""

    tests: Sequence[DigitTest]


@lru_cache(maxsize=1)
def calibrate() -> Calibration:
    """Calibration of the laboratory by spots, a white and a black display, as in a real one."""
    grid = find_grid(DEVICE, (32, 32), LAYOUT)
    spots = spot_scenes()
    scenes = np.concatenate([spots, np.ones((1, 32, 32)), np.zeros((1, 32, 32))])
    exposure = 10.0
    raster = scan_rails("raster", (32, 32))
    with tempfile.TemporaryDirectory() as folder:
        dwell_s = 1.1 * exposure / raster.rails.shape[1]
        planned = Patterns.from_rails(raster, DEVICE, dwell_s, layout=LAYOUT)
        patterns = planned.write(Path(folder) / "raster")
        arrivals = arrival_rates(patterns, scenes, LAB, FLUX)
    rng = np.random.default_rng(1)
    gates = GatePlan.of(patterns.manifest, exposure, repeats=1)
    counts = draw_counts(arrivals, patterns.manifest, gates, LAB, rng)
    pictures = counts[:, 0, 0].reshape(len(scenes), 32, 32)
    found = fit_calibration(spots, pictures[:-2], grid, white=pictures[-2], black=pictures[-1])
    return found.model_copy(update={"dark": float(arrivals[-1, 1, 0])})  # all mirrors OFF


def prepare(data: Dataset) -> Dataset:
    """The camera's view of a data set."""
    return view_dataset(data, calibrate())


@dataclass(frozen=True)
class _MountedDesign:
    """A design on the device, and the light of some scenes on the detector."""

    design: Design  # as the patterns realise it
    patterns: Patterns
    scene_rates: np.ndarray
    ambient_rates: np.ndarray  # (1, F, 1), The same for one photon/s of ambient light

    def arrivals(self, camera: VirtualCamera) -> np.ndarray:
        """Arrivals/s (S, F, 1) at a camera's detector."""
        photons = self.scene_rates + camera.ambient * self.ambient_rates
        return camera.efficiency * photons + camera.dark


def _draw_digits(labels: np.ndarray, draws: int, seed: int) -> np.ndarray:
    """Places (draws, classes) of one scene of each class, no scene twice."""
    rng = np.random.default_rng(seed)
    classes = np.unique(labels)
    columns = [rng.choice(np.flatnonzero(labels == k), draws, replace=False) for k in classes]
    return np.stack(columns, axis=1)


def _mount(design: Design, scenes: np.ndarray) -> _MountedDesign:
    """A design exported to the device, and scenes (S, h, w) seen through it by the laboratory."""
    optics = LAB.model_copy(update={"dark": 0.0, "ambient": 0.0})
    with tempfile.TemporaryDirectory() as folder:
        patterns = _export(design, Path(folder) / "patterns")
        scene_rates = arrival_rates(patterns, scenes, optics, FLUX)
        one = optics.model_copy(update={"ambient": 1.0})
        ambient_rates = arrival_rates(patterns, np.zeros_like(scenes[:1]), one, 0.0)
    return _MountedDesign(design.as_shown(*patterns.realised), patterns, scene_rates, ambient_rates)


def _export(design: Design, folder: Path) -> Patterns:
    """Patterns whose frames last for `REPEATS` of the longest exposures, and a little more."""
    rails = design.rails.stacked.numpy()
    light = design.mask_exposure.light
    frames = int((rails.max(axis=-1) > 0).sum())
    share = float(rails.max()) if LIGHT_LAWS[light].equal_times else 1 / frames
    dwell = 1.01 * REPEATS * max(EXPOSURES) * share + DEVICE.settle_us * 1e-6
    return Patterns.from_rails(
        DesignRails(rails, light, design.image_shape, design.summed_reflectance),
        DEVICE,
        dwell,
        layout=LAYOUT,
    ).write(folder)


def classify(
    mounted: _MountedDesign,
    camera: VirtualCamera,
    exposure_s: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """Classes (S, R) that a design gives to exposures of a camera.

    The budget is estimated from the all-ON frames and the dark rate from the all-OFF ones, as for
    a real run; no one knows of ambient light.
    """
    manifest = mounted.patterns.manifest
    gates = GatePlan.of(manifest, exposure_s, repeats=REPEATS)
    arrivals = mounted.arrivals(camera)
    counts = draw_counts(arrivals, manifest, gates, camera, rng)
    window = manifest.picture_s[:2] - gates.settle_s
    on, off = (draw(camera, arrivals[:, :2, 0], window, rng) / window).mean(axis=0)
    signal = counts - off * manifest.lengths_by_readout(manifest.shares * exposure_s)
    chances = mounted.design.classify(mounted.design.readouts(signal), (on - off) * exposure_s)
    return chances.argmax(axis=-1)


Group = tuple[str, list[Point]]
"""A design's name and its points, one for each budget that it was trained for."""


@dataclass(frozen=True)
class Laboratory:
    """Files and digits with which every design is tested."""

    designs: Path  # folder of their files
    images: np.ndarray  # (S, h, w), Reflectance on the display
    truth: np.ndarray  # (draws, classes), Labels; S is their number


def _design_groups(results: Results) -> list[Group]:
    """Designs with their points at the chosen number of masks."""
    groups: dict[str, list[Point]] = {}
    for point in results.points:
        if point.best:
            name = point.design if LIGHT_LAWS[point.light].equal_times else FREE
            groups.setdefault(name, []).append(point)
    return [*groups.items()]


def measure(
    results: Results, data: Dataset, designs: Path, workers: int | None, report: Progress
) -> dict[str, Any]:
    """Tests of every design in the laboratory, several at a time."""
    raw = load_dataset(results.recipe["data"])
    places = _draw_digits(raw.y_test, DRAWS, seed=0)
    laboratory = Laboratory(
        designs, raw.x_test[places.ravel()].reshape(-1, *raw.image_shape), raw.y_test[places]
    )
    groups = dict(_design_groups(results))
    costly_first = sorted(groups.items(), key=lambda group: -group[1][0].masks)
    report(0.0, "laboratory")
    done: dict[str, list[DigitTest]] = {}
    at_once = min(workers or cores(), len(groups))
    for result in processes(_in_laboratory, laboratory, costly_first, at_once):
        done[result[0].design] = result
        report(len(done) / len(groups), "laboratory")
    return asdict(Measures([test for name in groups for test in done[name]]))


def _in_laboratory(laboratory: Laboratory, group: Group) -> list[DigitTest]:
    """Tests of one design, trained for several budgets and several times for each."""
    name, points = group
    tests: list[DigitTest] = []
    mounted_by_masks: dict[bytes, _MountedDesign] = {}  # fixed masks are the same in every training
    for point in points:
        mounted = [
            _mounted_design(
                Design.load(laboratory.designs / f"{key}.safetensors"), laboratory, mounted_by_masks
            )
            for key in point.keys
        ]
        for effect, value, camera, exposure in _conditions(point.photons):
            rates, commonest = [], []
            for training, each in enumerate(mounted):
                rng = np.random.default_rng([training, len(tests)])
                classes = classify(each, camera, exposure, rng)
                classes = classes.reshape(*laboratory.truth.shape, REPEATS)
                commonest.append(np.bincount(classes.ravel()).max() / classes.size)
                rates.append((classes == laboratory.truth[..., None]).mean(axis=-1).tolist())
            tests.append(
                DigitTest(
                    design=name,
                    label=LABELS.get(name, point.label),
                    specific=point.specific,
                    masks=point.masks,
                    assumed=point.photons,
                    effect=effect,
                    value=value,
                    exposure_s=exposure,
                    rates=rates,
                    commonest=float(np.mean(commonest)),
                )
            )
    return tests


def _mounted_design(
    design: Design, laboratory: Laboratory, known: dict[bytes, _MountedDesign]
) -> _MountedDesign:
    """A design on the device; what one with the same masks was mounted for before serves again."""
    masks = design.rails.stacked.numpy().tobytes()
    if masks not in known:
        known[masks] = _mount(design, laboratory.images)
    return replace(known[masks], design=design.as_shown(*known[masks].patterns.realised))


def _conditions(assumed: float) -> Iterator[tuple[str, float, VirtualCamera, float]]:
    """Effect, its value, camera and exposure; effects only at the laboratory's own budget."""
    yield from (("none", 0.0, LAB, exposure) for exposure in EXPOSURES)
    if assumed == ASSUMED:
        for effect, values in EFFECTS.items():
            for value, exposure in product(values, SWEPT):
                yield effect, value, LAB.model_copy(update={effect: value}), exposure
