"""The training loop: its steps train R networks side by side, and their masks if these learn.

A step gathers B scenes, multiplies them with all m masks at once, draws noise, standardises,
classifies and descends. Scenes stay on the device, and nothing is read back within an epoch. Fixed
masks are multiplied with all scenes once, before the first step.

A seed fixes the order of scenes, the initial weights, the noise and the dropout. Replicas of one
seed share their draws, so that chance does not blur a difference between two budgets. Up to
rounding, a design does not depend on its companions.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any

import torch
from torch import nn
from torch.optim.lr_scheduler import OneCycleLR

from deepfsi.base.errors import InputError
from deepfsi.base.progress import Progress
from deepfsi.design.networks import Classifier, Replicas, find_network, make_custom, seeded
from deepfsi.exposure.training import ExposureTraining
from deepfsi.exposure.training_set import network_dtype
from deepfsi.jobs.training import Training
from deepfsi.physics.training_noise import Draws
from deepfsi.training.checkpoint import Checkpoint, LoopState
from deepfsi.training.hooks import EpochWatch, LoopWatch
from deepfsi.training.losses import CountsCost, find_loss

REPORT_SECONDS = 1.0
"""Seconds between two reports of progress."""


def optimise(
    exposure: ExposureTraining, report: Progress, checkpoint: Checkpoint, epochs: EpochWatch
) -> list[Classifier]:
    """Train the classifiers of jobs side by side, and their masks if these learn."""
    job = exposure.job
    settings = job.training
    device = exposure.training_set.device
    labels = exposure.training_set.labels
    classifiers = _classifiers(exposure)
    stacked = device.type == "cuda" and classifiers[0].stackable
    classify = Replicas(classifiers, stacked, network_dtype(job, device))
    batch = batch_of(settings, len(labels))
    draws = Draws([job.seed for job in exposure.jobs], exposure.noise, labels, batch)
    steps = draws.steps
    total = settings.epochs * steps
    exposure.prepare()
    scene_loss = find_loss(settings, exposure.training_set, bool(exposure.job.exposure.features))
    cost = None if settings.counts is None else CountsCost(settings.counts, total)
    groups = [_parameter_group(classify, settings.lr, settings.decay)]
    if exposure.learns:
        groups.append(_parameter_group(exposure.masks, settings.mask_lr))
    optimiser = torch.optim.AdamW(groups, fused=True)
    rates = [group["lr"] for group in groups]
    schedule = OneCycleLR(optimiser, rates, total_steps=total)  # each rate is a peak
    modules = [classify, *([exposure.masks] if exposure.learns else [])]
    generators = exposure.noise.generators + _generators(settings, classifiers, device)
    state = LoopState(
        modules=modules,
        optimiser=optimiser,
        schedule=schedule,
        draws=draws,
        generators=generators,
        total=total,
        cost=cost,
    )
    # of the widest layer in a step
    elements = batch * len(exposure.jobs) * exposure.parts * max(job.masks, *settings.hidden, 1)
    # a user's module draws from torch's global generators
    of_torch = seeded(job.seed) if settings.is_custom else nullcontext()
    watch = LoopWatch(epochs, exposure, state, loss=scene_loss, classify=classify)
    with _threads(elements), of_torch, checkpoint.of_loop(state):
        report(state.step / total)
        due = time.monotonic() + REPORT_SECONDS
        for number in range(state.step, state.total):
            if number % steps == 0:
                draws.shuffle()
            truth = draws.gather(number % steps)  # gather: (B, R)
            inputs = exposure.inputs(draws)  # expose: (B, R, …)
            outputs = classify(inputs)  # classify: (B, R, C)
            losses = scene_loss(outputs.flatten(0, 1), truth.flatten(0, 1))
            watch.take(losses)
            loss = losses.sum() / batch
            if cost is not None and exposure.counts is not None:
                loss = loss + cost(exposure.counts).sum()
            loss.backward()  # step
            optimiser.step()
            optimiser.zero_grad(set_to_none=True)
            schedule.step()
            state.step = number + 1
            checkpoint.keep(state)
            if state.step % steps == 0 or time.monotonic() > due:
                report(state.step / total)
                due = time.monotonic() + REPORT_SECONDS
            if watch.ends():
                state.total = state.step
                break
    epochs.lengths.append(watch.number)
    classify.hand_back()
    for network in classifiers:
        network.generator = None
        network.eval()
    return classifiers


def batch_of(settings: Training, count: int) -> int:
    """Scenes of a step."""
    return min(settings.batch or min(max(count // 100, 32), 500), count)


def _parameter_group(module: nn.Module, lr: float, decay: float = 0.0) -> dict[str, Any]:
    """Parameters of a module with their peak learning rate and weight decay."""
    learning = [weight for weight in module.parameters() if weight.requires_grad]
    return {"params": learning, "lr": lr, "weight_decay": decay}


def _generators(
    settings: Training, networks: Sequence[Classifier], device: torch.device
) -> list[torch.Generator]:
    """Generators that networks draw from in a training: their own, or torch's global ones."""
    generators = [network.generator for network in networks if network.generator]
    if settings.is_custom:
        generators.append(torch.default_generator)
        if device.type == "cuda":
            index = torch.empty(0, device=device).device.index  # "cuda" alone has none
            generators.append(torch.cuda.default_generators[index])
    return generators


def _classifiers(exposure: ExposureTraining) -> list[Classifier]:
    """Classifiers of jobs, untrained."""
    settings = exposure.job.training
    device = exposure.training_set.device
    inputs = exposure.input_count
    classes = exposure.training_set.data.answers
    if settings.is_custom:
        network = make_custom(
            settings.classifier,
            settings.classifier_arguments,
            inputs,
            classes,
            seed=exposure.job.seed,
        )
        if not any(weight.requires_grad for weight in network.parameters()):
            raise InputError("the classifier has no parameter that learns: give another module")
        return [network.to(device).train()]
    generators = [torch.Generator(device).manual_seed(job.seed) for job in exposure.jobs]
    kind = find_network(settings.classifier)
    sizes = inputs, classes, exposure.parts
    return [kind.of_settings(settings, *sizes, generator) for generator in generators]


@contextmanager
def _threads(elements: int) -> Iterator[None]:
    """Use one thread for small steps, in which several would wait for one another."""
    threads = torch.get_num_threads()
    # torch's GRAIN_SIZE: it splits no smaller loop
    torch.set_num_threads(threads if elements >= 2**15 else 1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
