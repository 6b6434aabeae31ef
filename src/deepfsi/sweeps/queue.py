"""Batches of trials, trained here, in worker processes or on a Ray cluster, and recorded."""

import math
import time
from collections import defaultdict
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from functools import cached_property
from typing import Any

import numpy as np
import psutil
import torch

from deepfsi import progress
from deepfsi.datasets import Dataset
from deepfsi.design.artifact import Design
from deepfsi.design.evaluation import evaluate
from deepfsi.errors import InputError
from deepfsi.sweeps.recipe import Resources
from deepfsi.sweeps.records import Records
from deepfsi.sweeps.results import SCHEMA
from deepfsi.sweeps.trial import Trial
from deepfsi.sweeps.workers import cores, processes
from deepfsi.training.learning import Diverged, train
from deepfsi.training.memory import footprint
from deepfsi.training.training_set import Matrices, TrainingSet

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


class SweepContext:
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
    def scenes(self) -> TrainingSet:
        """What is trained on."""
        return TrainingSet(self.parts, self.device, self.matrices)

    def __getstate__(self) -> dict[str, Any]:
        made_there = ("parts", "scenes")
        return {name: value for name, value in vars(self).items() if name not in made_there}


def batches(trials: Sequence[Trial], scenes: TrainingSet, limit: float) -> list[Batch]:
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


def work_off(
    todo: list[Batch],
    context: SweepContext,
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
            from deepfsi.sweeps.ray_cluster import run_on_ray

            cpus, gpus = resources.cpus, resources.gpus
            with closing(
                run_on_ray(train_batch, context, claimed, address=ray, cpus=cpus, gpus=gpus)
            ) as tasks:
                for _, result in tasks:
                    yield result
        elif workers > 1:
            with closing(processes(train_batch, context, claimed, workers)) as results:
                yield from results
        else:
            for batch in claimed:
                yield train_batch(context, batch, inside(batch))

    def inside(batch: Batch) -> progress.Report:
        return progress.Report(
            lambda share, _: tell((done + share * effort(batch)) / total, title_of(batch))
        )

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
                    tell(min(done / total, 1.0), title_of(batch))
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


def train_batch(
    context: SweepContext, batch: Batch, report: progress.Report = progress.SILENT
) -> list[Done]:
    """Train and test one batch.

    In parts where this machine would batch otherwise than the one that planned, in halves where a
    GPU's memory does not hold it whole, and one by one where a trial diverges; that one's record
    is None.
    """
    parts = batches(batch, context.scenes, math.inf)
    if len(parts) > 1:
        return [done for part in parts for done in train_batch(context, part)]
    own = context.matrix if batch[0].job.design == "custom" else None
    try:
        designs = train(context.scenes, [trial.job for trial in batch], own, report)
    except Diverged:
        if len(batch) == 1:
            return [(batch[0], None, None)]
        return [done for trial in batch for done in train_batch(context, [trial])]
    except torch.OutOfMemoryError:
        if len(batch) == 1:
            raise InputError(
                f"{title_of(batch)} do not fit the memory of this GPU: use --device cpu"
            ) from None
        middle = len(batch) // 2
        return train_batch(context, batch[:middle]) + train_batch(context, batch[middle:])
    pairs = zip(batch, designs, strict=True)
    return [
        (trial, tested_record(context, trial, design), design.to_bytes()) for trial, design in pairs
    ]


def tested_record(context: SweepContext, trial: Trial, design: Design) -> dict[str, Any]:
    """Record of a trial whose design is tested now."""
    return {
        "schema": SCHEMA,
        "key": trial.key,
        "design": trial.design_key,
        "trial": trial.model_dump(mode="json"),
        "validation": _tested(trial, design, context.parts) if context.held_out else [],
        "test": _tested(trial, design, context.data),
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


def title_of(batch: Sequence[Trial]) -> str:
    """Design, masks and number of trials of a batch."""
    job = batch[0].job
    return f"{job.design}, {job.masks} masks" + f" × {len(batch)}" * (len(batch) > 1)
