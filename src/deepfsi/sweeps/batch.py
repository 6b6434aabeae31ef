"""Batches of trials that are trained together, and their tests."""

from collections import defaultdict
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress
from deepfsi.datasets.dataset import Dataset
from deepfsi.design.design import Design
from deepfsi.design.file import file_of
from deepfsi.evaluation.accuracy import camera_for, evaluate
from deepfsi.exposure.training_set import Matrices, TrainingSet
from deepfsi.sweeps.plan import Trial
from deepfsi.sweeps.records import FinishedTrial, Record
from deepfsi.sweeps.results import RESULTS_SCHEMA
from deepfsi.training.checkpoint import NO_CHECKPOINT, Checkpoint
from deepfsi.training.learning import Diverged, check_fits, companions, footprint, memory_for, train

MASKS_AT_ONCE = 2048
"""Learned masks that a processor trains together: with more its caches lose what batching gains."""

Batch = list[Trial]
"""Trials that are trained together."""


class BatchTrainer:
    """Trains and tests trials of a data set, here or in the process that it is sent to.

    `matrix` (m, N) holds the user's masks.
    """

    def __init__(
        self,
        data: Dataset,
        held_out: int,
        device: str | torch.device = "auto",
        matrix: np.ndarray | None = None,
    ) -> None:
        self.data = data
        self.held_out = held_out
        self.device = device
        self.matrix = matrix
        self.matrices: Matrices = {}

    @cached_property
    def split(self) -> Dataset:
        """The data with the validation scenes as its test part, if any are held out."""
        return self.data.hold_out(self.held_out) if self.held_out else self.data

    @cached_property
    def training_set(self) -> TrainingSet:
        """Scenes that are trained on."""
        return TrainingSet(self.split, self.device, self.matrices)

    def __getstate__(self) -> dict[str, Any]:
        # A process makes its own, on its device
        lazy = ("split", "training_set")
        return {name: value for name, value in vars(self).items() if name not in lazy}

    @property
    def processor(self) -> torch.device:
        """Device that trials are trained on here."""
        return self.training_set.device

    def batches(self, trials: Sequence[Trial], workers: int = 1) -> list[Batch]:
        """Batches that fit the free memory, the longest work first.

        Raises `InputError` if one trial alone takes more memory than is free.
        """
        # Not all that is free: footprints are estimates
        limit = 0.7 * memory_for(self.processor) / workers
        batches = self.batches_within(trials, limit)
        for batch in batches:
            if len(batch) == 1:
                check_fits(self.training_set, [batch[0].job], min(workers, len(batches)))
        return batches

    def batches_within(self, trials: Sequence[Trial], limit: float) -> list[Batch]:
        """Batches of at most `limit` bytes, the longest work first.

        A GPU trains all `companions` together; a processor those of one seed, which share scenes
        and noise, up to `MASKS_AT_ONCE`.
        """
        groups: dict[Any, Batch] = defaultdict(list)
        for trial in sorted(trials, key=lambda trial: (trial.job.seed, trial.job.photons)):
            seed = None if self.processor.type == "cuda" else trial.job.seed
            groups[(companions(trial.job, self.processor), seed)].append(trial)
        batches: list[Batch] = []
        for group in groups.values():
            batch: Batch = []
            learned_here = group[0].job.facts.learned and self.processor.type == "cpu"
            for trial in group:
                jobs = [*(other.job for other in batch), trial.job]
                too_many = learned_here and len(jobs) * trial.job.masks > MASKS_AT_ONCE
                if batch and (too_many or footprint(self.training_set, jobs) > limit):
                    batches.append(batch)
                    batch = []
                batch.append(trial)
            batches.append(batch)
        return sorted(batches, key=self.effort, reverse=True)

    def prepare(self, trials: Sequence[Trial]) -> None:
        """Compute the matrices that trials start from."""
        for trial in trials:
            self.training_set.view(trial.job.exposure).prepare(trial.job.start_matrix)

    def effort(self, batch: Sequence[Trial]) -> float:
        """Relative cost of training a batch: a constant a step, products and noise."""
        trial = batch[0]
        job = trial.job
        if job.facts.adaptive:  # tests take the time: a look at a scene costs 0.4
            scenes = trial.draws * len(trial.test_photons) * (len(self.data.x_test) + self.held_out)
            return 0.4 * scenes * job.masks * len(batch)
        cost = 20.0 + len(batch) * (20 + job.masks) * (3 if job.facts.learned else 1)
        twice = 2 if job.facts.learned_under else 1
        return job.training.epochs * cost * twice

    def title(self, batch: Sequence[Trial]) -> str:
        """Design, masks and number of trials of a batch."""
        job = batch[0].job
        return f"{job.design}, {job.masks} masks" + f" × {len(batch)}" * (len(batch) > 1)

    def train(
        self, batch: Batch, report: Progress = SILENT, checkpoints: Path | None = None
    ) -> list[FinishedTrial]:
        """Train and test one batch, from its checkpoint in the folder if there is one.

        A machine that batches otherwise, or has less free memory, divides it; a GPU whose memory
        does not hold it halves it. Where a trial diverges, all are trained one by one, and the
        record of that trial is None.
        """
        # Footprints count the scenes, which are in memory already
        taken = self.training_set.full.nbytes
        pieces = self.batches_within(batch, memory_for(self.processor) + taken)
        if len(pieces) == 1:
            try:
                return self._train_together(batch, report, checkpoints)
            except Diverged:
                if len(batch) == 1:
                    return [FinishedTrial(batch[0], None, None)]
                pieces = [[trial] for trial in batch]
            except torch.OutOfMemoryError:
                if len(batch) == 1:
                    raise InputError(
                        f'{self.title(batch)} do not fit the memory of this GPU: use `device="cpu"`'
                    ) from None
                pieces = [batch[: len(batch) // 2], batch[len(batch) // 2 :]]
        # Outside of the handlers: the error would keep the failed batch in memory
        spans = zip(pieces, report.split(len(pieces)), strict=True)
        return [done for piece, span in spans for done in self.train(piece, span, checkpoints)]

    def _train_together(
        self, batch: Batch, report: Progress, checkpoints: Path | None
    ) -> list[FinishedTrial]:
        """Train a batch that fits the memory, and test it."""
        first = batch[0].job
        # Share of the progress bar: tests of adaptive masks take most of the time
        share = 0.1 if first.facts.adaptive else 0.9
        matrix = self.matrix if first.facts.is_custom else None
        jobs = [trial.job for trial in batch]
        checkpoint = self._checkpoint(batch, matrix, checkpoints)
        learning = report.between(0.0, share)
        designs = train(self.training_set, jobs, matrix, report=learning, checkpoint=checkpoint)
        finished: list[FinishedTrial] = []
        for trial, design in zip(batch, designs, strict=True):
            content = file_of(design).to_bytes()
            finished.append(FinishedTrial(trial, self.record(trial, design), content))
            report.between(share, 1.0)(len(finished) / len(batch))
        return finished

    def _checkpoint(
        self, batch: Batch, matrix: np.ndarray | None, folder: Path | None
    ) -> Checkpoint:
        """Checkpoint of a batch, named by its first design; a file of no use is replaced."""
        if folder is None or batch[0].job.facts.adaptive:
            return NO_CHECKPOINT
        path = folder / f"{batch[0].design_key}.checkpoint"
        jobs = [trial.job for trial in batch]
        try:
            checkpoint = Checkpoint.of(path, self.training_set, jobs, matrix)
        except InputError:  # damaged, or of a batch of other trials
            path.unlink(missing_ok=True)
            checkpoint = Checkpoint.of(path, self.training_set, jobs, matrix)
        checkpoint.words = "what was trained is kept, run again to go on"
        return checkpoint

    def record(self, trial: Trial, design: Design) -> Record:
        """Record of a trial whose design is tested now."""
        return {
            "schema": RESULTS_SCHEMA,
            "key": trial.key,
            "design": trial.design_key,
            "trial": trial.model_dump(mode="json"),
            "validation": _tested(trial, design, self.split) if self.held_out else [],
            "test": _tested(trial, design, self.data),
            "info": design.info,
        }


def _tested(trial: Trial, design: Design, data: Dataset) -> list[dict[str, Any]]:
    """Results of a design on test scenes, by grey levels, noise and budget."""
    return [
        {**result.as_dict(), "levels": levels, "terms": result.packed_terms()}
        for levels in trial.test_levels
        for noise in trial.test_noise
        for result in evaluate(
            design.quantised(levels) if levels else design,
            data,
            trial.test_photons,
            camera=camera_for(design, noise=noise),
            draws=trial.draws,
            seed=trial.job.seed,
            report=SILENT,
        )
    ]
