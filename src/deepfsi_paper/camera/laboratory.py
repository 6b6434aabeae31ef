"""The paper's camera in a virtual laboratory.

A display, perspective, blur and vignetting, a micromirror device, one photon counter. As a lab
would, we calibrate with spots, train on the camera's view of MNIST at one assumed budget, export
the patterns, and test with gates of four exposures in the same frames. The protocol is the paper's
(ten test digits, one of each, ten exposures each), repeated for many draws of the ten digits.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
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
from deepfsi.lab.virtual_optics import CAMERAS, arrival_rates
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.manifest import GatePlan, Manifest
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


@dataclass(frozen=True)
class DigitTest:
    """Success rates of one design, trained several times, with the ten digits of every draw."""

    design: str
    label: str
    specific: bool  # whether the design is feature-specific
    exposure_s: float
    rates: Sequence[Sequence[Sequence[float]]]  # (trainings, draws, digits)

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


def _draw_digits(labels: np.ndarray, draws: int, seed: int) -> np.ndarray:
    """Places (draws, classes) of one scene of each class, no scene twice."""
    rng = np.random.default_rng(seed)
    classes = np.unique(labels)
    columns = [rng.choice(np.flatnonzero(labels == k), draws, replace=False) for k in classes]
    return np.stack(columns, axis=1)


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


def _classify(
    design: Design,
    manifest: Manifest,
    arrivals: np.ndarray,
    exposure_s: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """Classes (S, R) of exposures of S scenes, from arrivals/s (S, F, 1) in each frame.

    The budget is estimated from the all-ON frames and the dark rate from the all-OFF ones, as for
    a real run.
    """
    gates = GatePlan.of(manifest, exposure_s, repeats=REPEATS)
    counts = draw_counts(arrivals, manifest, gates, LAB, rng)
    window = manifest.picture_s[:2] - gates.settle_s
    on, off = (draw(LAB, arrivals[:, :2, 0], window, rng) / window).mean(axis=0)
    signal = counts - off * manifest.lengths_by_readout(manifest.shares * exposure_s)
    chances = design.classify(design.readouts(signal), (on - off) * exposure_s)
    return chances.argmax(axis=-1)


@dataclass(frozen=True)
class Laboratory:
    """Files and digits with which every design is tested."""

    designs: Path  # folder of their files
    images: np.ndarray  # (S, h, w), Reflectance on the display
    truth: np.ndarray  # (draws, classes), Labels; S is their number


def measure(
    results: Results, data: Dataset, designs: Path, workers: int | None, report: Progress
) -> dict[str, Any]:
    """Tests of every design in the laboratory, several at a time."""
    raw = load_dataset(results.recipe["data"])
    places = _draw_digits(raw.y_test, DRAWS, seed=0)
    laboratory = Laboratory(
        designs, raw.x_test[places.ravel()].reshape(-1, *raw.image_shape), raw.y_test[places]
    )
    points = sorted((each for each in results.points if each.best), key=lambda each: -each.masks)
    report(0.0, "laboratory")
    tests: list[DigitTest] = []
    at_once = min(workers or cores(), len(points))
    for done, some in enumerate(processes(_in_laboratory, laboratory, points, at_once), start=1):
        tests += some
        report(done / len(points), "laboratory")
    return asdict(Measures(tests))


def _in_laboratory(laboratory: Laboratory, point: Point) -> list[DigitTest]:
    """Tests of one design, trained several times, at every exposure."""
    rates: dict[float, list[Any]] = {exposure: [] for exposure in EXPOSURES}
    for training, key in enumerate(point.keys):
        design = Design.load(laboratory.designs / f"{key}.safetensors")
        with tempfile.TemporaryDirectory() as folder:
            patterns = _export(design, Path(folder) / "patterns")
            arrivals = arrival_rates(patterns, laboratory.images, LAB, FLUX)
            shown = design.as_shown(*patterns.realised)
        for number, exposure in enumerate(EXPOSURES):
            rng = np.random.default_rng([training, number])
            classes = _classify(shown, patterns.manifest, arrivals, exposure, rng)
            right = classes.reshape(*laboratory.truth.shape, -1) == laboratory.truth[..., None]
            rates[exposure].append(right.mean(axis=-1).tolist())
    name = point.design if LIGHT_LAWS[point.light].equal_times else FREE
    return [
        DigitTest(name, LABELS.get(name, point.label), point.specific, exposure, of_trainings)
        for exposure, of_trainings in rates.items()
    ]
