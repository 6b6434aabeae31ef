"""The descent itself: steps that train R classifiers side by side, and masks where they learn.

One step, for B scenes and m masks: gather scenes, multiply them with all masks at once, draw noise,
standardise, classify, descend. The scenes stay on the device, nothing is read back within an epoch,
and the products of designs that do not learn are taken once before the first.

A seed fixes the order of scenes, the initial weights, the noise and the dropout. Replicas of one
seed take the same draws, so that a difference between two budgets is not blurred by chance, and up
to rounding a design does not depend on which others it was trained with.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.design.adaptive import AdaptiveDwells
from deepfsi.design.classifiers import Mlp, Replicas
from deepfsi.optics.masks import Fixed, Learned
from deepfsi.training.draws import SeedStream, side_by_side
from deepfsi.training.features import step_features
from deepfsi.training.job import Job, TrainingSettings
from deepfsi.training.training_set import TrainingSet

Progress = Callable[[float], None]
"""Called with the share of the work that is done, 0 to 1."""

MASK_TENSORS = 16
"""Copies of the masks alive in a step: weights, gradients, moments, their stages and products."""

SHOWN_TENSORS = 10
"""Those besides of quantised masks: two rails, their steps, what is shown, and its two sums."""

STEP_TENSORS = 12
"""The same for the features."""

EARLY = 0.2
"""Weight of the loss of the answers before the last look, in their mean; the last has 1."""

CHOOSER = 0.2
"""Learning rate of the network that chooses dwells, over that of the classifier."""

GRAIN = 2**15
"""Elements below which torch itself does not share an operation among threads."""


def optimise(
    scenes: TrainingSet, jobs: Sequence[Job], masks: Fixed | Learned, report: Progress
) -> tuple[list[Mlp], list[AdaptiveDwells]]:
    """Train the classifiers of jobs, and the masks where they learn; masks are changed in place.

    Parameters
    ----------
    scenes : TrainingSet
    jobs : sequence of Job
        R jobs that agree in `Job.companions`, those of one seed one after another.
    masks : Fixed or Learned
        Of R replicas, or of one for all.
    report : callable
        Told the share that is done after each epoch.

    Returns
    -------
    classifiers : list of Mlp
    schedules : list of AdaptiveDwells
        Of jobs of several looks; else none.
    """
    job, how, device = jobs[0], jobs[0].training, scenes.device

    def networks(inputs: int, outputs: int, dropout: float) -> list[Mlp]:
        seeds = [torch.Generator(device).manual_seed(each.seed) for each in jobs]
        return [Mlp(inputs, outputs, how.hidden, dropout, seed) for seed in seeds]

    twice = how.looks > 1  # dwells besides features
    inputs = 2 * job.masks if twice else job.masks + (2 if how.told else 0)
    classifiers = networks(inputs, len(scenes.data.classes), how.dropout)
    choosers = networks(inputs + 1, job.masks, 0.0) if twice else []
    replicas = Replicas(classifiers, stacked=device.type == "cuda")
    choose = Replicas(choosers, stacked=device.type == "cuda")
    groups: list[dict[str, Any]] = [
        {"params": list(network.parameters()), "lr": rate * how.lr, "weight_decay": how.decay}
        for network, rate in ((replicas, 1.0), (choose, CHOOSER))
        if network.networks
    ]
    if isinstance(masks, Learned):
        groups.append({"params": list(masks.parameters()), "lr": how.mask_lr, "weight_decay": 0.0})
    batch = batch_of(how, len(scenes.labels))
    steps = len(scenes.labels) // batch
    streams = [
        SeedStream(scenes, jobs, [r for r, _ in members], steps, batch)
        for _, members in groupby(enumerate(jobs), key=lambda place: place[1].seed)
    ]
    features = step_features(scenes, jobs, masks, choose)
    optimiser = torch.optim.AdamW(groups, fused=True)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, [group["lr"] for group in groups], total_steps=how.epochs * steps
    )
    with _threads(batch * len(jobs) * max(job.masks, *how.hidden, 1)):
        report(0.0)
        for epoch in range(how.epochs):
            for stream in streams:
                stream.shuffle()
            for step in range(steps):
                logits = replicas(features(streams, step))
                labels = side_by_side([stream.labels(step) for stream in streams])
                (_loss(logits, labels) / batch).backward()
                optimiser.step()
                optimiser.zero_grad(set_to_none=True)
                schedule.step()
            report((epoch + 1) / how.epochs)
    for trained in (replicas, choose):
        trained.hand_back()
    for network in [*classifiers, *choosers]:
        network.generator = None
        network.eval()
    return classifiers, [AdaptiveDwells(chooser, how.looks) for chooser in choosers]


def _loss(logits: Tensor, labels: Tensor) -> Tensor:
    """Sum over scenes and replicas (B, R) of the cross entropy of logits (K · B, R, C), K looks."""
    looks = len(logits) // len(labels)
    if looks == 1:
        return functional.cross_entropy(logits.flatten(0, 1), labels.flatten(), reduction="sum")
    truth = labels.repeat(looks, 1).flatten()
    each = functional.cross_entropy(logits.flatten(0, 1), truth, reduction="none")
    *early, last = each.view(looks, -1).sum(dim=1)
    return last + EARLY / len(early) * sum(early)


def batch_of(how: TrainingSettings, count: int) -> int:
    """Scenes of one step, of `count` in all."""
    return min(how.batch or min(max(count // 100, 32), 500), count)


def footprint(scenes: TrainingSet, jobs: Sequence[Job]) -> float:
    """Bytes that training jobs together takes at most, the scenes included, by the tensors alive.

    Parameters
    ----------
    scenes : TrainingSet
    jobs : sequence of Job
        As for `optimise`.
    """
    job, scene = jobs[0], scenes.full[0].numel()
    count, replicas = len(scenes.labels), len(jobs)
    masks, batch = replicas * job.masks, batch_of(job.training, count)
    single = 4.0
    copies = MASK_TENSORS + (SHOWN_TENSORS if job.training.steps else 0)
    learned = copies * masks * scene if job.masks_from().code.learned else 0
    own = replicas if job.design in ("control", "random") else 1
    products_of_all = 0 if job.code.learned else 5 * own * count * job.masks
    step = STEP_TENSORS * batch * (masks + replicas * sum(job.training.hidden))
    step *= job.training.looks
    return single * (3 * scenes.full.numel() + learned + products_of_all + step)


@contextmanager
def _threads(units: int) -> Iterator[None]:
    """Use one thread where a step is too small for several: they would wait for one another."""
    threads = torch.get_num_threads()
    torch.set_num_threads(threads if units >= GRAIN else 1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
