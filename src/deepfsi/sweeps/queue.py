"""Trials: locked, trained here, in processes or on a Ray cluster, and recorded.

A run that was stopped goes on where it was, and several processes may work on one folder.
"""

import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from deepfsi.base import SILENT, InputError, Progress
from deepfsi.sweeps.context import Batch, Done, SweepContext
from deepfsi.sweeps.records import Records
from deepfsi.sweeps.trial import Trial
from deepfsi.sweeps.workers import HERE, Workers, default_count, processes, report_of_task


def run_trials(
    trials: Sequence[Trial],
    context: SweepContext,
    folder: Path,
    workers: Workers = HERE,
    report: Progress = SILENT,
) -> list[dict[str, Any]]:
    """Train and test whatever the folder does not hold yet."""
    records = Records(folder)
    try:
        lost = _work_off(trials, context, records, workers, report)
    finally:
        records.release_all()
    if lost:
        names = sorted({context.title([trial]) for trial in lost})
        raise InputError(
            f"training diverged and the others are done: {', '.join(names)}; lower lr and mask_lr"
        )
    found = [(trial, records.read(trial)) for trial in trials]
    # a record is found by what it depends on; its words are those of who asks
    return [{**record, "trial": trial.model_dump(mode="json")} for trial, record in found if record]


def _work_off(
    trials: Sequence[Trial],
    context: SweepContext,
    records: Records,
    workers: Workers,
    report: Progress,
) -> list[Trial]:
    """Train and test until all trials have records; return those that diverged."""
    failed: set[str] = set()
    before = 0
    while missing := [t for t in trials if t.design_key not in failed and not records.read(t)]:
        if len(missing) == before:
            time.sleep(1)  # another process tests them
        before = len(missing)
        untrained = _test_trained(missing, context, records, report)
        if not untrained:
            continue
        first_of_each = list({trial.design_key: trial for trial in untrained}.values())
        count = workers.count or default_count(context.processor.type)
        todo = context.batches(first_of_each, count)
        here = replace(workers, count=min(count, len(todo)))
        if here.ray is not None or min(count, len(todo)) > 1:
            report(0.0, "matrices that all share")
            context.prepare(first_of_each)
        lost = _train_all(todo, context, records, here, report)
        failed |= {trial.design_key for trial in lost}
        report(1.0, "done")
    return [trial for trial in trials if trial.design_key in failed]


def _test_trained(
    trials: Sequence[Trial], context: SweepContext, records: Records, report: Progress
) -> list[Trial]:
    """Test the designs that are there already, from other tests; return the other trials."""
    left = []
    for place, trial in enumerate(trials):
        design = records.design(trial)
        if design is None or not records.lock([trial]):
            left.append(trial)
            continue
        report(place / len(trials), f"testing {design.name} again")
        records.write([(trial, context.record(trial, design.to(context.processor)), None)])
    return left


def _train_all(
    todo: list[Batch],
    context: SweepContext,
    records: Records,
    workers: Workers,
    report: Progress,
) -> list[Trial]:
    """Train and record batches; return the trials that diverged."""
    lost: list[Trial] = []
    given: list[Batch] = []
    total, done = sum(map(context.effort, todo)), 0.0

    def part(batch: Batch) -> Progress:
        title = context.title(batch)
        titled = Progress(lambda share, _: report(share, title))
        return titled.between(done / total, (done + context.effort(batch)) / total)

    def watch(shares: dict[int, float]) -> None:
        """Show how far all batches are that workers have."""
        under_way = sum(share * context.effort(given[place]) for place, share in shares.items())
        titles = dict.fromkeys(context.title(given[place]) for place in shares)
        report(min((done + under_way) / total, 1.0), "; ".join(titles))

    while todo:
        postponed: list[Batch] = []
        report(done / total, f"{len(todo)} batches")
        given.clear()
        locked = _locked(todo, records, postponed, given)
        with closing(
            _trained(locked, context, records.checkpoints, workers, part, watch)
        ) as arriving:
            for finished in arriving:
                lost += _recorded(finished, records)
                batch = [trial for trial, _, _ in finished]
                done += context.effort(batch)
                report(min(done / total, 1.0), context.title(batch))
        todo = postponed
        if todo:
            report(done / total, f"another process works on {len(todo)} batches")
            time.sleep(1)
    return lost


def _locked(
    todo: Sequence[Batch],
    records: Records,
    postponed: list[Batch],
    given: list[Batch],
) -> Iterator[Batch]:
    """Yield what is left to train of batches that no other process works on; note it in `given`."""
    for batch in todo:
        left = [trial for trial in batch if records.design(trial) is None]
        if not left:
            continue
        if not records.lock(left):
            postponed.append(left)
            continue
        finished = [trial for trial in left if records.design(trial) is not None]
        records.release(finished)
        if len(finished) < len(left):
            given.append([trial for trial in left if trial not in finished])
            yield given[-1]


def _trained(
    locked: Iterator[Batch],
    context: SweepContext,
    checkpoints: Path,
    workers: Workers,
    part: Callable[[Batch], Progress],
    watch: Callable[[dict[int, float]], None],
) -> Generator[list[Done], None, None]:
    """Yield what batches give, as they finish."""
    if workers.ray is not None:
        from deepfsi.sweeps.ray_cluster import run_on_ray

        # a node may see another disk: no checkpoints there
        cpus, gpus = workers.resources.cpus, workers.resources.gpus
        with closing(
            run_on_ray(_train, context, locked, address=workers.ray, cpus=cpus, gpus=gpus)
        ) as tasks:
            for _, result in tasks:
                yield result
    elif (workers.count or 1) > 1:
        count = workers.count or 1
        with closing(
            processes(partial(_train, checkpoints=checkpoints), context, locked, count, watch)
        ) as results:
            yield from results
    else:
        for batch in locked:
            yield context.train(batch, part(batch), checkpoints)


def _train(context: SweepContext, batch: Batch, checkpoints: Path | None = None) -> list[Done]:
    return context.train(batch, report_of_task(), checkpoints)


def _recorded(finished: Sequence[Done], records: Records) -> list[Trial]:
    """Write the records of a batch; return the trials that have none."""
    lost = [trial for trial, record, _ in finished if record is None]
    records.release(lost)
    records.write([(trial, held, made) for trial, held, made in finished if held is not None])
    return lost
