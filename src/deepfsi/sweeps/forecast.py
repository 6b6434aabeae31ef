"""Expected cost of a sweep on this machine, from a few timed steps of each of its trainings."""

import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import torch

from deepfsi.base import SILENT, Moments, Progress
from deepfsi.camera import find_noise
from deepfsi.datasets import Dataset
from deepfsi.evaluation import evaluate
from deepfsi.exposure import TrainingSet, dtypes
from deepfsi.jobs import Job
from deepfsi.sweeps.context import Batch, SweepContext
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.records import Records
from deepfsi.sweeps.trial import plan
from deepfsi.sweeps.workers import cores, default_count
from deepfsi.training import batch_of, train

TIMED_STEPS = 6
"""Steps that a kind of training is timed with."""

TIMED_SCENES = 500
"""Scenes that a test is timed with."""


@dataclass(frozen=True)
class Forecast:
    """Cost of a sweep."""

    # Trials in all and of them done already; batches that the others train in, and processes
    trials: int
    done: int
    batches: int
    workers: int
    # Floating-point operations of the products of scenes with masks that are left
    operations: float
    # Expected on this machine for what is left, if other programs go on to load it as they did
    # while it was timed
    seconds: float
    seconds_free: float  # the same on this machine without other programs
    others: float  # cores that other programs kept busy, in the mean while it was timed
    cores: int  # of this machine, for this process


def forecast_cost(
    recipe: Recipe,
    data: Dataset,
    folder: Path,
    device: str | torch.device = "auto",
    workers: int | None = None,
    report: Progress = SILENT,
) -> Forecast:
    """Cost of a sweep, less what its folder holds; of folds that of all together."""
    parts = recipe.parts(data)
    each = [
        _forecast(recipe, part, folder, device, workers, span)
        for part, span in zip(parts, report.split(len(parts)), strict=True)
    ]
    added = ("trials", "done", "batches", "operations", "seconds", "seconds_free")
    sums = {name: sum(getattr(cost, name) for cost in each) for name in added}
    return replace(each[0], **sums)


def _forecast(
    recipe: Recipe,
    data: Dataset,
    folder: Path,
    device: str | torch.device,
    workers: int | None,
    report: Progress,
) -> Forecast:
    """Cost on one data set, or on one fold."""
    # What only needs other tests of a design that is there is not counted, nor are the products of
    # all scenes that fixed designs take once. Every kind of training is timed with its fewest and
    # its most masks, on a few scenes and the threads of one worker; what lies between is
    # interpolated
    trials = plan(recipe, data)
    records = Records(folder)
    open_trials = [trial for trial in trials if records.read(trial) is None]
    untrained = [trial for trial in open_trials if records.design(trial) is None]
    left = list({trial.design_key: trial for trial in untrained}.values())
    context = SweepContext(data, recipe.held_out(data), device)
    processes = workers or default_count(context.processor.type)
    todo = context.batches(left, processes)
    kinds: dict[Any, list[Batch]] = defaultdict(list)
    for batch in todo:
        context.training_set.prepare(batch[0].job.start_matrix)
        kinds[_kind(batch, context)].append(batch)
    threads, costs = torch.get_num_threads(), list[float]()
    torch.set_num_threads(max(1, threads // processes))
    load = _Load()
    try:
        for place, members in enumerate(kinds.values()):
            report(place / len(kinds), context.title(members[0]))
            costs += _seconds(members, context)
    finally:
        torch.set_num_threads(threads)
    others = load.of_others()
    timed = max(max(costs, default=0.0), sum(costs) / processes)
    free = timed / slowdown(others, 1, cores())
    return Forecast(
        trials=len(trials),
        done=len(trials) - len(open_trials),
        batches=len(todo),
        workers=processes,
        operations=sum(_operations(trial.job, context) for trial in left),
        seconds=free * slowdown(others, processes, cores()),
        seconds_free=free,
        others=others,
        cores=cores(),
    )


def slowdown(others: float, own: int, cores: int) -> float:
    """Times that processes of ours take as long as on a free machine, where all share its cores."""
    return max(1.0, (others + own) / cores)


class _Load:
    """Load by other programs, from its making on."""

    def __init__(self) -> None:
        psutil.cpu_percent()
        self.wall, self.used = time.perf_counter(), time.process_time()

    def of_others(self) -> float:
        """Cores that other programs want: those they had, or by what they left to this process."""
        wall, used = time.perf_counter() - self.wall, time.process_time() - self.used
        busy = psutil.cpu_percent() / 100 * (psutil.cpu_count() or 1)
        had = busy - used / wall
        return max(0.0, had, cores() * wall / max(used, 1e-3) - 1 if used < 0.9 * wall else 0.0)


def _seconds(batches: Sequence[Batch], context: SweepContext) -> list[float]:
    """Seconds of batches of one kind, interpolated between the fewest and the most masks."""
    by_masks = {batch[0].job.masks: batch for batch in batches}
    ends = sorted({min(by_masks), max(by_masks)})
    steps, tests = zip(*(_probe(by_masks[masks], context) for masks in ends), strict=True)
    return [
        _steps(batch[0].job, context) * float(np.interp(batch[0].job.masks, ends, steps))
        + len(batch) * float(np.interp(batch[0].job.masks, ends, tests))
        for batch in batches
    ]


def _kind(batch: Batch, context: SweepContext) -> Any:
    job = batch[0].job
    apart: Any = {"photons": True, "seed": True, "masks": True, "camera": {"sigma"}}
    tests = batch[0].model_dump_json(include={"test_noise", "test_levels", "draws"})
    kinds = dtypes(job, context.processor)
    return (job.model_dump_json(exclude=apart), kinds, len(batch), tests)


def _steps(job: Job, context: SweepContext) -> int:
    count = len(context.training_set.labels)
    return job.training.epochs * (count // batch_of(job.training, count))


def _operations(job: Job, context: SweepContext) -> float:
    """Of the products with learned masks: forward and backward, with M and under PN with |M|."""
    made = job.mask_job()
    if not made.code.learned:
        return 2.0 * context.data.x_train.size * job.masks * 2
    pair = 2 if find_noise(made.noise).stands_for else 1
    scene = int(context.training_set.pixels(made.optics.light).sum())
    count = len(context.training_set.labels)
    return 2.0 * made.training.epochs * count * scene * made.masks * pair * 2


def _probe(batch: Batch, context: SweepContext) -> tuple[float, float]:
    """Seconds of a step of this batch, and of the tests of one of its trials."""
    count = len(context.training_set.labels)
    size = batch_of(batch[0].job.training, count)
    few = _first(context.parts, TIMED_STEPS * size)
    short = batch[0].job.training.model_copy(update={"epochs": 2, "batch": size})
    jobs = [trial.job.model_copy(update={"training": short}) for trial in batch]
    training_set = TrainingSet(few, context.device, dict(context.matrices))
    moments = Moments()
    own = context.matrix if jobs[0].code.is_custom else None
    designs = train(training_set, jobs, own, moments.report)
    epochs = moments.epochs(4 if jobs[0].code.learned_under else 2)  # that is trained twice
    step = sum(epochs[1::2]) / (len(few.y_train) // size)
    trial = batch[0]
    began = time.perf_counter()
    evaluate(
        designs[0],
        few,
        trial.job.photons,
        noise=trial.test_noise[0],
        draws=trial.draws,
        report=SILENT,
    )
    tests = len(trial.test_photons) * len(trial.test_noise) * len(trial.test_levels)
    scale = (len(context.data.x_test) + context.held_out) / len(few.x_test)
    return step, (time.perf_counter() - began) * scale * tests


def _first(data: Dataset, count: int) -> Dataset:
    return replace(
        data,
        x_train=data.x_train[:count],
        y_train=data.y_train[:count],
        x_test=data.x_test[:TIMED_SCENES],
        y_test=data.y_test[:TIMED_SCENES],
    )
