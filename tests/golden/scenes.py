"""Small data sets of the cases, and what a design is and answers, as facts."""

import json
import struct
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

import deepfsi

BUDGET = 1e4
"""Photons of a training."""

STEPS = {"epochs": 2, "hidden": (8,), "batch": 30}
"""A training of a moment."""


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


def file_facts(path: Path | str) -> dict[str, Any]:
    """Header and tensors of a design file, but for what depends on the clock and on versions."""
    content = Path(path).read_bytes()
    (length,) = struct.unpack("<Q", content[:8])
    header = json.loads(content[8 : 8 + length])
    words = header.pop("__metadata__", {})
    [name] = words
    described = json.loads(words[name])
    described.pop("deepfsi", None)
    for field in ("deepfsi", "torch", "seconds"):
        described.get("info", {}).pop(field, None)
    described.get("info", {}).get("left_out", {}).pop("guesses", None)  # follows its accuracy
    tensors, layout = {}, {}
    for tensor, entry in header.items():
        start, stop = entry["data_offsets"]
        tensors[tensor] = np.frombuffer(
            content[8 + length + start : 8 + length + stop], TYPES[entry["dtype"]]
        )
        layout[tensor] = [entry["dtype"], entry["shape"], start, stop]
    order = [name, *described]
    return {"header": described, "order": order, "layout": layout, "tensors": tensors}


TYPES = {
    "F16": "<f2",
    "F32": "<f4",
    "F64": "<f8",
    "I8": "i1",
    "I32": "<i4",
    "I64": "<i8",
    "U8": "u1",
    "BOOL": "?",
}
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
        return {"looks": list(design.looks_at(data.x_test[0], BUDGET, seed=2))}
    rng = np.random.default_rng(5)
    patches = prod(data.image_shape) // prod(design.mask_shape)
    several = (patches,) if design.info["job"]["exposure"].get("patch") else ()
    counts = rng.integers(0, 1 + (design.gates or 60), (6, *several, *design.counts_shape))

    def read(dwell: np.ndarray) -> np.ndarray:
        return rng.poisson(40 * np.ones(design.counts_shape) * dwell.mean())

    tests = design.consistency
    calls = {
        "classify": lambda: design.classify(counts, BUDGET),
        "estimate": lambda: design.estimate(counts, BUDGET),
        "live": lambda: design.classify_live(read, BUDGET),
        "consistency": lambda: plain(tests(counts, BUDGET)),
        "first": lambda: design.first(2).matrix,
        "quantised": lambda: design.quantised(5).matrix,
    }
    return {name: refused_or(call) for name, call in calls.items()}


def plain(value: Any) -> Any:
    """Fields of a result, as far as they are numbers, words or arrays."""
    if hasattr(value, "detach"):
        return value.detach().cpu().numpy()
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, dict):
        return {name: plain(one) for name, one in value.items()}
    return [plain(one) for one in value] if isinstance(value, (list, tuple)) else value


def facts_of(design: Any, data: deepfsi.Dataset, **test: Any) -> dict[str, Any]:
    """Whatever a design is, and answers; `test` are fields of the camera of its test."""
    path = design.save("design.safetensors")
    again = deepfsi.load_design(path)
    same = again.to_bytes() == Path(path).read_bytes()
    return {
        "file": file_facts(path),
        "written again alike": same,
        "test": tested(design, data, BUDGET / 3, BUDGET, **test),
        "answers": answered(design, data),
        "matrix": None if design.name == "adaptive" else design.matrix,
        "camera": design.camera.model_dump(mode="json"),
        "words": None if design.name == "adaptive" else repr(design),
    }


def refused_or(make: Any) -> Any:
    """Facts of what is made, or that it is refused in one line."""
    try:
        return make()
    except deepfsi.InputError as error:
        lines = str(error).splitlines()
        assert len(lines) == 1, lines
        return {"refused": True}
