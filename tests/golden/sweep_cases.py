"""Comparisons with their records and results, and the keys of every recipe's trials.

A case is a function without parameters that works in the current folder, which is its own and
empty, and gives facts as `facts.parts` takes them.
"""

import json
import tomllib
from collections.abc import Callable
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

import deepfsi
from golden.facts import answer, say
from golden.scenes import digits, file_facts, refused_or

Case = Callable[[], dict[str, Any]]

CLOCK = ("seconds", "training_seconds", "finished", "deepfsi", "torch", "numpy", "python")
"""Fields that depend on the clock or on versions."""

ANSWERS = ("confusion", "terms", "worst_class", "best")
"""Fields that follow the last bits of a network: compared with the reference alone."""


def timeless(value: Any) -> Any:
    """JSON without what depends on the clock, and with folders left out of the names of files."""
    if isinstance(value, dict):
        return {
            key: json.dumps(one).encode() if key in ANSWERS else timeless(one)
            for key, one in value.items()
            if key not in CLOCK
        }
    if isinstance(value, str) and value.startswith("/"):
        return Path(value).name
    return [timeless(one) for one in value] if isinstance(value, list) else value


LINE = ("compare", "--data", "some.npz", "-o", "out", "--json")
TRAINING = ("--epochs", 1, "--hidden", 8, "--batch", 40, "--workers", 1)


def compared(*words: object) -> dict[str, Any]:
    """A comparison on few digits."""
    data = digits(160, classes=3)
    shape = (-1, 8, 8)
    parts = {"x": data.x_train, "y": data.y_train, "x_test": data.x_test, "y_test": data.y_test}
    parts |= {name: parts[name].reshape(shape) for name in ("x", "x_test")}
    np.savez("some.npz", **parts)
    first = say(*LINE, *words, *TRAINING)
    if first.code:
        return {"refused": first.refused()}
    out = {"said": timeless(first.json), **folder_facts("out")}
    return out


def resumed() -> dict[str, Any]:
    """A comparison of three budgets and two seeds, run again as it is, and with one record lost."""
    words = ("--designs", "deepfsi", "--photons", "1e3,1e4,1e5", "--masks", 4, "--trials", 2)
    out = compared(*words)
    line = (*LINE, *words, *TRAINING)
    before, results = _records("out"), timeless(json.loads(Path("out/results.json").read_text()))
    out["again"] = timeless(say(*line).json) == out["said"] and _records("out") == before
    lost = min(Path("out/trials").glob("*.json"))
    lost.unlink()
    say(*line)
    out["resumed"] = sorted(_records("out")) == sorted(before)
    out["resumed record"] = timeless(json.loads(lost.read_text()))
    out["same results"] = timeless(json.loads(Path("out/results.json").read_text())) == results
    return out


def _records(folder: str) -> dict[str, str]:
    return {path.name: path.read_text() for path in sorted(Path(folder, "trials").glob("*.json"))}


def folder_facts(folder: str) -> dict[str, Any]:
    """Names of the files of a comparison, its results, records and designs."""
    paths = [path for path in sorted(Path(folder).rglob("*")) if path.is_file()]
    return {
        "files": [path.relative_to(folder).as_posix() for path in paths],
        "results": timeless(json.loads(Path(folder, "results.json").read_text())),
        "records": {name: timeless(json.loads(text)) for name, text in _records(folder).items()},
        "designs": {
            path.relative_to(folder).as_posix(): timeless(file_facts(path))
            for path in paths
            if path.suffix == ".safetensors"
        },
    }


COMPARED: dict[str, tuple[object, ...]] = {
    "designs": ("--designs", "impulse,raster,pca,random,deepfsi", "--photons", "1e4", "--masks", 4),
    "looks": ("--designs", "deepfsi", "--photons", "1e4", "--masks", 4, "--looks", 2),
    "folds": ("--designs", "pca", "--photons", "1e4", "--masks", "3,5"),
    "wrong": ("--designs", "pca,nosuch", "--photons", "1e4", "--masks", 4),
}
"""Options of comparisons."""


def keys(name: str) -> dict[str, Any]:
    """Keys of the trials of each part of a recipe, on scenes that no file holds."""
    try:
        from deepfsi.sweeps import Recipe, only, plan_trials
    except ImportError:  # the package of the stored commit
        from deepfsi.sweeps.trial import plan as plan_trials

        from deepfsi.sweeps.recipe import Recipe, only
    content = tomllib.loads(RECIPES[name].read_text())
    out: dict[str, Any] = {}
    for part in content.get("parts", {None: None}):
        for quick in (False, True):
            for scenes, data in (("images", _images()), ("spectra", _spectra())):

                def trials(part=part, quick=quick, data=data):
                    recipe = Recipe(**{**only(content, part, quick), "validation": 0})
                    planned = plan_trials(recipe, data)
                    return sorted(f"{one.key} {one.design_key}" for one in planned)

                out[f"{part} {quick} {scenes}"] = refused_or(trials)
    return out


def _images() -> deepfsi.Dataset:
    rng = np.random.default_rng(0)
    return deepfsi.from_arrays(
        rng.integers(0, 256, (200, 32, 32), np.uint8), np.arange(200) % 10, name="images"
    )


def _spectra() -> deepfsi.Dataset:
    rng = np.random.default_rng(1)
    return deepfsi.from_arrays(rng.random((320, 200)), np.arange(320) % 16, name="spectra")


RECIPES = {
    Path(path.name).stem: path
    for folder in (files("deepfsi") / "sweeps" / "recipes", files("deepfsi_paper") / "recipes")
    for path in folder.iterdir()
}
"""Recipes that come with the package."""


def planned() -> dict[str, Any]:
    """A plan of photons for a target accuracy."""
    words = ("--data", "digits", "--designs", "pca", "--target", 0.5, "--masks", 4, "--epochs", 1)
    return {"said": timeless(answer("plan", *words, "--hidden", 8, "--workers", 1, "-o", "plan"))}


CASES: dict[str, Case] = {
    **{f"compared {name}": partial(compared, *words) for name, words in COMPARED.items()},
    **{f"keys of {name}": partial(keys, name) for name in sorted(RECIPES)},
    "resumed": resumed,
    "planned": planned,
}
HASHED = True
