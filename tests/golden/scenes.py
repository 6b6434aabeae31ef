"""Small data sets of the cases, and what a design is and answers, as facts."""

import json
import struct
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

import deepfsi
from golden.facts import refused_or
from shared.design_files import looks_at

BUDGET = 1e4
"""Photons of a training."""

STEPS = {"epochs": 2, "hidden": (8,), "batch": 30}
"""A training of a moment."""

PATCHES: dict[str, Any] = {
    "exposure": {"patch": 4},
    "training": {
        "epochs": 1,
        "batch": 45,
        "classifier_arguments": {"width": 8, "depth": 1, "heads": 2, "hidden": 8},
    },
}
ADAPTIVE: dict[str, Any] = {"design": "adaptive", "masks": 3, "training": {"clusters": 2}}


def digits(scenes: int = 120, *, classes: int = 10) -> deepfsi.Dataset:
    """Digits of 8x8 pixels, a quarter of them for the test, in an order that is always the same."""
    whole = deepfsi.load_dataset("digits")
    chosen = np.flatnonzero(whole.y_train < classes)[:scenes]
    x, y = whole.x_train[chosen].reshape(-1, 8, 8), whole.y_train[chosen]
    cut = 3 * scenes // 4
    return deepfsi.from_arrays(x[:cut], y[:cut], x[cut:], y[cut:], name="some")


def spots() -> deepfsi.Dataset:
    """Spots on 8x8 pixels, whose row and column are values to be estimated."""
    rng = np.random.default_rng(4)
    y = rng.uniform(1, 6, (120, 2))
    grid = np.arange(8.0)
    row, column = (np.exp(-((grid - y[:, k : k + 1]) ** 2)) for k in (0, 1))
    x = row[:, :, None] * column[:, None, :]
    names = ["row", "column"]
    return deepfsi.from_arrays(x[:90], y[:90], x[90:], y[90:], values=names, name="spots")


def opened(content: bytes) -> tuple[str, dict[str, Any], dict[str, Any], bytes]:
    """Name of the description of a design file, what it says, layout of tensors, their bytes."""
    (length,) = struct.unpack("<Q", content[:8])
    layout = json.loads(content[8 : 8 + length])
    [(name, words)] = layout.pop("__metadata__").items()
    return name, json.loads(words), layout, content[8 + length :]


def file_facts(path: Path | str) -> dict[str, Any]:
    """Header and tensors of a design file, but for what depends on the clock and on versions."""
    name, described, layout, content = opened(Path(path).read_bytes())
    described.pop("deepfsi", None)
    for field in ("deepfsi", "torch", "seconds"):
        described.get("info", {}).pop(field, None)
    described.get("info", {}).get("left_out", {}).pop("guesses", None)  # follows its accuracy
    places = {
        tensor: [entry["dtype"], entry["shape"], *entry["data_offsets"]]
        for tensor, entry in layout.items()
    }
    tensors = {
        tensor: np.frombuffer(content[start:stop], TYPES[kind])
        for tensor, (kind, _, start, stop) in places.items()
    }
    order = [name, *described]
    return {"header": described, "order": order, "layout": places, "tensors": tensors}


TYPES = {"F16": "<f2", "F32": "<f4", "F64": "<f8", "I8": "i1", "I32": "<i4", "I64": "<i8"}
TYPES |= {"U8": "u1", "BOOL": "?"}
"""NumPy's names of the types of tensors."""


def tested(design: Any, data: deepfsi.Dataset, *photons: float, **camera: Any) -> list[Any]:
    """Numbers of a test at some budgets."""
    out = []
    for one in deepfsi.evaluate(design, data, photons or (BUDGET,), draws=2, seed=3, **camera):
        numbers = one.as_dict()
        assert numbers.get("throughput", 0) <= 1 + 1e-5  # no more light than there is
        if "confusion" in numbers:  # counts of answers that follow the last bits of a network
            numbers["confusion"] = np.array(numbers["confusion"], float)
        out.append({**numbers, "right": getattr(one, "right", None)})
    return out


def answered(design: Any, data: deepfsi.Dataset) -> dict[str, Any]:
    """Chances and values of counts that no scene gave, and what of this is refused."""
    if design.name == "adaptive":
        return {"looks": list(looks_at(design, data.x_test[0], BUDGET, seed=2))}
    rng = np.random.default_rng(5)
    side = design.info["job"]["exposure"].get("patch")
    several = (prod(data.image_shape) // side**2,) if side else ()
    counts = rng.integers(0, 1 + (design.camera.clicks or 60), (6, *several, *design.counts_shape))
    calls = {
        "classify": lambda: design.classify(counts, BUDGET),
        "estimate": lambda: design.estimate(counts, BUDGET),
        "quantised": lambda: design.quantised(5).matrix,
    }
    return {name: refused_or(call) for name, call in calls.items()}


def about(design: Any) -> dict[str, Any]:
    """What a design says of itself."""
    words = None if design.name == "adaptive" else repr(design)
    return {"words": words, "camera": design.camera.model_dump(mode="json")}


def facts_of(design: Any, data: deepfsi.Dataset, **test: Any) -> dict[str, Any]:
    """Whatever a design is, and answers; `test` are fields of the camera of its test."""
    path = design.save("design.safetensors")
    again = deepfsi.load_design(path).save("again.safetensors")
    return {
        "file": file_facts(path),
        "written again alike": again.read_bytes() == path.read_bytes(),
        "test": tested(design, data, BUDGET / 3, BUDGET, **test),
        "answers": answered(design, data),
        "matrix": None if design.name == "adaptive" else design.matrix,
        **about(design),
    }
