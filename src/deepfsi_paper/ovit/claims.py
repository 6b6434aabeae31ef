"""The paper's vision transformer with an optical front end, on CIFAR-10 in grey.

Images of 64 x 64 pixels are cut in 8 x 8 patches. The same 64 masks of 64 pixels are applied to
every patch, under `column`: nothing is compressed, and the masks do what a transformer's patch
projection does. Noise is added to the counts, and a transformer
classifies what is left.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from deepfsi.base.intervals import Difference, all_above, mean_of_trials
from deepfsi.base.progress import Progress
from deepfsi.datasets.dataset import Dataset
from deepfsi.design.design import Design
from deepfsi.report.accuracy import accuracy_figure
from deepfsi.report.style import photons_text
from deepfsi.sweeps.results import Point, Results, accuracy_difference
from deepfsi_paper.experiment import Experiment, Finding
from deepfsi_paper.measures import effective_directions
from deepfsi_paper.ovit.figures import LearnedMasks, patch_masks_figure
from deepfsi_paper.report.section import Claim, Picture, Table, english_list

LEARNED = "deepfsi"
"""Design whose masks are learned."""

LABEL = "OViT"
"""Label of the learned design."""

RIVALS = ("raster", "hadamard", "pca")
"""Designs that it is to surpass."""

SHOWN = (1e2, 1e4, 1e6)
"""Budgets whose masks are drawn, photons."""

NOTICED = 0.01
"""Difference of two shares of light that counts as one."""

PAPER = (
    "With as many masks as a patch has pixels, OViT outperforms all unsupervised codes on CIFAR-10 "
    "under photon noise, though its scanner is a single small layer before a large classifier: "
    "software cannot make up for unsuitable optics. Its masks are frugal, counting less light than "
    "there is, and where photons are few they repeat similar measurements instead of adding new "
    "features."
)
"""Finding of the paper."""


@dataclass(frozen=True)
class Measures:
    """Measures of the learned masks, by rising budget."""

    masks: Sequence[LearnedMasks]


def _measure(
    results: Results, data: Dataset, designs: Path, workers: int | None, report: Progress
) -> dict[str, Any]:
    """Throughput and directions of every trial's learned masks, and the masks of the first."""
    found = []
    learned = (point for point in results.points if point.design == LEARNED)
    for point in sorted(learned, key=lambda point: point.photons):
        made = [Design.load(designs / f"{key}.safetensors") for key in point.keys]
        matrices = [each.matrix for each in made]
        found.append(
            LearnedMasks(
                point.photons,
                side=math.isqrt(matrices[0].shape[1]),
                throughput=[sum(each.exposure.shares.tolist()) for each in made],
                directions=[effective_directions(matrix) for matrix in matrices],
                matrix=np.round(matrices[0], 6).tolist(),
            )
        )
    return asdict(Measures(found))


def show(results: Results) -> Finding:
    """Figures, claims and tables."""
    measures = TypeAdapter(Measures).validate_python(results.extra)
    return Finding(
        _found(results),
        _pictures(results, measures.masks),
        (*_accuracy_claims(results), *_mask_claims(measures.masks)),
        _tables(results, measures.masks),
    )


def _found(results: Results) -> str:
    [patch], size = results.recipe["exposure"]["patch"], results.data.image_shape
    budgets = {each.photons for each in results.points}
    middle = min(sorted(budgets), key=lambda budget: abs(np.log10(budget) - 4))
    ranks = sorted(
        (each for each in results.points if each.photons == middle), key=lambda each: -each.accuracy
    )
    return (
        f"{results.data.name} in grey, {size[0]} x {size[1]} pixels, in {patch} x {patch} "
        f"patches. The same {patch * patch} masks are applied to every patch, under "
        "the light law column; a budget is of the whole image, and is shared by the patches as "
        "their light is. "
        f"Trained on {results.data.train} images, tested on {results.data.test} under "
        f"exact photon noise. At {photons_text(middle)} photons: "
        + ", ".join(f"{each.label} {each.accuracy:.3f}" for each in ranks)
        + "."
    )


def _accuracy_claims(results: Results) -> list[Claim]:
    at = {(each.design, each.photons): each for each in results.points}
    budgets = sorted({photons for _, photons in at})
    return [ahead(at, rival, budgets) for rival in RIVALS if (rival, budgets[0]) in at]


def _mask_claims(masks: Sequence[LearnedMasks]) -> list[Claim]:
    return [
        grows(
            f"{LABEL} counts less light where photons are few, by {NOTICED} or more",
            [(row.photons, row.throughput) for row in (masks[0], masks[-1])],
            NOTICED,
            "With light split freely among readouts, what is not wanted may go to readouts that "
            "the classifier disregards: leaving it out gains nothing.",
        ),
        grows(
            f"{LABEL}'s masks repeat where photons are few, spanning fewer directions",
            [(row.photons, row.directions) for row in (masks[0], masks[-1])],
        ),
    ]


def _pictures(results: Results, masks: Sequence[LearnedMasks]) -> tuple[Picture, Picture]:
    highest = max(each.high for each in results.points)
    return (
        Picture(
            accuracy_figure(results, top=0.5 if highest < 0.49 else 1.0),
            "Accuracy against the photons of a whole image, photon noise. Bars: 95 % intervals "
            "over training seeds (of a single one, over test images).",
            "Accuracy of all designs against the photon budget; numbers in the table.",
        ),
        Picture(
            patch_masks_figure(
                [row for row in masks if row.photons in SHOWN or len(masks) <= len(SHOWN)]
            ),
            f"Masks of {LABEL} on patches of {masks[0].side} × {masks[0].side} pixels: those that "
            "count most photons, row by row. Each budget has a scale of its own.",
            f"Masks learned by {LABEL} at several budgets.",
        ),
    )


def _tables(results: Results, masks: Sequence[LearnedMasks]) -> tuple[Table, Table]:
    heads = (
        "design", "photons", "accuracy", "low", "high", "validation", "light counted", "trials",
        "interval over",
    )  # fmt: skip
    fields = (
        "label", "photons", "accuracy", "low", "high", "validation", "throughput", "trials",
        "covers",
    )  # fmt: skip
    ends = f"{photons_text(masks[0].photons)} and {photons_text(masks[-1].photons)} photons"
    return (
        Table(
            "Accuracy and light",
            heads,
            tuple(tuple(getattr(each, field) for field in fields) for each in results.points),
        ),
        Table(
            f"{LABEL}'s masks, at {ends} and between",
            ("photons", "share of the light counted", "independent directions"),
            tuple(
                (row.photons, float(np.mean(row.throughput)), float(np.mean(row.directions)))
                for row in masks
            ),
        ),
    )


def ahead(at: Mapping[tuple[str, float], Point], rival: str, budgets: Sequence[float]) -> Claim:
    """Claim that the learned design is above another at every budget."""
    compared: dict[float, Difference] = {
        budget: accuracy_difference(at[(LEARNED, budget)], at[(rival, budget)])
        for budget in budgets
        if (LEARNED, budget) in at and (rival, budget) in at
    }
    label = at[(rival, budgets[0])].label
    said = "; ".join(f"{each} at {photons_text(budget)}" for budget, each in compared.items())
    unclear = [photons_text(budget) for budget, each in compared.items() if each.low <= 0]
    return Claim(
        f"{LABEL} is above {label} at every budget",
        all_above(compared.values()),
        f"{LABEL} − {label}: {said} photons",
        f"not clearly above at {english_list(unclear)} photons" if unclear else "",
    )


def grows(
    text: str,
    ends: Sequence[tuple[float, Sequence[float]]],
    limit: float = 0.0,
    otherwise: str = "",
) -> Claim:
    """Claim that a measure of the masks grows with the light, by more than a limit."""
    said = " and ".join(
        f"{float(np.mean(values)):#.3g} at {photons_text(photons)}" for photons, values in ends
    )
    (_, dim), (_, bright) = ends
    each = mean_of_trials(np.subtract(bright, dim).tolist())
    holds = all_above([each], limit)
    return Claim(text, holds, f"{said} photons: {each}", otherwise if holds is False else "")


def _experiment(name: str, title: str) -> Experiment:
    """The study at one size."""
    return Experiment(name, title, PAPER, show, _measure, label=LABEL)


TITLE = "A vision transformer with an optical front end (OViT)"
EXPERIMENT = _experiment("ovit", TITLE)
IMAGES = _experiment("ovit-images", f"{TITLE}, all images")
FULL = _experiment("ovit-full", f"{TITLE}, all images and a larger transformer")
