"""Points and results of comparisons, whole, of which a test says only what matters to it."""

from collections.abc import Iterable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from deepfsi.designfile.design_file import DesignFile, MaskHeader
from deepfsi.jobs.exposures import FixedEntry
from deepfsi.sweeps.results import RESULTS_SCHEMA, Data, Point, Provenance, Results, write_results

DESIGNS = {
    "impulse": ("II", "impulse imaging", False, False, 0.97),
    "raster": ("RS", "raster scan", False, False, 0.31),
    "truncated-hadamard": ("TH", "truncated Hadamard", False, False, 0.52),
    "pca": ("FSI", "PCA (FSI)", True, False, 0.77),
    "deepfsi": ("DFSI", "DeepFSI", True, True, 0.86),
}


POINT = {
    "trained_under": "ml_gauss",
    "light": "column",
    "rails": "dual",
    "detectors": "1x1",
    "design": "deepfsi",
    "variant": "",
    "noise": "poisson",
    "photons": 1e4,
    "levels": 0,
    "masks": 92,
    "specific": True,
    "learned": False,
    "trials": 3,
    "worst_class": 1,
    "covers": "seeds of training (t over 3 trials)",
    "throughput": 0.45,
    "seconds": 1.0,
    "keys": ("key",),
    "best": True,
}
DATA = {
    "name": "digits",
    "hash": "abc123",
    "image_shape": (32, 32),
    "classes": tuple("0123456789"),
    "train": 1000,
    "validation": 200,
    "test": 360,
    "chance": 0.1,
    "preprocessing": "x / 16",
    "mean_reflectance": 0.42,
}
PROVENANCE = Provenance(
    deepfsi="0.2.0",
    torch="2.13.0",
    numpy="2.0.0",
    python="3.11.2",
    device="cpu",
    finished="2026-01-01T00:00:00+00:00",
    seconds=63.1,
    training_seconds=60.0,
)


def a_point(accuracy: float = 0.9, half: float = 0.01, **fields: Any) -> Point:
    """A point with these fields; its interval is `half` to both sides unless given."""
    given = POINT | fields
    scores = {"validation": accuracy, "accuracy": accuracy, "balanced": accuracy - 0.02}
    for name, prefix in (("accuracy", ""), ("balanced", "balanced_")):
        scores |= {f"{prefix}low": scores[name] - half, f"{prefix}high": scores[name] + half}
    follows = {
        "readout": "difference" if given["rails"] == "dual" else "",
        "trained_at": given["photons"],
        "label": given["design"],
        "title": given["design"],
        "ratio": given["masks"] / 1024,
        "worst": accuracy / 2,
        "counts": 0.45 * given["photons"],
        "accuracies": (accuracy,),
    }
    return Point(**{**follows, **scores, **given})


def of_three(accuracy: float, **fields: Any) -> Point:
    """A point of three trainings that differ by 0.001."""
    accuracies = tuple(accuracy + step for step in (-0.001, 0.0, 0.001))
    return a_point(accuracy, 0.002, **{"accuracies": accuracies, **fields})


def some_results(
    points: Iterable[Point], *, recipe: dict[str, Any] | None = None, data: Any = (), **fields: Any
) -> Results:
    """Results of ten classes with these points; `data` holds fields of it that are others."""
    given = {
        "title": "digits under photon noise",
        "command": "deepfsi compare --data digits -o out",
        "recipe": recipe or {},
        "data": Data(**DATA | dict(data or {})),
        "provenance": PROVENANCE,
        "chosen_on": "validation",
        "points": tuple(points),
    }
    return Results(revision=RESULTS_SCHEMA, **{**given, **fields})


def make_results(
    folder: Path,
    designs: Iterable[str] = tuple(DESIGNS),
    noises: Iterable[str] = ("poisson",),
    budgets: Iterable[float] = (1e2, 1e4),
    counts: tuple[int, ...] = (4, 16),
    lights: Iterable[str] = ("column",),
    shape: tuple[int, ...] = (4, 6),
    **changes: Any,
) -> Results:
    """Write results.json and design files as `deepfsi compare` does; returns the results."""
    pixels = int(np.prod(shape))
    rng = np.random.default_rng(0)
    points = []
    for noise, light, design, photons in product(noises, lights, designs, budgets):
        label, title, specific, learned, top = DESIGNS[design]
        fixed = design in ("impulse", "raster")
        for masks in [pixels] if fixed else counts:
            accuracy = top - 0.3 / np.log10(photons) - masks / 1000
            key = f"{noise}-{light}-{design}-{photons:g}-{masks}"
            rails = "single" if fixed else "dual"
            named = {"design": design, "label": label, "title": title, "keys": (key,)}
            optics = {"noise": noise, "light": light, "rails": rails, "photons": photons}
            chosen = {"validation": accuracy + 0.01, "best": fixed or masks == counts[0]}
            kind = {"specific": specific, "learned": learned, "masks": masks}
            fields = {**named, **optics, **chosen, **kind, "ratio": masks / pixels}
            points.append(a_point(accuracy, 0.004, **fields))
            if learned:
                matrix = rng.normal(size=(masks, pixels)) / masks
                write_design(folder / "designs" / f"{key}.safetensors", matrix, shape)
    results = some_results(
        points,
        recipe={"photons": list(budgets), "training": {"epochs": 20, "hidden": [40, 128]}},
        data={"image_shape": shape},
        chosen_on="validation" if len(counts) > 1 else "nothing",
    ).model_copy(update=changes)
    write_results(folder / "results.json", results)
    return results


def write_design(path: Path, matrix: np.ndarray, shape: tuple[int, ...]) -> None:
    """Write what a page reads of a design file: its header and its rails."""
    path.parent.mkdir(parents=True, exist_ok=True)
    header = MaskHeader(
        name="deepfsi", light="column", readout="difference", summed_reflectance=1.0,
        image_shape=shape, classes=("a", "b"), exposure=FixedEntry(), info={},
        classifier={"kind": "mlp", "hidden": (), "dropout": 0.0},
    )  # fmt: skip
    rails = np.stack([matrix.clip(min=0), -matrix.clip(max=0)]).astype(np.float32)
    path.write_bytes(DesignFile(header, {"rails": rails}).to_bytes())


def with_all(results: Results, **fields: Any) -> Results:
    """The same results, all of whose points have these fields."""
    return results.with_points(point.model_copy(update=fields) for point in results.points)
