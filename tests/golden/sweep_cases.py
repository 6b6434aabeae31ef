"""Comparisons with their records, results and pages, and the keys of every recipe's trials."""

import json
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

import deepfsi
from golden.facts import Cases, answer, cleaned, refused_or, timeless
from golden.scenes import digits, file_facts

CASES = Cases()
TRAINING = ("--epochs", 1, "--hidden", 8, "--batch", 40, "--workers", 1)

COMPARED = {
    "designs": "--designs impulse,raster,pca,random,deepfsi --photons 1e4 --masks 4",
    "folds": "--designs pca --photons 1e4 --masks 3,5",
    "wrong": "--designs pca,nosuch --photons 1e4 --masks 4",
}
"""Options of comparisons."""


def _compare(words: str) -> Any:
    """What a comparison on few digits says."""
    data = digits(160, classes=3)
    images = {"x": data.x_train.reshape(-1, 8, 8), "x_test": data.x_test.reshape(-1, 8, 8)}
    np.savez("some.npz", y=data.y_train, y_test=data.y_test, **images)
    line = ("compare", "--data", "some.npz", "-o", "out", *words.split())
    said = _without_left(timeless(answer(*line, *TRAINING)))
    said.pop("verdict", None)  # in words, of tests/report/test_verdict.py
    return said


@CASES.of(COMPARED)
def compared(name: str) -> dict[str, Any]:
    """A comparison, the files of its folder, its records and designs."""
    out = {"said": _compare(COMPARED[name])}
    paths = {path.relative_to("out").as_posix(): path for path in sorted(Path("out").rglob("*"))}
    # without the histograms of mask values and the pictures of masks, which left
    kept = (path for path in paths if not path.startswith(("figures/values-", "figures/masks-")))
    paths = {name: paths[name] for name in kept if paths[name].is_file()}
    designs = {name: path for name, path in paths.items() if path.suffix == ".safetensors"}
    return {
        **out,
        "files": list(paths),
        "results": _read("out/results.json") if paths else None,
        "records": {path.name: _read(path) for path in sorted(Path("out").glob("trials/*.json"))},
        "designs": {name: timeless(cleaned(file_facts(path))) for name, path in designs.items()},
    }


def _read(path: Path | str) -> Any:
    return _without_left(timeless(cleaned(json.loads(Path(path).read_text()))))


def _without_left(content: Any) -> Any:
    """Without fields of recipes that left."""
    for name in ("normal", "skip_bad", "tuned"):
        content.get("recipe", {}).pop(name, None)
    return content


@CASES
def resumed() -> dict[str, Any]:
    """A comparison of two budgets and two seeds, run again as it is, and with one record lost."""
    words = "--designs deepfsi --photons 1e3,1e5 --masks 4 --trials 2"

    def records() -> dict[str, str]:
        return {path.name: path.read_text() for path in Path("out/trials").glob("*.json")}

    said, before, results = _compare(words), records(), _read("out/results.json")
    out = {"said": said, "again": _compare(words) == said and records() == before}
    lost = min(Path("out/trials").glob("*.json"))
    lost.unlink()
    _compare(words)
    return {
        **out,
        "resumed": records().keys() == before.keys(),
        "resumed record": _read(lost),
        "same results": _read("out/results.json") == results,
    }


RECIPES = {
    Path(path.name).stem: path
    for folder in (files("deepfsi") / "sweeps" / "recipes", files("deepfsi_paper") / "recipes")
    for path in sorted(folder.iterdir(), key=str)
}
"""Recipes that come with the package."""


@CASES.of(RECIPES)
def keys_of(name: str) -> dict[str, Any]:
    """Keys of two trials of each part of a recipe, on scenes that no file holds."""
    from deepfsi.sweeps.plan import plan_trials
    from deepfsi.sweeps.recipe import Recipe, only

    images = np.random.default_rng(0).integers(0, 256, (200, 32, 32), np.uint8)
    spectra = np.random.default_rng(1).random((320, 200))
    every = {
        "images": deepfsi.from_arrays(images, np.arange(200) % 10, name="images"),
        "spectra": deepfsi.from_arrays(spectra, np.arange(320) % 16, name="spectra"),
    }
    content = tomllib.loads(RECIPES[name].read_text())

    def trials(part: str | None, quick: bool, data: deepfsi.Dataset) -> list[str]:
        settings = only(content, part, quick)
        few = min(settings.get("trials", 2), 2)  # others differ by their seed alone
        recipe = Recipe(**{**settings, "validation": 0, "trials": few})
        return sorted(f"{one.key} {one.design_key}" for one in plan_trials(recipe, data))

    return {
        f"{part} {quick} {scenes}": refused_or(lambda p=part, q=quick, d=data: trials(p, q, d))
        for part in content.get("parts", {None: None})
        for quick in (False, True)
        for scenes, data in every.items()
    }
