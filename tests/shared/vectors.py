"""Test vectors: counts of small designs, and what every reader of their files must make of them.

`vectors.json` holds files of designs and their answers, of torch. The tests of `Design`, of
`DesignFile` and of the page's JavaScript read it. ``python -m shared.vectors`` in this folder's
parent writes it anew, which is to be done only where an answer has changed on purpose.
"""

import base64
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from conftest import synthetic
from deepfsi import Design
from deepfsi.camera.light import share_out
from deepfsi.datasets.dataset import Dataset
from deepfsi.exposure.kind import Observation
from shared.jobs import learn

PATH = Path(__file__).with_name("vectors.json")

AGREES = 1e-5
"""Difference of probabilities and dwells of two readers, at most: they compute in 32 bits."""

ONE_ARM = {"light": "free-dwell", "rails": "single"}
KINDS: dict[str, dict[str, Any]] = {
    "fixed": {"masks": 4, **ONE_ARM},
    "fixed dual": {"masks": 4, "light": "column"},
    "fixed both": {"masks": 3, "light": "free-dwell", "readout": "both"},
    "fixed detectors": {"masks": 3, "light": "two-arm", "readout": "both", "detectors": "2x2"},
    "range": {"masks": 4, "span": 1e3, "photons": 1e2, **ONE_ARM},
    "nested": {"masks": 5, "nested": 2, "span": 1e3, "photons": 1e2, **ONE_ARM},
    "nested both": {"masks": 4, "nested": 2, "light": "free-dwell", "readout": "both"},
    "looks": {"masks": 4, "looks": 3, "shortest_dwell": 0.03, **ONE_ARM},
    "looks both": {"masks": 3, "looks": 4, "light": "free-dwell", "readout": "both"},
    "looks arms": {"masks": 4, "looks": 2, "light": "two-arm"},
}
"""Settings of the designs."""

CASES = 6
"""Exposures of each design, at budgets from far below those of its calibration to far above."""


@dataclass(frozen=True)
class Vector:
    """Counts of one exposure so far, and the answers to them."""

    counts: np.ndarray
    """Shape (rails, m, D); of several looks, all so far together."""
    photons: float
    """Budget of the whole exposure."""
    masks: int
    """First masks that were shown; all but of nested ones."""
    chances: np.ndarray
    """Shape (C,)."""
    dwell: np.ndarray | None = None
    """Share of the exposure that each frame had so far (q,), where dwells are chosen."""
    look: int | None = None
    """The next look, from 0, if there is one."""
    next_dwell: np.ndarray | None = None
    """Its dwells (q,)."""


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


@torch.no_grad()
def answer(design: Design, vector: Vector) -> tuple[np.ndarray, np.ndarray | None]:
    """Chances of the counts of a vector, and the next dwells where it has a next look."""
    exposure = design.exposure
    part = design if vector.masks == design.masks else design.first(vector.masks)
    counts = vector.counts[:, : vector.masks].reshape(part.counts_shape)
    photons = vector.photons * part.exposure.used / exposure.used
    dwell = None if vector.dwell is None else exposure.dwells.by_rail(vector.dwell)
    chances = part.classify(counts, photons, dwell)
    if vector.look is None:
        return chances, None
    features = design.features_of(torch.from_numpy(counts).float()) / vector.photons
    seen = Observation(features, torch.from_numpy(vector.dwell).float())
    left = torch.tensor([1 - vector.look / exposure.looks])
    chosen = exposure.next_dwell(exposure.network, seen.inputs(design.mean, design.std), left)
    return chances, share_out(chosen.double().numpy(), exposure.shortest)


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
            "vectors": [{n: v for n, v in vars(one).items() if v is not None} for one in drawn],
        }
    PATH.write_text(json.dumps(entries, indent=0, default=np.ndarray.tolist) + "\n")


def draw(design: Design, photons: float, rng: np.random.Generator) -> Vector:
    """Vector of the first masks of a design, all unless they are nested, or of one of its looks."""
    mean = photons * float(design.shares.mean()) / design.detection.width(design.rails.count)
    shape = (design.rails.count, design.masks, design.detection.count)
    counts, looks = rng.poisson(mean * rng.uniform(0.5, 1.5, shape)), design.exposure.looks
    vector = Vector(counts, photons, design.masks, chances=np.empty(0))
    if looks > 1:
        look = int(rng.integers(1, looks + 1))
        dwell = rng.dirichlet(np.ones(design.exposure.dwells.count)) * look / looks
        vector = replace(vector, dwell=dwell, look=look if look < looks else None)
    else:
        first = int(rng.integers(design.fewest_masks, design.masks + 1))
        vector = replace(vector, masks=first)
    chances, next_dwell = answer(design, vector)
    return replace(vector, chances=chances, next_dwell=next_dwell)


if __name__ == "__main__":
    main()
