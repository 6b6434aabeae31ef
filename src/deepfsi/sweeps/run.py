"""Runs: trials worked off and recorded, and comparisons of the trials of a recipe.

Trials are locked, trained here, in processes or on a Ray cluster, and recorded. A run that was
stopped goes on where it was, and several processes may work on one folder.
"""

import multiprocessing
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress
from deepfsi.datasets.dataset import Dataset
from deepfsi.sweeps.plan import Trial, plan_trials
from deepfsi.sweeps.ray_cluster import run_on_ray
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.records import FinishedTrial, Record, Records
from deepfsi.sweeps.results import Results
from deepfsi.sweeps.summary import summarise_records
from deepfsi.sweeps.workers import Resources, cores, processes

if TYPE_CHECKING:
    import torch

    from deepfsi.sweeps.batch import Batch, BatchTrainer


_ONE_PROCESSOR = Resources()


def compare(
    recipe: Recipe,
    data: Dataset,
    folder: Path,
    *,
    command: str,
    matrix: np.ndarray | None = None,
    device: "str | torch.device" = "auto",
    workers: int | None = 1,
    ray: str | None = None,
    report: Progress = SILENT,
) -> tuple[Results, list[Record]]:
    """Results of a recipe, and the record of each trial of each fold.

    The folder keeps records and designs: a changed recipe reuses what it still shares with them.
    `matrix` (m, N) holds the user's masks; `workers` None is one process on each core, one on a GPU
    and for several folds; `ray` is the address of a cluster that trains in their place, or "auto".
    Raises `InputError` if anything in the recipe cannot be had, or a training diverged.
    """
    from deepfsi.physics.surroundings import library_defaults

    with library_defaults(grad=True):
        began = time.perf_counter()
        scenes = recipe.parts(data)
        if len(scenes) > 1 and ray is None:
            # Trainings on few scenes take less than starting processes for each fold
            workers = workers or 1
        records = [
            run_trials(
                plan_trials(recipe, fold, matrix),
                fold,
                folder,
                matrix=matrix,
                device=device,
                workers=workers,
                ray=ray,
                resources=recipe.resources,
                report=span,
            )
            for fold, span in zip(scenes, report.split(len(scenes)), strict=True)
        ]
        seconds = time.perf_counter() - began
        results = summarise_records(recipe, data, scenes, records, command=command, seconds=seconds)
    return results, [*chain(*records)]


def run_trials(
    trials: Sequence[Trial],
    data: Dataset,
    folder: Path,
    *,
    matrix: np.ndarray | None = None,
    device: "str | torch.device" = "auto",
    workers: int | None = 1,
    ray: str | None = None,
    resources: Resources = _ONE_PROCESSOR,
    report: Progress = SILENT,
) -> list[Record]:
    """Records of trials on one data set; those that the folder lacks are trained and tested.

    Other processes may work on the same folder.
    """
    from deepfsi.sweeps.batch import BatchTrainer

    trainer = BatchTrainer(data, trials[0].validation, device, matrix)
    workers = workers or (1 if trainer.processor.type == "cuda" else cores())
    if multiprocessing.current_process().daemon:
        workers = 1  # a daemon may start no processes
    records = Records(folder)
    diverged: set[str] = set()
    before = 0
    try:
        while missing := [
            trial
            for trial in trials
            if trial.design_key not in diverged and not records.read(trial)
        ]:
            if len(missing) == before:
                time.sleep(1)  # another process works on them
            before = len(missing)
            untrained = _test_trained(trainer, records, missing, report)
            # Trials that differ in their tests alone share a design
            distinct = list({trial.design_key: trial for trial in untrained}.values())
            batches = trainer.batches(distinct, workers)
            if len(batches) > 1 and (ray is not None or workers > 1):
                # Else each process would compute them anew
                report(0.0, "matrices that all share")
                trainer.prepare(distinct)
            results = _train(trainer, records, batches, workers, ray, resources, report)
            with closing(results) as arriving:
                for finished in arriving:
                    records.write(finished)
                    diverged |= {done.trial.design_key for done in finished if not done.record}
    finally:
        records.release_all()
    if lost := {trainer.title([t]) for t in trials if t.design_key in diverged}:
        raise InputError(
            f"training diverged and the others are done: {', '.join(sorted(lost))}; lower lr "
            "and mask_lr"
        )
    # Two recipes may share a record and name its settings otherwise
    return [
        {**record, "trial": trial.model_dump(mode="json")}
        for trial in trials
        if (record := records.read(trial))
    ]


def _test_trained(
    trainer: "BatchTrainer", records: Records, trials: Sequence[Trial], report: Progress
) -> list[Trial]:
    """Test designs that were trained for other tests; return the other trials."""
    untrained = []
    for index, trial in enumerate(trials):
        design = records.design(trial)
        if design is None or not records.lock([trial]):
            untrained.append(trial)
            continue
        report(index / len(trials), f"testing {design.name} again")
        record = trainer.record(trial, design.to(trainer.processor))
        records.write([FinishedTrial(trial, record, None)])
    return untrained


def _train(
    trainer: "BatchTrainer",
    records: Records,
    batches: "Sequence[Batch]",
    workers: int,
    ray: str | None,
    resources: Resources,
    report: Progress,
) -> Generator[list[FinishedTrial], None, None]:
    """Yield the results of batches as they finish, here, in processes or on a cluster."""
    total = sum(map(trainer.effort, batches))
    done = 0.0
    locked = _locked_batches(records, batches)
    workers = min(workers, len(batches))
    if ray is None and workers <= 1:
        for batch in locked:
            report(done / total, trainer.title(batch))
            end = done + trainer.effort(batch)
            yield trainer.train(
                batch, report.between(done / total, end / total), records.checkpoints
            )
            done = end
        return
    # Unbound: tasks share the trainer, which is sent once
    work = type(trainer).train
    if ray is None:
        work_here = partial(work, checkpoints=records.checkpoints)
        results = processes(work_here, trainer, locked, workers)
    else:  # a node may see another disk: no checkpoints there
        results = run_on_ray(work, trainer, locked, address=ray, **dict(resources))
    with closing(results):
        for finished in results:
            batch = [member.trial for member in finished]
            done += trainer.effort(batch)
            report(min(done / total, 1.0), trainer.title(batch))
            yield finished


def _locked_batches(records: Records, batches: "Sequence[Batch]") -> "Iterator[Batch]":
    """Yield the untrained trials of each batch, locked; pass over what others have locked."""
    for batch in batches:
        left = [trial for trial in batch if records.design(trial) is None]
        if not records.lock(left):
            continue
        # Between the look and the lock another process may have finished some
        trained = [trial for trial in left if records.design(trial) is not None]
        records.release(trained)
        if len(trained) < len(left):
            yield [trial for trial in left if trial not in trained]
