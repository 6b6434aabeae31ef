"""Many trainings as records on disk: recipes name axes, a trial is a point, a record its result.

An output folder holds

    trials/KEY.json           one record: settings, validation and test results
    designs/KEY.safetensors   the design itself
    results.json              the records summarised, for `report`

KEY is a hash of everything that the result depends on, the data included, so a record is valid for
whoever finds it: a sweep that was stopped goes on where it was, and a changed recipe reuses what it
still shares. Files are written whole or not at all, the record after its design.
"""

import hashlib
import json
import platform
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from deepfsi import coding
from deepfsi.artifact import write_atomically
from deepfsi.constraints import Light, Rails
from deepfsi.datasets import Dataset
from deepfsi.errors import InputError
from deepfsi.evaluation import COVERS, evaluate
from deepfsi.jobs import REVISION, Job, Training, check_job, training_for
from deepfsi.noise import Noise
from deepfsi.photons import BUDGETS
from deepfsi.scenes import Scenes
from deepfsi.training import train

SCHEMA = 1

Physical = Literal["poisson", "gaussian", "none"]
TRAINING_NOISE: dict[Physical, Literal["ml_gauss", "gaussian", "none"]] = {
    "poisson": "ml_gauss",
    "gaussian": "gaussian",
    "none": "none",
}


def _axis(value: Any) -> Any:
    return tuple(dict.fromkeys(value)) if isinstance(value, (list, tuple)) else (value,)


Budget = Annotated[float, Field(ge=BUDGETS[0], le=BUDGETS[1])]
Ratio = Annotated[float, Field(gt=0, le=1)]
Count = Annotated[int, Field(ge=1)]


class Recipe(BaseModel):
    """What to compare. Each tuple is an axis; a single value stands for an axis of one."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    data: str = Field("digits", description="name, folder of images or .npz file")
    size: tuple[int, int] | None = Field(None, description="height, width of folder images")
    designs: Annotated[tuple[str, ...], BeforeValidator(_axis), Field(min_length=1)] = (
        "impulse",
        "raster",
        "hadamard",
        "truncated-hadamard",
        "pca",
        "deepfsi",
        "control",
    )
    photons: Annotated[tuple[Budget, ...], BeforeValidator(_axis), Field(min_length=1)] = (
        1e2,
        1e3,
        1e4,
        1e5,
    )
    ratios: Annotated[tuple[Ratio, ...], BeforeValidator(_axis)] = ()
    masks: Annotated[tuple[Count, ...], BeforeValidator(_axis)] = Field(
        (), description="mask counts, instead of ratios"
    )
    noise: Annotated[tuple[Physical, ...], BeforeValidator(_axis), Field(min_length=1)] = (
        "poisson",
    )
    sigma: float = Field(1.0, gt=0, allow_inf_nan=False)
    light: Annotated[tuple[Light, ...], BeforeValidator(_axis), Field(min_length=1)] = ("column",)
    rails: Annotated[tuple[Rails, ...], BeforeValidator(_axis), Field(min_length=1)] = ("dual",)
    trials: int = Field(1, ge=1, le=1000, description="seeds 0, 1, …")
    validation: int | None = Field(
        None, ge=0, description="training scenes held out to choose on; a sixth unless given"
    )
    draws: int = Field(3, ge=1, description="noise draws of each test scene")
    test_photons: Annotated[tuple[Budget, ...], BeforeValidator(_axis)] = Field(
        (), description="budgets of the tests; that of the training unless given"
    )
    test_noise: Annotated[tuple[Noise, ...], BeforeValidator(_axis)] = Field(
        (), description="noises of the tests; that of the training unless given"
    )
    training: dict[str, Any] = Field({}, description="fields of Training, for every design")
    tuned: dict[str, dict[str, Any]] = Field({}, description="the same for single designs")

    @model_validator(mode="after")
    def _consistent(self) -> "Recipe":
        if self.ratios and self.masks:
            raise ValueError("give ratios or masks, not both")
        for name in (*self.designs, *self.tuned):
            coding.check_design(name)
        for name in self.designs:
            self.training_of(name)
        return self

    def training_of(self, design: str) -> Training:
        """Training settings of one design."""
        return training_for(design, **{**self.training, **self.tuned.get(design, {})})

    def mask_counts(self, design: str, data: Dataset) -> list[int]:
        """Mask counts of one design: those asked for that it can have, else the most it can have.

        Without ratios and masks, the ratios 1, 4, 9, … 100 % of the paper.
        """
        low, high = coding.count_allowed(design, data)
        ratios = self.ratios or tuple((k / 10) ** 2 for k in range(1, 11))
        asked = self.masks or [coding.mask_count(ratio, data.pixels) for ratio in ratios]
        return sorted({count for count in asked if low <= count <= high}) or [high]


class Trial(BaseModel):
    """One training and its tests, with all that the result depends on."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    job: Job
    data: str = Field(description="name")
    data_hash: str
    matrix_hash: str = ""
    validation: int
    draws: int
    test_photons: tuple[float, ...]
    test_noise: tuple[Noise, ...]

    @property
    def key(self) -> str:
        """Content hash that names the record."""
        settings = {
            "schema": SCHEMA,
            "revision": REVISION,
            **self.model_dump(mode="json", exclude={"data"}),
        }
        return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:24]


def plan(recipe: Recipe, data: Dataset, matrix: np.ndarray | None = None) -> list[Trial]:
    """All trials of a recipe, each once.

    Left out is what cannot be: the control group, masks of gaussian noise under photon noise, where
    there is none; designs of one rail on two arms; the signed Hadamard basis on a single rail.

    Raises
    ------
    InputError
        If a trial asks for what its data or constraint does not allow.
    """
    for count in recipe.masks:
        if count > data.pixels:
            raise InputError(
                f"{count} masks are not allowed on {data.name}: give 1 to {data.pixels}"
            )
    trials = {}
    for design in recipe.designs:
        single = coding.DESIGNS[design].single_rail and design != "impulse"
        counts = [len(matrix)] if design == "custom" and matrix is not None else None
        for noise in recipe.noise:
            if design == "control" and noise != "poisson":
                continue
            for light in recipe.light:
                for rails in recipe.rails:
                    if (light == "two-arm" and (single or rails == "single")) or (
                        rails == "single" and design == "hadamard"
                    ):
                        continue
                    for masks in counts or recipe.mask_counts(design, data):
                        for seed in range(recipe.trials):
                            for photons in recipe.photons:
                                job = Job(
                                    design=design,
                                    masks=masks,
                                    photons=photons,
                                    noise=TRAINING_NOISE[noise],
                                    sigma=recipe.sigma,
                                    light=light,
                                    rails=rails,
                                    seed=seed,
                                    training=recipe.training_of(design),
                                )
                                optics = dict(zip(("light", "rails"), job.optics, strict=True))
                                job = job.model_copy(update=optics)
                                own = matrix if design == "custom" else None
                                check_job(job, data, own)
                                trial = Trial(
                                    job=job,
                                    data=data.name,
                                    data_hash=data.hash,
                                    matrix_hash=_hash(own),
                                    validation=_held_out(recipe, data),
                                    draws=recipe.draws,
                                    test_photons=recipe.test_photons or (photons,),
                                    test_noise=recipe.test_noise or (noise,),
                                )
                                trials[trial.key] = trial
    if not trials:
        raise InputError(
            f"nothing to compare: {', '.join(recipe.designs)} cannot be had under "
            f"{', '.join(recipe.noise)} noise with {', '.join(recipe.light)} light and "
            f"{', '.join(recipe.rails)} rails (control is for photon noise, two-arm for dual rails)"
        )
    return list(trials.values())


Report = Callable[[float, str], None]
"""Called with the share of the work that is done, 0 to 1, and what is being trained."""


def run(
    trials: Sequence[Trial],
    data: Dataset,
    folder: Path,
    *,
    matrix: np.ndarray | None = None,
    device: str = "auto",
    report: Report | None = None,
) -> list[dict[str, Any]]:
    """Train and test whatever the folder does not hold yet.

    Parameters
    ----------
    trials : sequence of Trial
        From `plan`, for this data and matrix.
    data : Dataset
    folder : Path
        Made if need be. May be stopped at any moment and started again.
    matrix : array, shape (m, N), optional
        Sensing matrix of "custom" designs.
    device : {"auto", "cpu", "cuda"}
    report : callable, optional

    Returns
    -------
    list of dict
        The records, in the order of `trials`.
    """
    tell = report or (lambda share, what: None)
    missing = [trial for trial in trials if _read(folder, trial) is None]
    if missing:
        held_out = missing[0].validation
        parts = data.hold_out(held_out) if held_out else data
        scenes = Scenes(parts, device)
        groups = list(_together(missing, scenes))
        effort = np.array([_effort(group) for group in groups])
        before = np.concatenate([[0.0], np.cumsum(effort)]) / effort.sum()
        for group, start, stop in zip(groups, before, before[1:], strict=False):
            what = f"{group[0].job.design}, {group[0].job.masks} masks"
            tell(start, what)
            designs = train(
                scenes,
                [trial.job for trial in group],
                matrix if group[0].job.design == "custom" else None,
                lambda share, a=start, b=stop, w=what: tell(a + 0.9 * share * (b - a), w),  # type: ignore[misc]
            )
            for trial, design in zip(group, designs, strict=True):
                design.save(_design_path(folder, trial.key))
                record = {
                    "schema": SCHEMA,
                    "key": trial.key,
                    "trial": trial.model_dump(mode="json"),
                    "validation": _tested(trial, design, parts) if held_out else [],
                    "test": _tested(trial, design, data),
                    "info": design.info,
                }
                text = json.dumps(record, indent=1)
                write_atomically(_record_path(folder, trial), text.encode())
        tell(1.0, "done")
    records = [_read(folder, trial) for trial in trials]
    return [record for record in records if record is not None]


def summarise(
    recipe: Recipe,
    data: Dataset,
    records: Sequence[Mapping[str, Any]],
    *,
    command: str,
    device: str,
    seconds: float,
) -> dict[str, Any]:
    """Points of a comparison: trials averaged, mask counts chosen on validation data.

    The interval of a point is Student's over its trials (training seeds); of a single trial, the
    one over its test images.

    Returns
    -------
    dict
        What `results.json` holds, JSON types only.
    """
    held_out = _held_out(recipe, data)
    groups = defaultdict(list)
    for record in records:
        for index, test in enumerate(record["test"]):
            job = record["trial"]["job"]
            trained = (job["noise"], job["light"], job["rails"], job["design"], job["photons"])
            key = (*trained, test["noise"], test["photons"], job["masks"])
            groups[key].append((record, index))
    points = [_point(key, members, data.pixels) for key, members in groups.items()]
    chosen = defaultdict(list)
    for point in points:
        axes = ("noise", "trained_under", "light", "rails", "design", "trained_at", "photons")
        chosen[tuple(point[axis] for axis in axes)].append(point)
    for rivals in chosen.values():
        for point in rivals:
            point["best"] = not held_out or point is max(rivals, key=lambda p: p["validation"])
    return {
        "schema": SCHEMA,
        "title": f"{data.name} under {' and '.join(recipe.noise)} noise",
        "command": command,
        "recipe": recipe.model_dump(mode="json"),
        "data": {
            "name": data.name,
            "hash": data.hash,
            "image_shape": list(data.image_shape),
            "classes": list(data.classes),
            "train": len(data.x_train) - held_out,
            "validation": held_out,
            "test": len(data.x_test),
            "preprocessing": data.preprocessing,
            "mean_reflectance": float(
                data.x_train[: len(data.x_train) - held_out].mean(dtype=np.float64)
            ),
        },
        "provenance": {
            **{name: version(name) for name in ("deepfsi", "torch", "numpy")},
            "python": platform.python_version(),
            "device": device,
            "finished": datetime.now(UTC).isoformat(timespec="seconds"),
            "seconds": round(seconds, 1),
            "training_seconds": round(sum(record["info"]["seconds"] for record in records), 1),
        },
        "chosen_on": "validation" if held_out else "nothing",
        "points": points,
    }


def compare(
    recipe: Recipe,
    data: Dataset,
    folder: Path,
    *,
    command: str,
    matrix: np.ndarray | None = None,
    device: str = "auto",
    report: Report | None = None,
) -> dict[str, Any]:
    """Plan, run and summarise a recipe; writes `results.json` and returns it."""
    began = time.perf_counter()
    trials = plan(recipe, data, matrix)
    records = run(trials, data, folder, matrix=matrix, device=device, report=report)
    results = summarise(
        recipe,
        data,
        records,
        command=command,
        device=", ".join(sorted({record["info"]["device"] for record in records})),
        seconds=time.perf_counter() - began,
    )
    write_atomically(folder / "results.json", json.dumps(results, indent=1).encode())
    return results


def _held_out(recipe: Recipe, data: Dataset) -> int:
    return len(data.x_train) // 6 if recipe.validation is None else recipe.validation


def _together(trials: Sequence[Trial], scenes: Scenes) -> Iterator[list[Trial]]:
    groups = defaultdict(list)
    for trial in trials:
        groups[trial.job.companions(scenes.device)].append(trial)
    yield from groups.values()


def _effort(group: Sequence[Trial]) -> float:
    """Relative cost of training a group: a constant a step, products and noise."""
    job = group[0].job
    cost = 20.0 + len(group) * (20 + job.masks) * (3 if job.code.learned else 1)
    return job.training.epochs * cost * (2 if job.design == "control" else 1)


def _tested(trial: Trial, design: Any, data: Dataset) -> list[dict[str, Any]]:
    return [
        result.as_dict()
        for noise in trial.test_noise
        for result in evaluate(
            design,
            data,
            trial.test_photons,
            noise=noise,
            sigma=trial.job.sigma,
            draws=trial.draws,
            seed=trial.job.seed,
        )
    ]


def _point(
    key: tuple[Any, ...], members: Sequence[tuple[Mapping[str, Any], int]], pixels: int
) -> dict[str, Any]:
    from scipy import stats

    trained_under, light, rails, design, trained_at, noise, photons, masks = key
    tests = [record["test"][index] for record, index in members]
    accuracy = np.array([test["accuracy"] for test in tests])
    if len(tests) > 1:
        half = stats.t.ppf(0.975, len(tests) - 1) * stats.sem(accuracy)
        low, high = float(accuracy.mean() - half), float(accuracy.mean() + half)
        covers = f"training seeds (Student's t over {len(tests)} trials)"
    else:
        low, high, covers = tests[0]["low"], tests[0]["high"], COVERS
    validated = [record["validation"][index] for record, index in members if record["validation"]]
    code = coding.DESIGNS[design]
    return {
        "design": design,
        "label": code.label,
        "title": code.title,
        "specific": code.specific,
        "learned": code.learned,
        "noise": noise,
        "light": light,
        "rails": rails,
        "trained_under": trained_under,
        "trained_at": trained_at,
        "photons": photons,
        "masks": masks,
        "ratio": masks / pixels,
        "trials": len(tests),
        "validation": float(np.mean([v["accuracy"] for v in validated])) if validated else None,
        "accuracy": float(accuracy.mean()),
        "low": max(low, 0.0),
        "high": min(high, 1.0),
        "covers": covers,
        "throughput": float(np.mean([test["throughput"] for test in tests])),
        "keys": [record["key"] for record, _ in members],
    }


def _hash(matrix: np.ndarray | None) -> str:
    if matrix is None:
        return ""
    return hashlib.sha256(np.ascontiguousarray(matrix, dtype=np.float32).tobytes()).hexdigest()


def _read(folder: Path, trial: Trial) -> dict[str, Any] | None:
    """Record of a trial, or None if it or its design is missing or damaged."""
    if not _design_path(folder, trial.key).is_file():
        return None
    try:
        record = json.loads(_record_path(folder, trial).read_bytes())
    except (FileNotFoundError, ValueError):
        return None
    return record if record.get("key") == trial.key else None


def _record_path(folder: Path, trial: Trial) -> Path:
    return folder / "trials" / f"{trial.key}.json"


def _design_path(folder: Path, key: str) -> Path:
    return folder / "designs" / f"{key}.safetensors"
