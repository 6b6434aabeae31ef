"""Measures of the masks that OViT learns, as `ovit.json` holds them."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepfsi.optics.measures import effective_directions
from deepfsi.report.comparison_page import read_masks

LEARNED = "deepfsi"
"""Design whose masks are learned."""


@dataclass(frozen=True)
class LearnedMasks:
    """Learned masks of one budget.

    Attributes
    ----------
    photons : float
    side : int
        Of a patch, pixels.
    throughput, directions : sequence of float
        Share of the budget counted, and independent directions, of each trial's masks.
    matrix : array, shape (m, side²)
        Masks of the first trial.
    """

    photons: float
    side: int
    throughput: Sequence[float]
    directions: Sequence[float]
    matrix: Sequence[Sequence[float]]


@dataclass(frozen=True)
class Measures:
    """Measures of the learned masks, by rising budget."""

    masks: Sequence[LearnedMasks]


def measure_masks(records: Sequence[Mapping[str, Any]], designs: Path) -> Measures:
    """Throughput and directions of every trial's learned masks, and the masks of the first."""
    trials = defaultdict(list)
    for record in records:
        if record["trial"]["job"]["design"] == LEARNED:
            trials[record["trial"]["job"]["photons"]].append(record)
    found = []
    for photons, members in sorted(trials.items()):
        rails = [read_masks(designs / f"{record['design']}.safetensors")[0] for record in members]
        matrices = [each[0] - each[1] for each in rails]
        found.append(
            LearnedMasks(
                photons,
                side=members[0]["trial"]["job"]["patch"],
                throughput=[record["test"][0]["throughput"] for record in members],
                directions=[effective_directions(matrix) for matrix in matrices],
                matrix=np.round(matrices[0], 6).tolist(),
            )
        )
    return Measures(found)
