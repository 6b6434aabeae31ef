"""Test vectors: counts of small designs, and what every reader of their files must make of them.

`vectors.json` holds files of designs and their answers, of torch. The tests of `Design` and of the
page's JavaScript read it. ``python -m shared.vectors`` in this folder's
parent writes it anew, which is to be done only where an answer has changed on purpose.
"""

import base64
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from conftest import synthetic
from deepfsi import Design
from deepfsi.datasets.dataset import Dataset
from shared.jobs import learn

PATH = Path(__file__).with_name("vectors.json")

AGREES = 1e-5
"""Difference of probabilities of two readers, at most: they compute in 32 bits."""

ONE_ARM = {"light": "free-dwell", "rails": "single"}
KINDS: dict[str, dict[str, Any]] = {
    "fixed": {"masks": 4, **ONE_ARM},
    "fixed dual": {"masks": 4, "light": "column"},
    "fixed both": {"masks": 3, "light": "free-dwell", "readout": "both"},
    "fixed detectors": {"masks": 3, "light": "two-arm", "readout": "both", "detectors": "2x2"},
    "range": {"masks": 4, "span": 1e3, "photons": 1e2, **ONE_ARM},
}
"""Settings of the designs."""

CASES = 6
"""Exposures of each design, at budgets from far below those of its calibration to far above."""


@dataclass(frozen=True)
class Vector:
    """Counts of one exposure, and the answer to them."""

    counts: np.ndarray
    """Shape (rails, m, D)."""
    photons: float
    """Its budget."""
    chances: np.ndarray
    """Shape (C,)."""


def read_vectors(kind: str) -> tuple[bytes, np.ndarray, list[Vector]]:
    """File of a design, its sensing matrix (m, N), and its vectors."""
    entry = json.loads(PATH.read_text())[kind]
    vectors = [
        Vector(**{n: np.array(v) if isinstance(v, list) else v for n, v in fields.items()})
        for fields in entry["vectors"]
    ]
    return base64.b64decode(entry["file"]), np.array(entry["matrix"]), vectors


def write_file(kind: str, folder: Path) -> tuple[Path, np.ndarray, list[Vector]]:
    """The same, with the path of the file in a folder."""
    content, matrix, vectors = read_vectors(kind)
    path = folder / "design.safetensors"
    path.write_bytes(content)
    return path, matrix, vectors


def scenes() -> Dataset:
    """Scenes that the designs were learned on."""
    return synthetic((4, 4), scenes=360)


def answer(design: Design, vector: Vector) -> np.ndarray:
    """Chances of the counts of a vector."""
    return design.classify(vector.counts.reshape(design.counts_shape), vector.photons)


def main() -> None:
    """Learn the designs and write their vectors."""
    rng, entries = np.random.default_rng(0), {}
    bare = dict.fromkeys(("distribution", "scene_model", "training_scenes"))
    for kind, settings in KINDS.items():
        job = {"photons": 1e3, "epochs": 8, "lr": 2e-2, "hidden": (5, 4), **settings}
        learned = learn(scenes(), device="cpu", **job)
        design = replace(learned, info={"job": learned.info["job"]}, **bare)
        drawn = [draw(design, float(photons), rng) for photons in np.geomspace(3, 3e6, CASES)]
        entries[kind] = {
            "file": base64.b64encode(design.to_bytes()).decode(),
            "matrix": design.matrix.tolist(),
            "vectors": [vars(one) for one in drawn],
        }
    PATH.write_text(json.dumps(entries, indent=0, default=np.ndarray.tolist) + "\n")


def draw(design: Design, photons: float, rng: np.random.Generator) -> Vector:
    """Vector of a design."""
    mean = photons * float(design.shares.mean()) / design.detection.width(design.rails.count)
    shape = (design.rails.count, design.masks, design.detection.count)
    counts = rng.poisson(mean * rng.uniform(0.5, 1.5, shape))
    vector = Vector(counts, photons, chances=np.empty(0))
    return replace(vector, chances=answer(design, vector))


if __name__ == "__main__":
    main()
