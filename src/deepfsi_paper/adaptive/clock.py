"""Exposures by the clock: light falls uncounted while a mask is made and loaded."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepfsi.adaptive.choice import next_masks
from deepfsi.base.progress import Progress
from deepfsi.camera.device import DEVICES
from deepfsi.datasets.dataset import Dataset
from deepfsi.design.design import Design
from deepfsi.sweeps.results import Point, Results

EXPOSURES = 4
"""Exposures whose decisions are timed."""

LEAST_LEFT = 0.5
"""Share of an exposure that masks must leave for light to be compared."""


@dataclass(frozen=True)
class Prior:
    """Prior of the designs of a part and a variant.

    Attributes
    ----------
    recipe, variant : str
        Of the points of these designs.
    scenes : int
        Scenes, or centres that stand for them.
    decision_s : float
        Processor time from the counts of a look to the next mask: median, seconds.
    """

    recipe: str
    variant: str
    scenes: int
    decision_s: float


@dataclass(frozen=True)
class Measures:
    """Numbers beside the accuracies.

    Attributes
    ----------
    entropy : float
        Of the classes of the test scenes, bits.
    load_s : float
        Shortest time in which a device of `devices.toml` loads a pattern while it runs.
    priors : sequence of Prior
    """

    entropy: float
    load_s: float
    priors: Sequence[Prior]

    def dead_s(self, point: Point) -> float:
        """Seconds of each look of a point in which no photon is counted."""
        return self.load_s + next(
            each.decision_s
            for each in self.priors
            if (each.recipe, each.variant) == (point.recipe, point.variant)
        )


def measure(
    results: Results, data: Dataset, designs: Path, workers: int | None, report: Progress
) -> dict[str, Any]:
    """Entropy of the classes, sizes of priors and times of decisions; as `Experiment.measure`."""
    shares = np.bincount(data.y_test) / len(data.y_test)
    entropy = -float((shares * np.log2(shares, where=shares > 0, out=np.zeros_like(shares))).sum())
    last = {(p.recipe, p.variant): p for p in results.points if p.design == "adaptive"}
    priors = []
    for done, ((recipe, variant), point) in enumerate(last.items(), start=1):
        design = Design.load(designs / f"{point.keys[0]}.safetensors")
        seconds = decision_time(design, point.photons)
        priors.append(Prior(recipe, variant, len(design.prior_exposure.prior), seconds))
        report(done / len(last), "decisions")
    loads = (device.load_us for device in DEVICES.values() if device.load_us)
    return asdict(Measures(entropy, min(loads) * 1e-6, priors))


def decision_time(design: Design, photons: float, exposures: int = EXPOSURES) -> float:
    """Median time in s from the counts of a look to the next mask, one exposure alone."""
    generator, times = torch.Generator().manual_seed(0), []
    exposure = design.prior_exposure
    optics = exposure.optics_at(photons)
    with torch.no_grad():
        for scene in exposure.prior.mean.expand(exposures, -1):
            state = exposure.posterior(1, optics)
            masks = next_masks(state, exposure.settings.shares[0], generator)
            for share in exposure.settings.shares:
                counts = torch.poisson(state.expected(masks, scene[None], share), generator)
                began = time.perf_counter()
                state.update(masks, counts, share)
                masks = next_masks(state, share, generator)
                times.append(time.perf_counter() - began)
    return float(np.median(times))


@dataclass(frozen=True)
class Rival:
    """Designs of one number of masks at rising budgets, and what each mask costs.

    Attributes
    ----------
    points : sequence of Point
    dead_s : float
        Seconds of each mask in which no photon is counted.
    """

    points: Sequence[Point]
    dead_s: float = 0.0

    def at(self, flux: float, wall_s: float) -> tuple[float, float] | None:
        """Validation and test accuracy of an exposure of `wall_s`, of `flux` photons a second.

        Interpolated between budgets; None where too little of the time is left for light.
        """
        left = 1 - self.points[0].masks * self.dead_s / wall_s
        if left < LEAST_LEFT:
            return None
        known = ([p.validation or 0.0 for p in self.points], [p.accuracy for p in self.points])
        place, along = np.log(flux * wall_s * left), np.log([p.photons for p in self.points])
        validation, accuracy = (float(np.interp(place, along, each)) for each in known)
        return validation, accuracy


def rivals(points: Iterable[Point], measures: Measures | None = None) -> list[Rival]:
    """Designs by part, variant and number of masks, but those that lack a budget that others have.

    Where measures are given, each mask costs the time that it takes to make and to load.
    """
    groups: dict[tuple[str, str, int], list[Point]] = {}
    for point in sorted(points, key=lambda point: point.photons):
        groups.setdefault((point.recipe, point.variant, point.masks), []).append(point)
    most = max(map(len, groups.values()), default=0)
    return [
        Rival(own, measures.dead_s(own[0]) if measures else 0.0)
        for own in groups.values()
        if len(own) == most
    ]


def best_at(every: Iterable[Rival], flux: float, wall_s: float) -> float | None:
    """Test accuracy of the rival of highest validation accuracy; None where none has the time."""
    found = [at for each in every if (at := each.at(flux, wall_s))]
    return max(found)[1] if found else None
