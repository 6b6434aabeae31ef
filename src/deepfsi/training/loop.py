"""The loop of training: steps that train R networks side by side, and masks where they learn.

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

from deepfsi.base import SILENT, InputError, Progress
from deepfsi.datasets import Dataset
from deepfsi.exposure.draws import network_dtype, seed_streams, side_by_side
from deepfsi.exposure.trained import MaskExposure
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs import VIT, Job, Training
from deepfsi.networks.classifiers import Mlp, Replicas, Vit
from deepfsi.networks.custom import OwnClassifier, make, seeded
from deepfsi.physics import FixedMasks, LearnedMasks, TrainingNoise
from deepfsi.training.batches import batch_of
from deepfsi.training.checkpoint import NO_CHECKPOINT, Checkpoint, LoopState
from deepfsi.training.counts import CountsCost, dim_start
from deepfsi.training.features import LearnedFeatures, features_of
from deepfsi.training.losses import find_loss, total

Classifier = Mlp | Vit | OwnClassifier
"""What is trained to classify."""

CHOOSER_LR = 0.2
"""Learning rate of the network that chooses dwells, over that of the classifier."""

THREADED_ELEMENTS = 2**15
"""Elements below which torch itself does not share an operation among threads."""

REPORT_SECONDS = 1.0
"""Time after which a training says how far it is, within an epoch, too."""


def optimise(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    masks: FixedMasks | LearnedMasks,
    noise: TrainingNoise,
    exposures: Sequence[MaskExposure],
    report: Progress = SILENT,
    checkpoint: Checkpoint = NO_CHECKPOINT,
) -> list[Classifier]:
    """Train classifiers of jobs, the networks of their exposures, and masks where they learn."""
    # Masks are of R replicas or of one for all, noise and exposures of the jobs. All but the
    # classifiers are trained in place. A classifier of a user's own trains alone
    job, settings, labels = jobs[0], jobs[0].training, training_set.labels
    classifiers = _classifiers(jobs, training_set.data, exposures[0], labels.device)
    choosers = [each.network for each in exposures if each.network is not None]
    stacked = labels.device.type == "cuda"
    dtype = network_dtype(job, labels.device)
    classify = Replicas(classifiers, stacked and isinstance(classifiers[0], Mlp), dtype)
    choose = Replicas(choosers, stacked, dtype)
    batch = batch_of(settings, len(labels))
    streams = seed_streams([each.seed for each in jobs], noise, labels, batch)
    features = features_of(training_set, job, masks, noise, streams, exposures[0], choose)
    weights = training_set.class_weights if settings.balance else None
    rows = isinstance(classifiers[0], Vit)
    each = find_loss(settings.loss, training_set.values is not None, weights, rows)
    steps = len(labels) // batch
    counted = features if isinstance(features, LearnedFeatures) and features.penalised else None
    cost = None
    if counted is not None and settings.counts is not None:
        dim_start(counted.masks, counted.x, noise, settings.counts, counted.detection)
        cost = CountsCost(settings.counts, settings.epochs * steps)

    def loss(step: int) -> Tensor:
        truth = side_by_side([stream.labels(step) for stream in streams])
        value = total(each, classify(features.at(step)), truth) / batch
        if counted is not None and cost is not None:
            value = value + cost(counted.expected).sum()
        return value

    groups = [parameter_group(classify, settings.lr, settings.decay)]
    if choosers:
        groups.append(parameter_group(choose, CHOOSER_LR * settings.lr, settings.decay))
    learned = [masks] if isinstance(masks, LearnedMasks) else []
    groups += [parameter_group(each, settings.mask_lr) for each in learned]
    generators = noise.generators + _generators(settings, [*classifiers, *choosers], labels.device)
    state = LoopState(
        [classify, choose, *learned], groups, settings.epochs * steps, streams, generators, cost
    )
    draws = seeded(job.seed) if settings.is_custom else nullcontext()
    tokens = exposures[0].tokens(training_set.data.image_shape)
    elements = batch * len(jobs) * tokens * max(job.masks, *settings.hidden, 1)
    with _threads(elements), draws:
        descend(state, steps, loss, report, checkpoint)
    for trained in (classify, choose):
        trained.hand_back()
    for network in [*classifiers, *choosers]:
        if isinstance(network, Mlp):
            network.generator = None
        network.eval()
    return classifiers


def parameter_group(module: nn.Module, lr: float, decay: float = 0.0) -> dict[str, Any]:
    """Parameters of a module with their peak learning rate and weight decay, for `descend`."""
    learning = [each for each in module.parameters() if each.requires_grad]
    return {"params": learning, "lr": lr, "weight_decay": decay}


def descend(
    state: LoopState,
    steps: int,
    loss: Callable[[int], Tensor],
    report: Progress,
    checkpoint: Checkpoint,
) -> None:
    """Minimise a loss with AdamW on a one-cycle schedule, in epochs of so many steps."""
    with checkpoint.of_loop(state):
        report(state.step / state.total)
        due = time.monotonic() + REPORT_SECONDS
        while state.step < state.total:
            step = state.step % steps
            if step == 0:
                state.shuffle()
            loss(step).backward()
            state.optimiser.step()
            state.optimiser.zero_grad(set_to_none=True)
            state.schedule.step()
            state.step += 1
            checkpoint.keep(state)
            if state.step % steps == 0 or time.monotonic() > due:
                report(state.step / state.total)
                due = time.monotonic() + REPORT_SECONDS


def _generators(
    settings: Training, networks: Sequence[nn.Module], device: torch.device
) -> list[torch.Generator]:
    """Generators that networks draw from in a training: their own, or torch's global ones."""
    generators = [each.generator for each in networks if isinstance(each, Mlp) and each.generator]
    if settings.is_custom:
        generators.append(torch.default_generator)
        if device.type == "cuda":
            generators.append(torch.cuda.default_generators[device.index])
    return generators


def _classifiers(
    jobs: Sequence[Job], data: Dataset, exposure: MaskExposure, device: torch.device
) -> list[Classifier]:
    """Classifiers of jobs, untrained."""
    job, settings, classes = jobs[0], jobs[0].training, data.answers
    inputs = exposure.input_count(job.features(data.image_shape))
    if settings.is_custom:
        made = make(settings.classifier, settings.classifier_arguments, inputs, classes, job.seed)
        if not any(each.requires_grad for each in made.parameters()):
            raise InputError("the classifier has no parameter that learns: give another module")
        return [made.to(device).train()]
    seeds = [torch.Generator(device).manual_seed(each.seed) for each in jobs]
    if settings.classifier == VIT:
        tokens, sizes = exposure.tokens(data.image_shape), settings.classifier_arguments
        return [Vit(inputs, tokens, classes, **sizes, generator=seed) for seed in seeds]
    return [Mlp(inputs, classes, settings.hidden, settings.dropout, seed) for seed in seeds]


@contextmanager
def _threads(elements: int) -> Iterator[None]:
    """Use one thread where a step is too small for several: they would wait for one another."""
    threads = torch.get_num_threads()
    torch.set_num_threads(threads if elements >= THREADED_ELEMENTS else 1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
