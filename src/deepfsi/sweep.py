"""Many trials as records on disk: planned, trained and tested here or elsewhere, and summarised.

A sweep that was stopped goes on where it was, a changed recipe reuses what it still shares, and
several processes may work on one folder.
"""

import math
import platform
import time
from collections import defaultdict
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import torch

from deepfsi import coding
from deepfsi.artifact import Design
from deepfsi.datasets import Dataset
from deepfsi.descent import footprint
from deepfsi.errors import InputError
from deepfsi.evaluation import COVERS, evaluate
from deepfsi.recipes import Recipe, Resources, Trial, plan
from deepfsi.records import Records
from deepfsi.scenes import Matrices, Scenes
from deepfsi.training import Diverged, train
from deepfsi.workers import cores, processes

SCHEMA = 1
TRAINED = ("noise", "light", "rails", "design", "photons")
AXES = (
    "trained_under",
    "light",
    "rails",
    "design",
    "trained_at",
    "variant",
    "noise",
    "photons",
    "levels",
    "masks",
)
"""Fields that tell the points of a summary apart."""

CROWD = 2048
"""Learned masks that a processor trains at once: with more its caches lose what batching gains."""

MEMORY = 0.7
"""Share of the free memory that is planned for."""

Report = Callable[[float, str], None]
"""Called with the share of the work that is done, 0 to 1, and what is being trained."""

Batch = list[Trial]
"""Trials that are trained together."""

Done = tuple[Trial, dict[str, Any] | None, bytes | None]
"""A trial, its record and its design file; both None where it diverged."""


class Bench:
    """What every batch of a sweep needs; sent once to each process that works on it."""

    def __init__(
        self, data: Dataset, held_out: int, device: str, matrix: np.ndarray | None = None
    ) -> None:
        self.data, self.held_out, self.device, self.matrix = data, held_out, device, matrix
        self.matrices: Matrices = {}

    @cached_property
    def parts(self) -> Dataset:
        """The data, its validation part as test part."""
        return self.data.hold_out(self.held_out) if self.held_out else self.data

    @cached_property
    def scenes(self) -> Scenes:
        """What is trained on."""
        return Scenes(self.parts, self.device, self.matrices)

    def __getstate__(self) -> dict[str, Any]:
        made_there = ("parts", "scenes")
        return {name: value for name, value in vars(self).items() if name not in made_there}


def run(
    trials: Sequence[Trial],
    data: Dataset,
    folder: Path,
    *,
    matrix: np.ndarray | None = None,
    device: str = "auto",
    workers: int | None = 1,
    ray: str | None = None,
    resources: Resources | None = None,
    report: Report | None = None,
) -> list[dict[str, Any]]:
    """Train and test whatever the folder does not hold yet.

    Parameters
    ----------
    trials : sequence of Trial
        From `plan`, for this data and matrix.
    data : Dataset
    folder : Path
        Made if need be. May be stopped at any moment and started again, and several processes may
        work on it: each trains what no other does.
    matrix : array, shape (m, N), optional
        Sensing matrix of "custom" designs.
    device : {"auto", "cpu", "cuda"}
    workers : int, optional
        Processes, each with its share of the cores; None for one a core, or one for a GPU. With
        more than one, a script of yours needs ``if __name__ == "__main__":``.
    ray : str, optional
        Address of a Ray cluster to work on instead, or "auto".
    resources : Resources, optional
        What each batch takes of the cluster.
    report : callable, optional

    Returns
    -------
    list of dict
        The records, in the order of `trials`.
    """
    tell = report or (lambda share, what: None)
    records = Records(folder)
    bench = Bench(data, trials[0].validation, device, matrix)
    failed: set[str] = set()
    before = 0
    while missing := [t for t in trials if t.key not in failed and records.read(t) is None]:
        if len(missing) == before:
            time.sleep(1)  # another process tests them
        before = len(missing)
        untrained = _without_training(missing, bench, records, tell)
        if not untrained:
            continue
        first_of_each = list({trial.design_key: trial for trial in untrained}.values())
        processors = workers or workers_for(bench.scenes.device)
        todo = batches(first_of_each, bench.scenes, memory(bench.scenes.device) / processors)
        count = min(processors, len(todo))
        if ray is not None or count > 1:
            for trial in first_of_each:
                bench.scenes.prepare(trial.job.drawn_from)
        lost = _work_off(todo, bench, records, tell, count, ray, resources or Resources())
        failed |= {t.key for t in trials for each in lost if t.design_key == each.design_key}
        tell(1.0, "done")
    if failed:
        names = sorted({_title([trial]) for trial in trials if trial.key in failed})
        raise InputError(
            f"training diverged and the others are done: {', '.join(names)}; lower lr and mask_lr"
        )
    found = [(trial, records.read(trial)) for trial in trials]
    # a record is found by what it depends on; its words are those of who asks
    return [{**record, "trial": trial.model_dump(mode="json")} for trial, record in found if record]


def batches(trials: Sequence[Trial], scenes: Scenes, limit: float) -> list[Batch]:
    """Trials to be trained together, the longest work first.

    On a GPU all that agree in `Job.companions`; on a processor those of one seed, which share their
    scenes and noise, up to `CROWD`. A batch that would take more than `limit` bytes is split.
    """

    def full(batch: Batch, trial: Trial) -> bool:
        masks = (len(batch) + 1) * trial.job.masks
        crowded = trial.job.code.learned and scenes.device.type == "cpu" and masks > CROWD
        return crowded or footprint(scenes, [each.job for each in [*batch, trial]]) > limit

    groups: dict[Any, Batch] = defaultdict(list)
    for trial in sorted(trials, key=lambda trial: (trial.job.seed, trial.job.photons)):
        seed = None if scenes.device.type == "cuda" else trial.job.seed
        groups[(trial.job.companions(scenes.device), seed)].append(trial)
    found: list[Batch] = []
    for group in groups.values():
        batch: Batch = []
        for trial in group:
            if batch and full(batch, trial):
                found.append(batch)
                batch = []
            batch.append(trial)
        found.append(batch)
    return sorted(found, key=effort, reverse=True)


def workers_for(device: torch.device) -> int:
    """How many processes are fastest on a device: on a processor one for each core."""
    return 1 if device.type == "cuda" else cores()


def memory(device: torch.device) -> float:
    """Bytes that may be planned for on a device."""
    if device.type == "cuda":
        return MEMORY * torch.cuda.mem_get_info(device)[0]
    return MEMORY * psutil.virtual_memory().available


def effort(batch: Sequence[Trial]) -> float:
    """Relative cost of training a batch: a constant a step, products and noise."""
    job = batch[0].job
    cost = 20.0 + len(batch) * (20 + job.masks) * (3 if job.code.learned else 1)
    return job.training.epochs * cost * (2 if job.design == "control" else 1)


def _work_off(
    todo: list[Batch],
    bench: Bench,
    records: Records,
    tell: Report,
    workers: int,
    ray: str | None,
    resources: Resources,
) -> list[Trial]:
    """Train and record batches; return the trials that diverged."""
    lost: list[Trial] = []
    total, done = sum(map(effort, todo)), 0.0

    def finished_of(claimed: Iterator[Batch]) -> Generator[list[Done], None, None]:
        if ray is not None:
            from deepfsi.cluster import spread

            cpus, gpus = resources.cpus, resources.gpus
            with closing(spread(work, bench, claimed, address=ray, cpus=cpus, gpus=gpus)) as tasks:
                for _, result in tasks:
                    yield result
        elif workers > 1:
            with closing(processes(work, bench, claimed, workers)) as results:
                yield from results
        else:
            for batch in claimed:
                yield work(bench, batch, inside(batch))

    def inside(batch: Batch) -> Callable[[float], None]:
        return lambda share: tell((done + share * effort(batch)) / total, _title(batch))

    try:
        while todo:
            postponed: list[Batch] = []
            tell(done / total, f"{len(todo)} batches")
            with closing(finished_of(_claimed(todo, records, postponed))) as arriving:
                for finished in arriving:
                    for trial, record, design in finished:
                        if record is None:
                            lost.append(trial)
                            records.release([trial])
                        else:
                            records.write(trial, record, design)
                    batch = [trial for trial, _, _ in finished]
                    done += effort(batch)
                    tell(min(done / total, 1.0), _title(batch))
            todo = postponed
            if todo:
                time.sleep(1)  # another process has them
    finally:
        records.release_all()
    return lost


def _claimed(todo: Sequence[Batch], records: Records, postponed: list[Batch]) -> Iterator[Batch]:
    """Yield what is left to train of batches that no other process works on."""
    for batch in todo:
        left = [trial for trial in batch if records.design(trial) is None]
        if not left:
            continue
        if not records.claim(left):
            postponed.append(left)
            continue
        finished = [trial for trial in left if records.design(trial) is not None]
        records.release(finished)
        if len(finished) < len(left):
            yield [trial for trial in left if trial not in finished]


def work(bench: Bench, batch: Batch, report: Callable[[float], None] | None = None) -> list[Done]:
    """Train and test one batch.

    In parts where this machine would batch otherwise than the one that planned, in halves where a
    GPU's memory does not hold it whole, and one by one where a trial diverges; that one's record
    is None.
    """
    parts = batches(batch, bench.scenes, math.inf)
    if len(parts) > 1:
        return [done for part in parts for done in work(bench, part)]
    own = bench.matrix if batch[0].job.design == "custom" else None
    try:
        designs = train(bench.scenes, [trial.job for trial in batch], own, report)
    except Diverged:
        if len(batch) == 1:
            return [(batch[0], None, None)]
        return [done for trial in batch for done in work(bench, [trial])]
    except torch.OutOfMemoryError:
        if len(batch) == 1:
            raise InputError(
                f"{_title(batch)} do not fit the memory of this GPU: use --device cpu"
            ) from None
        middle = len(batch) // 2
        return work(bench, batch[:middle]) + work(bench, batch[middle:])
    pairs = zip(batch, designs, strict=True)
    return [(trial, _record(bench, trial, design), design.to_bytes()) for trial, design in pairs]


def _without_training(
    trials: Sequence[Trial], bench: Bench, records: Records, tell: Report
) -> list[Trial]:
    """Test the designs that are there already, from other tests; return the other trials."""
    left = []
    for trial in trials:
        design = records.design(trial)
        if design is None or not records.claim([trial]):
            left.append(trial)
            continue
        tell(0.0, f"testing {trial.job.design} again")
        record = _record(bench, trial, design.to(bench.scenes.device))
        records.write(trial, record, None)
    return left


def _record(bench: Bench, trial: Trial, design: Design) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "key": trial.key,
        "design": trial.design_key,
        "trial": trial.model_dump(mode="json"),
        "validation": _tested(trial, design, bench.parts) if bench.held_out else [],
        "test": _tested(trial, design, bench.data),
        "info": design.info,
    }


def _tested(trial: Trial, design: Design, data: Dataset) -> list[dict[str, Any]]:
    return [
        {**result.as_dict(), "levels": levels}
        for levels in trial.test_levels
        for noise in trial.test_noise
        for result in evaluate(
            design.quantised(levels) if levels else design,
            data,
            trial.test_photons,
            noise=noise,
            sigma=trial.job.sigma,
            draws=trial.draws,
            seed=trial.job.seed,
        )
    ]


def _title(batch: Sequence[Trial]) -> str:
    job = batch[0].job
    return f"{job.design}, {job.masks} masks" + f" × {len(batch)}" * (len(batch) > 1)


def summarise(
    recipe: Recipe,
    data: Dataset,
    records: Sequence[Mapping[str, Any]],
    *,
    command: str,
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
    held_out = recipe.held_out(data)
    groups = defaultdict(list)
    for record in records:
        for index, test in enumerate(record["test"]):
            job = record["trial"]["job"]
            trained = (*(job[axis] for axis in TRAINED), record["trial"]["variant"])
            key = (*trained, test["noise"], test["photons"], test["levels"], job["masks"])
            groups[key].append((record, index))
    points = [
        point(dict(zip(AXES, key, strict=True)), members, data.pixels)
        for key, members in groups.items()
    ]
    chosen = defaultdict(list)
    for each in points:
        chosen[tuple(each[axis] for axis in AXES if axis != "masks")].append(each)
    for rivals in chosen.values():
        for each in rivals:
            each["best"] = not held_out or each is max(rivals, key=lambda p: p["validation"])
    return {
        "schema": SCHEMA,
        "title": f"{data.name} under {' and '.join(recipe.noise)} noise",
        "command": command,
        "recipe": recipe.model_dump(mode="json"),
        **origin(data, held_out, records, seconds),
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
    workers: int | None = 1,
    ray: str | None = None,
    report: Report | None = None,
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Plan, run and summarise a recipe; returns the summary and the records."""
    began = time.perf_counter()
    trials = plan(recipe, data, matrix)
    records = run(
        trials,
        data,
        folder,
        matrix=matrix,
        device=device,
        workers=workers,
        ray=ray,
        resources=recipe.resources,
        report=report,
    )
    results = summarise(
        recipe,
        data,
        records,
        command=command,
        seconds=time.perf_counter() - began,
    )
    return results, records


def origin(
    data: Dataset,
    held_out: int,
    records: Sequence[Mapping[str, Any]],
    seconds: float,
) -> dict[str, Any]:
    """What a `results.json` says of its data, and of what made it."""
    train = len(data.x_train) - held_out
    return {
        "data": {
            "name": data.name,
            "hash": data.hash,
            "image_shape": list(data.image_shape),
            "classes": list(data.classes),
            "train": train,
            "validation": held_out,
            "test": len(data.x_test),
            "preprocessing": data.preprocessing,
            "mean_reflectance": float(data.x_train[:train].mean(dtype=np.float64)),
        },
        "provenance": {
            **{name: version(name) for name in ("deepfsi", "torch", "numpy")},
            "python": platform.python_version(),
            "device": ", ".join(sorted({record["info"]["device"] for record in records})),
            "finished": datetime.now(UTC).isoformat(timespec="seconds"),
            "seconds": round(seconds, 1),
            "training_seconds": round(sum(record["info"]["seconds"] for record in records), 1),
        },
    }


def point(
    axes: Mapping[str, Any], members: Sequence[tuple[Mapping[str, Any], int]], pixels: int
) -> dict[str, Any]:
    """One point of a summary: trials averaged.

    Parameters
    ----------
    axes : mapping
        What tells the point apart; `design` and `masks` at least.
    members : sequence of tuple
        Records, each with the place of the test in it that belongs here.
    pixels : int
        N, of one mask.
    """
    from scipy import stats

    tests = [record["test"][index] for record, index in members]
    accuracy = np.array([test["accuracy"] for test in tests])
    if len(tests) > 1:
        half = stats.t.ppf(0.975, len(tests) - 1) * stats.sem(accuracy)
        low, high = float(accuracy.mean() - half), float(accuracy.mean() + half)
        covers = f"training seeds (Student's t over {len(tests)} trials)"
    else:
        low, high, covers = tests[0]["low"], tests[0]["high"], COVERS
    validated = [record["validation"][index] for record, index in members if record["validation"]]
    code = coding.DESIGNS[axes["design"]]
    return {
        **axes,
        "label": code.label,
        "title": code.title,
        "specific": code.specific,
        "learned": code.learned,
        "ratio": axes["masks"] / pixels,
        "trials": len(tests),
        "validation": float(np.mean([v["accuracy"] for v in validated])) if validated else None,
        "accuracy": float(accuracy.mean()),
        "low": max(low, 0.0),
        "high": min(high, 1.0),
        "covers": covers,
        "throughput": float(np.mean([test["throughput"] for test in tests])),
        "seconds": float(np.mean([record["info"]["seconds"] for record, _ in members])),
        "accuracies": [float(value) for value in accuracy],
        "keys": [record["design"] for record, _ in members],
    }
