"""Runs: trials worked off and recorded, and comparisons of the trials of a recipe.

Trials are locked, trained here, in processes or on a Ray cluster, and recorded. A run that was
stopped goes on where it was, and several processes may work on one folder.
"""

import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
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
    `matrix` (m, N) holds the user's masks; `workers` None is one process on each core, or one on a
    GPU; `ray` is the address of a cluster that trains in their place, or "auto". Raises
    `InputError` if anything in the recipe cannot be had, or a training diverged.
    """
    from deepfsi.physics.surroundings import library_defaults

    with library_defaults(grad=True):
        began = time.perf_counter()
        scenes = recipe.parts(data)
        if len(scenes) > 1 and ray is None:
            # trainings on few scenes take less than starting processes for each fold
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
    work = _Work(trainer, Records(folder), workers, ray, resources, report)
    try:
        diverged = work.finish(trials)
    finally:
        work.records.release_all()
    if lost := {trainer.title([t]) for t in trials if t.design_key in diverged}:
        raise InputError(
            f"training diverged and the others are done: {', '.join(sorted(lost))}; lower lr "
            "and mask_lr"
        )
    # two recipes may share a record and name its settings otherwise
    return [
        {**record, "trial": trial.model_dump(mode="json")}
        for trial in trials
        if (record := work.records.read(trial))
    ]


@dataclass(frozen=True)
class _Work:
    """Work on trials of a data set."""

    trainer: "BatchTrainer"
    records: Records
    workers: int
    ray: str | None
    resources: Resources
    report: Progress

    def finish(self, trials: Sequence[Trial]) -> set[str]:
        """Train and test what has no record yet; return the keys of designs that diverged."""
        diverged: set[str] = set()
        before = 0
        while missing := [
            trial
            for trial in trials
            if trial.design_key not in diverged and not self.records.read(trial)
        ]:
            if len(missing) == before:
                time.sleep(1)  # another process tests them
            before = len(missing)
            untrained = self._test_trained(missing)
            if untrained:
                first_of_each = {trial.design_key: trial for trial in untrained}
                diverged |= self._train(list(first_of_each.values()))
                self.report(1.0, "done")
        return diverged

    def _test_trained(self, trials: Sequence[Trial]) -> list[Trial]:
        """Test designs that were trained for other tests; return the other trials."""
        others = []
        for index, trial in enumerate(trials):
            design = self.records.design(trial)
            if design is None or not self.records.lock([trial]):
                others.append(trial)
                continue
            self.report(index / len(trials), f"testing {design.name} again")
            record = self.trainer.record(trial, design.to(self.trainer.processor))
            self.records.write([FinishedTrial(trial, record, None)])
        return others

    def _train(self, trials: Sequence[Trial]) -> set[str]:
        """Train and record trials of different designs; return the keys of those that diverged."""
        trainer = self.trainer
        todo = trainer.batches(trials, self.workers)
        workers = min(self.workers, len(todo))
        if self.ray is not None or workers > 1:
            self.report(0.0, "matrices that all share")
            trainer.prepare(trials)
        bar = _EffortBar(trainer, todo, self.report)
        diverged: set[str] = set()
        while todo:
            bar.say(f"{len(todo)} batches")
            postponed: list[Batch] = []
            with closing(self._results(self._claimed(todo, postponed), workers, bar)) as arriving:
                for finished in arriving:
                    self.records.write(finished)
                    diverged |= {done.trial.design_key for done in finished if not done.record}
                    bar.finish([done.trial for done in finished])
            todo = postponed
            if todo:
                bar.say(f"another process works on {len(todo)} batches")
                time.sleep(1)
        return diverged

    def _claimed(self, todo: "Sequence[Batch]", postponed: "list[Batch]") -> "Iterator[Batch]":
        """Yield what is left of each batch, locked; postpone what another process works on."""
        records = self.records
        for batch in todo:
            left = [trial for trial in batch if records.design(trial) is None]
            if left and not records.lock(left):
                postponed.append(left)
                continue
            # between the look and the lock another process may have finished some
            trained = [trial for trial in left if records.design(trial) is not None]
            records.release(trained)
            if len(trained) < len(left):
                yield [trial for trial in left if trial not in trained]

    def _results(
        self, batches: "Iterator[Batch]", workers: int, bar: "_EffortBar"
    ) -> Generator[list[FinishedTrial], None, None]:
        """Yield what batches give, as they finish."""
        trainer = self.trainer
        checkpoints = self.records.checkpoints
        work = type(trainer).train
        if self.ray is not None:  # a node may see another disk: no checkpoints there
            there = run_on_ray(work, trainer, batches, address=self.ray, **dict(self.resources))
            with closing(there) as results:
                yield from results
        elif workers > 1:
            yield from processes(partial(work, checkpoints=checkpoints), trainer, batches, workers)
        else:
            for batch in batches:
                yield trainer.train(batch, bar.span(batch), checkpoints)


class _EffortBar:
    """Shows the share of batches that are done; each counts by its effort."""

    def __init__(self, trainer: "BatchTrainer", batches: "Sequence[Batch]", show: Progress) -> None:
        self.trainer = trainer
        self.show = show
        self.total = sum(map(trainer.effort, batches))
        self.done = 0.0

    def say(self, words: str) -> None:
        """Say what is being done."""
        self.show(min(self.done / self.total, 1.0), words)

    def span(self, batch: "Batch") -> Progress:
        """Progress of a batch that is trained here."""
        title = self.trainer.title(batch)
        titled = Progress(lambda share, _: self.show(share, title))
        end = (self.done + self.trainer.effort(batch)) / self.total
        return titled.between(self.done / self.total, end)

    def finish(self, batch: "Batch") -> None:
        """Count a batch as done."""
        self.done += self.trainer.effort(batch)
        self.say(self.trainer.title(batch))
