"""The loop of training: steps that train R classifiers side by side, and masks where they learn.

One step, for B scenes and m masks: gather scenes, multiply them with all masks at once, draw noise,
standardise, classify, descend. The scenes stay on the device, nothing is read back within an epoch,
and the products of designs that do not learn are taken once before the first.

A seed fixes the order of scenes, the initial weights, the noise and the dropout. Replicas of one
seed take the same draws, so that a difference between two budgets is not blurred by chance, and up
to rounding a design does not depend on which others it was trained with.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from deepfsi.datasets import Dataset
from deepfsi.design.classifiers import Mlp, Replicas
from deepfsi.design.exposure.looks import Dwells, LooksExposure
from deepfsi.design.own import Given, OwnClassifier, make, seeded
from deepfsi.errors import InputError
from deepfsi.memory import check_memory, free_memory
from deepfsi.optics.features import FeatureNoise
from deepfsi.optics.masks import FixedMasks, LearnedMasks
from deepfsi.progress import SILENT, Report
from deepfsi.training.draws import seed_streams, side_by_side
from deepfsi.training.features import features_of
from deepfsi.training.job import Job, TrainingSettings, network_dtype, seeds_of_matrices
from deepfsi.training.training_set import TrainingSet

Classifier = Mlp | OwnClassifier
"""What is trained to classify."""

EARLY_LOOKS_WEIGHT = 0.2
"""Weight of the loss of the answers before the last look, in their mean; the last has 1."""

CHOOSER_LR = 0.2
"""Learning rate of the network that chooses dwells, over that of the classifier."""

THREADED_ELEMENTS = 2**15
"""Elements below which torch itself does not share an operation among threads."""

MASK_COPIES = 16
"""Copies of the masks alive in a step: weights, gradients, moments, their stages and products."""

QUANTISED_MASK_COPIES = 10
"""Those besides of quantised masks: two rails, their steps, what is shown, and its two sums."""

FEATURE_COPIES = 12
"""Copies of the features and hidden units alive in a step."""

REPORT_SECONDS = 1.0
"""Time after which a training says how far it is, within an epoch, too."""

FLOAT_BYTES = 4.0
"""Bytes of a number."""


def optimise(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    masks: FixedMasks | LearnedMasks,
    noise: FeatureNoise,
    report: Report = SILENT,
    classifier: Given | None = None,
) -> tuple[list[Classifier], list[LooksExposure]]:
    """Trained classifiers of jobs, and adaptive dwells of those of several looks.

    Masks are trained in place where they learn. Parameters as for `learning.train`; masks are of R
    replicas or of one for all, noise of the jobs. A classifier of a user's own trains alone.
    """
    job, settings, labels = jobs[0], jobs[0].training, training_set.labels
    classifiers, choosers = _networks(jobs, training_set.data, labels.device, classifier)
    stacked = labels.device.type == "cuda"
    dtype = network_dtype(job, labels.device)
    classify = Replicas(classifiers, stacked and not settings.own, dtype)
    choose = Replicas(choosers, stacked, dtype)
    batch = batch_of(settings, len(labels))
    streams = seed_streams(jobs, noise, labels, batch)
    features = features_of(training_set, job, masks, noise, streams, choose)
    weights = training_set.class_weights if settings.balance else None

    def shuffle() -> None:
        for stream in streams:
            stream.shuffle()

    def loss(step: int) -> Tensor:
        logits = classify(features.at(step))
        truth = side_by_side([each.labels(step) for each in streams])
        return _loss(logits, truth, weights) / batch

    groups = [parameter_group(classify, settings.lr, settings.decay)]
    if choosers:
        groups.append(parameter_group(choose, CHOOSER_LR * settings.lr, settings.decay))
    if isinstance(masks, LearnedMasks):
        groups.append(parameter_group(masks, settings.mask_lr))
    draws = seeded(job.seed) if settings.own else nullcontext()
    with _threads(batch * len(jobs) * max(job.masks, *settings.hidden, 1)), draws:
        descend(groups, settings.epochs, len(labels) // batch, shuffle, loss, report)
    for trained in (classify, choose):
        trained.hand_back()
    for network in [*classifiers, *choosers]:
        if isinstance(network, Mlp):
            network.generator = None
        network.eval()
    dwells, device = Dwells.of(job.masks, *job.optics), (settings.looks, settings.shortest_dwell)
    return classifiers, [LooksExposure(dwells, each, *device) for each in choosers]


def parameter_group(module: nn.Module, lr: float, decay: float = 0.0) -> dict[str, Any]:
    """Parameters of a module with their peak learning rate and weight decay, for `descend`."""
    learning = [each for each in module.parameters() if each.requires_grad]
    return {"params": learning, "lr": lr, "weight_decay": decay}


def descend(
    groups: list[dict[str, Any]],
    epochs: int,
    steps: int,
    shuffle: Callable[[], None],
    loss: Callable[[int], Tensor],
    report: Report,
) -> None:
    """Minimise a loss with AdamW on a one-cycle schedule."""
    optimiser = torch.optim.AdamW(groups, fused=True)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, [group["lr"] for group in groups], total_steps=epochs * steps
    )
    report(0.0)
    due = time.monotonic() + REPORT_SECONDS
    for epoch in range(epochs):
        shuffle()
        for step in range(steps):
            if time.monotonic() > due:
                report((epoch + step / steps) / epochs)
                due = time.monotonic() + REPORT_SECONDS
            loss(step).backward()
            optimiser.step()
            optimiser.zero_grad(set_to_none=True)
            schedule.step()
        report((epoch + 1) / epochs)


def _networks(
    jobs: Sequence[Job], data: Dataset, device: torch.device, own: Given | None
) -> tuple[list[Classifier], list[Mlp]]:
    """Classifiers, and for several looks networks that choose dwells, untrained."""
    job, settings, classes = jobs[0], jobs[0].training, len(data.classes)
    detection = job.detection(data.image_shape)

    def networks(inputs: int, outputs: int, dropout: float) -> list[Mlp]:
        seeds = [torch.Generator(device).manual_seed(each.seed) for each in jobs]
        return [Mlp(inputs, outputs, settings.hidden, dropout, seed) for seed in seeds]

    def classifiers(inputs: int) -> list[Classifier]:
        if not settings.own:
            return [*networks(inputs, classes, settings.dropout)]
        arguments = {} if isinstance(own, nn.Module) else settings.classifier_arguments
        made = make(own or settings.classifier, arguments, inputs, classes, job.seed)
        if not any(each.requires_grad for each in made.parameters()):
            raise InputError("the classifier has no parameter that learns: give another module")
        return [made.to(device).train()]

    features = job.masks * detection.width({"dual": 2, "single": 1}[job.optics[1]])
    if settings.looks > 1:  # dwells besides features, and the share of the exposure that is left
        dwells = Dwells.of(job.masks, *job.optics).count
        inputs = features + dwells
        return classifiers(inputs), networks(inputs + 1, dwells, 0.0)
    return classifiers(features + 2 * settings.conditioned), []


def _loss(logits: Tensor, labels: Tensor, weights: Tensor | None) -> Tensor:
    """Sum over scenes and replicas (B, R) of the cross entropy of logits (K · B, R, C), K looks.

    Scenes have the weights (C,) of their classes, if there are any.
    """
    looks = len(logits) // len(labels)
    # sums over few classes are many times faster along a leading axis
    by_class, truth = logits.flatten(0, 1).T.contiguous()[None], labels.repeat(looks, 1).view(1, -1)
    if looks == 1:
        return functional.cross_entropy(by_class, truth, weights, reduction="sum")
    each = functional.cross_entropy(by_class, truth, weights, reduction="none")
    *early, last = each.view(looks, -1).sum(dim=1)
    return last + EARLY_LOOKS_WEIGHT / len(early) * sum(early)


def batch_of(settings: TrainingSettings, count: int) -> int:
    """Scenes of a step, of `count` in all."""
    return min(settings.batch or min(max(count // 100, 32), 500), count)


@contextmanager
def _threads(elements: int) -> Iterator[None]:
    """Use one thread where a step is too small for several: they would wait for one another."""
    threads = torch.get_num_threads()
    torch.set_num_threads(threads if elements >= THREADED_ELEMENTS else 1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def check_fits(training_set: TrainingSet, jobs: Sequence[Job], processes: int = 1) -> None:
    """Raise `InputError` where training jobs together would take more memory than is free."""
    scenes, pixels = training_set.full.shape
    held = training_set.full.nbytes
    check_memory(
        footprint(training_set, jobs) * processes - held,
        memory_for(training_set.device),
        f"{scenes} scenes of {pixels} pixels, {jobs[0].masks} masks and {processes} processes",
        "give fewer or smaller scenes (`size`), fewer `masks` or fewer `workers`",
    )


def memory_for(device: torch.device) -> float:
    """Bytes that this process may take on a device."""
    if device.type != "cuda":
        return free_memory()
    kept = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return float(torch.cuda.mem_get_info(device)[0] + kept)  # torch keeps what it has freed


def footprint(training_set: TrainingSet, jobs: Sequence[Job]) -> float:
    """Bytes that training jobs together takes at most, scenes included, by the tensors alive."""
    job, scene = jobs[0], training_set.full[0].numel()
    count, replicas = len(training_set.labels), len(jobs)
    masks, batch = replicas * job.masks, batch_of(job.training, count)
    copies = MASK_COPIES + (QUANTISED_MASK_COPIES if job.training.levels else 0)
    learned = copies * masks * scene if job.masks_from().code.learned else 0
    own = replicas if job.design == "control" else len(seeds_of_matrices(jobs))
    products_of_all = 0 if job.code.learned else 5 * own * count * job.masks
    step = FEATURE_COPIES * batch * (masks + replicas * sum(job.training.hidden))
    step *= job.training.looks
    return FLOAT_BYTES * (3 * training_set.full.numel() + learned + products_of_all + step)
