"""Compare estimators of the gradient of a mask under photon noise, on equal trainings.

    python benchmarks/gradients.py --csv gradients.csv  # one study of docs/notebook/gradients.md
    python benchmarks/gradients.py --data digits --quick  # the same in a moment

Poisson counts have no derivative by their rate. `ml_gauss` (the package's) trains on Gaussian noise
instead; the others draw exact counts and estimate how the loss changes with the rate of each
readout. All have the same scenes, order, initial weights, steps, schedule and choice of learning
rates, made on the validation part of the training set with other seeds; the test set is read once.
Formulas and what came out: docs/notebook/gradients.md.
"""

import argparse
import csv
import itertools
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np
import torch
from scipy import stats
from torch import Tensor
from torch.nn import functional

from deepfsi.datasets.load import load_dataset
from deepfsi.design.design import Design
from deepfsi.design.networks import Mlp
from deepfsi.evaluation.accuracy import evaluate
from deepfsi.exposure.kind import MaskExposure
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs.exposures import FixedEntry
from deepfsi.jobs.job import Job
from deepfsi.jobs.training import Training
from deepfsi.physics.detection import Detection, Rails
from deepfsi.physics.laws import LearnedMasks, light_law
from deepfsi.physics.noise import Poisson
from deepfsi.physics.scanner import project
from deepfsi.physics.training_noise import ml_gauss_features

GRID = ((1e-2, 0.03), (1e-2, 0.1), (1e-2, 0.3), (5e-3, 0.1))
"""Learning rates of classifier and masks to choose from."""

CHOICE_SEED = 100
"""Seeds of the trainings that choose learning rates start here; those of the result start at 0."""

REFERENCE = "ml_gauss"
LONGER = "ml_gauss longer"
"""For several times the epochs: what a dearer estimator's time would buy."""

RETRAINED = "ml_gauss retrained"
"""Masks of `ml_gauss`, then a new classifier on exact counts: tells the masks' share in a gain."""

TWICE = "ml_gauss twice"
"""The same with MLGauss noise: what a second training on masks that stay is worth by itself."""

CONTROLS = (LONGER, RETRAINED, TWICE)


@dataclass
class Draw:
    """One draw of counts of B scenes by m masks on two rails, and what the classifier made of it.

    The loss of a scene is f(z), z = (k⁺ − k⁻ − centre) / size.
    """

    network: Mlp
    labels: Tensor
    """Shape (B,)."""
    rates: Tensor
    """r, expected counts (B, 2, m)."""
    counts: Tensor
    """k, (B, 2, m)."""
    scaled: Tensor
    """z, (B, m)."""
    step: Tensor
    """By how much one photon changes z."""
    losses: Tensor
    """f(z), (B,)."""
    slope: Tensor
    """f'(z), (B, m)."""


Estimator = Callable[[Draw, torch.Generator], Tensor]
"""Gives an estimate of ∂ E[f] / ∂r, (B, 2, m)."""

SIGN = torch.tensor([[1.0], [-1.0]])
"""Of the two rails in a feature."""


def straight(draw: Draw, generator: torch.Generator) -> Tensor:
    """f'(k), as if counts followed their rate one to one."""
    return SIGN * (draw.slope * draw.step).unsqueeze(1)


def residual(draw: Draw, generator: torch.Generator) -> Tensor:
    """f'(k) (1 + ε / 2√r), with ε = (k − r) / √r held: f'(k) (1 + k/r) / 2."""
    ratio = torch.nan_to_num(draw.counts / draw.rates, nan=1.0, posinf=1.0)
    return straight(draw, generator) * (1 + ratio) / 2


def paired(draw: Draw, generator: torch.Generator) -> Tensor:
    """The same for y = k⁺ − k⁻, of mean μ and variance L: f'(y) (dμ + (y − μ) dL / 2L)."""
    mean, light = draw.rates[:, 0] - draw.rates[:, 1], draw.rates.sum(dim=1)
    excess = draw.counts[:, 0] - draw.counts[:, 1] - mean
    by_light = draw.slope * draw.step * torch.nan_to_num(excess / (2 * light), nan=0.0)
    return straight(draw, generator) + by_light.unsqueeze(1)


def midpoint(draw: Draw, generator: torch.Generator) -> Tensor:
    """f'(k + ½), all readouts at once: half a photon more on one rail of each mask, at random."""
    rail = torch.randint(2, draw.scaled.shape, generator=generator)
    sign = 1.0 - 2.0 * rail
    moved = (draw.scaled + sign * draw.step / 2).requires_grad_()
    (slope,) = torch.autograd.grad(
        functional.cross_entropy(draw.network(moved), draw.labels, reduction="sum"), moved
    )
    picked = torch.stack([rail == 0, rail == 1], dim=1)
    return 2 * picked * SIGN * (slope * draw.step).unsqueeze(1)


def score(draw: Draw, generator: torch.Generator) -> Tensor:
    """f(k) (k/r − 1), the score, with a second draw k' as baseline, and both averaged."""
    other = Poisson().draw(draw.rates, generator)
    change = (other - draw.counts) * SIGN
    with torch.no_grad():
        logits = draw.network(draw.scaled + change.sum(dim=1) * draw.step)
        losses = functional.cross_entropy(logits, draw.labels, reduction="none")
    ratio = torch.nan_to_num((other - draw.counts) / (2 * draw.rates), nan=0.0)
    return ratio * (losses - draw.losses)[:, None, None]


def difference(draw: Draw, generator: torch.Generator) -> Tensor:
    """f(k + 1) − f(k) for every readout, which is exact; the first layer is a rank-one update."""
    first, *inner, last = draw.network.layers
    with torch.no_grad():
        more = SIGN.unsqueeze(-1) * (first.weight.T * draw.step)
        h = (first(draw.scaled).unsqueeze(1) + more.flatten(0, 1)).relu_().flatten(0, 1)
        for layer in inner:
            h = layer(h).relu_()
        losses = cross_entropy(last(h).unflatten(0, draw.rates.shape), draw.labels)
        return losses - draw.losses[:, None, None]


def sampled(draw: Draw, generator: torch.Generator) -> Tensor:
    """The same for one readout of each scene, at random, times their number."""
    readouts = draw.rates[0].numel()
    picked = torch.randint(readouts, (len(draw.rates), 1), generator=generator)
    rail, mask = picked // draw.rates.shape[-1], picked % draw.rates.shape[-1]
    with torch.no_grad():
        moved = draw.scaled.scatter_add(1, mask, (1 - 2 * rail) * draw.step.expand(mask.shape))
        change = cross_entropy(draw.network(moved), draw.labels) - draw.losses
    slopes = torch.zeros_like(draw.rates)
    slopes.view(len(slopes), -1).scatter_(1, picked, readouts * change.unsqueeze(1))
    return slopes


def cross_entropy(logits: Tensor, labels: Tensor) -> Tensor:
    """Cross entropy (B, ...) of logits (B, ..., C)."""
    index = labels.view(-1, *[1] * (logits.ndim - 1)).expand(*logits.shape[:-1], 1)
    return logits.logsumexp(dim=-1) - logits.gather(-1, index).squeeze(-1)


ESTIMATORS: dict[str, Estimator | None] = {
    REFERENCE: None,
    "straight": straight,
    "residual": residual,
    "paired": paired,
    "midpoint": midpoint,
    "score": score,
    "sampled": sampled,
    "difference": difference,
}
"""The first is the package's own, and what the others are compared with."""


def descend(
    network: Mlp,
    rates: Tensor,
    centre: Tensor,
    size: Tensor,
    labels: Tensor,
    estimator: Estimator,
    generator: torch.Generator,
) -> None:
    """Gradients of a step under exact counts: the masks' by `estimator`, the classifier's as ever.

    Parameters
    ----------
    network : Mlp
    rates, centre, size : tensor, shapes (B, 2, m), (m,) and ()
        Functions of the masks, in counts.
    labels : tensor, shape (B,)
    estimator : function
    generator : torch.Generator
        Of the counts.
    """
    fixed = rates.detach()
    counts = Poisson().draw(fixed, generator)
    scaled = ((counts[:, 0] - counts[:, 1] - centre.detach()) / size.detach()).requires_grad_()
    losses = functional.cross_entropy(network(scaled), labels, reduction="none")
    losses.mean().backward()
    back, step = scaled.grad, 1 / size.detach()
    assert back is not None
    scaled = scaled.detach()
    slopes = estimator(
        Draw(network, labels, fixed, counts, scaled, step, losses.detach(), back * len(labels)),
        generator,
    )
    torch.autograd.backward(
        [rates, centre, size],
        [slopes / len(labels), -step * back.sum(dim=0), -step * (back * scaled).sum()],
    )


def learn(
    training_set: TrainingSet, job: Job, estimator: Estimator | None, keep: np.ndarray | None = None
) -> Design:
    """Train one dual-rail design as `deepfsi.training.learning.train` does, but for the estimator.

    With masks to `keep`, a matrix (m, N), the classifier alone.
    """
    settings = job.training
    gain = job.photons / training_set.summed_reflectance
    main = torch.Generator().manual_seed(job.seed)
    second = torch.Generator().manual_seed(job.seed + 2**31)
    network = Mlp(
        job.masks,
        len(training_set.data.classes),
        settings.hidden,
        generator=torch.Generator().manual_seed(job.seed),
    )
    pixels = training_set.pixels(job.camera.light)
    matrix = training_set.matrix(settings.start, job.masks, job.seed) if keep is None else keep
    start = torch.from_numpy(matrix).float()
    masks = LearnedMasks(start[:, pixels].unsqueeze(0), job.camera.light, job.camera.rails)
    groups = [
        {"params": list(network.parameters()), "lr": settings.lr},
        {"params": list(masks.parameters()), "lr": settings.mask_lr if keep is None else 0.0},
    ]
    cells = job.optics.detector_map(training_set.data.image_shape)
    detection = Detection.by(cells, job.optics.readout)
    x, count = (
        training_set.centred(pixels, torch.float32, detection),
        len(training_set.labels),
    )
    batch = min(settings.batch or min(max(count // 100, 32), 500), count)
    steps = count // batch
    optimiser = torch.optim.AdamW(groups, weight_decay=settings.decay, fused=True)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, [group["lr"] for group in groups], total_steps=settings.epochs * steps
    )
    for _ in range(settings.epochs):
        order = torch.randperm(count, generator=main)[: steps * batch].view(steps, batch)
        for rows in order:
            # drawn for every estimator, so that all see the scenes in the same order
            epsilon = torch.randn(batch, 1, job.masks, generator=main)
            chosen = x.index_select(0, functional.pad(rows, (0, 1), value=count))
            labels = training_set.labels[rows]
            if estimator is None:
                rails = masks().difference if masks.disjoint else masks().combined
                features = ml_gauss_features(chosen, rails, epsilon * gain**-0.5, masks.disjoint)
                size = torch.linalg.vector_norm(features) / features.numel() ** 0.5
                scaled = features.squeeze(1) / size
                functional.cross_entropy(network(scaled), labels).backward()
            else:
                rails = masks().stacked[0]
                products = gain * project(chosen, rails)
                rates = (products[:-1] + products[-1]).clamp(min=0)
                centre = products[-1, 0] - products[-1, 1]
                signal = products[:-1, 0] - products[:-1, 1]
                size = (signal.square() + rates.sum(dim=1)).mean().sqrt()
                descend(network, rates, centre, size, labels, estimator, second)
            optimiser.step()
            optimiser.zero_grad(set_to_none=True)
            schedule.step()
    network.generator = None
    return finish(training_set, job, masks, network.eval())


def finish(training_set: TrainingSet, job: Job, masks: LearnedMasks, network: Mlp) -> Design:
    """The design as the package would store it: masks of all pixels, statistics of all scenes."""
    with torch.no_grad():
        rails = torch.zeros(2, job.masks, training_set.data.pixels)
        rails[..., training_set.pixels(job.camera.light)] = masks().stacked[0]
        plus, minus = project(training_set.full, rails).unbind(dim=1)
        counts = (plus + minus).mean(dim=0)
        power = (plus - minus).var(dim=0, correction=0) + counts * (
            training_set.summed_reflectance / job.photons
        )
        exposure = MaskExposure(
            entry=FixedEntry(),
            rails=Rails.of(light_law(job.camera.light).check(rails)),
            light=job.camera.light,
            image_shape=training_set.data.image_shape,
            detection=Detection(),
            summed_reflectance=training_set.summed_reflectance,
            mean=(plus - minus).mean(dim=0) / training_set.summed_reflectance,
            std=power.mean().sqrt().expand(job.masks) / training_set.summed_reflectance,
            shares=counts / training_set.summed_reflectance,
        )
        return Design(job.design, training_set.data.classes, exposure, network)


@dataclass
class Trial:
    """One training and its accuracy, a row of the CSV file."""

    photons: float
    masks: int
    estimator: str
    lr: float
    mask_lr: float
    epochs: int
    seed: int
    part: str
    accuracy: float
    seconds: float


class Study:
    """Trainings on some scenes; validated on held-out scenes to choose, tested once to report."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        whole = load_dataset(arguments.data)
        held = whole.hold_out()
        images = min(arguments.images, len(held.x_train))
        held = replace(held, x_train=held.x_train[:images], y_train=held.y_train[:images])
        tested = replace(held, x_test=whole.x_test, y_test=whole.y_test)
        self.parts = {"validation": held, "test": tested}
        self.training_set = TrainingSet(held, "cpu")
        self.arguments = arguments
        self.trials: list[Trial] = []

    def trial(
        self,
        photons: float,
        masks: int,
        name: str,
        rates: tuple[float, float],
        seed: int,
        part: str,
    ) -> Trial:
        """Train once and classify the scenes of a part."""
        longer = self.arguments.longer if name == LONGER else 1
        lr, mask_lr = rates
        settings = Training(
            epochs=self.arguments.epochs * longer, lr=lr, mask_lr=mask_lr, precision="float32"
        )
        job = Job(masks=masks, photons=photons, camera="paper", seed=seed, training=settings)
        began = time.perf_counter()
        design = learn(self.training_set, job, ESTIMATORS.get(name))
        if name in (RETRAINED, TWICE):
            again = straight if name == RETRAINED else None
            design = learn(self.training_set, job, again, keep=design.matrix)
        seconds = time.perf_counter() - began
        (result,) = evaluate(design, self.parts[part], photons, seed=seed)
        done = Trial(
            photons, masks, name, lr, mask_lr, settings.epochs, seed, part, result.accuracy, seconds
        )
        self.trials.append(done)
        if self.arguments.csv:
            self.write()
        print(
            f"{photons:6g} photons {masks:3d} masks {name:16} lr {lr:g} {mask_lr:g} seed {seed:3d} "
            f"{part:10} {done.accuracy:.4f} {seconds:6.1f} s",
            file=sys.stderr,
        )
        return done

    def write(self) -> None:
        """Write all trials so far."""
        with self.arguments.csv.open("w", newline="") as file:
            writer = csv.DictWriter(file, [field.name for field in fields(Trial)])
            writer.writeheader()
            writer.writerows(asdict(trial) for trial in self.trials)

    def choose(self, photons: float, masks: int, name: str) -> tuple[float, float]:
        """Learning rates of the grid that validate best."""
        grid, seeds = self.arguments.grid, self.arguments.choice_seeds
        if len(grid) == 1:
            return grid[0]
        accuracy = [
            sum(
                self.trial(photons, masks, name, rates, CHOICE_SEED + k, "validation").accuracy
                for k in range(seeds)
            )
            for rates in grid
        ]
        return grid[int(np.argmax(accuracy))]

    def cell(self, photons: float, masks: int) -> None:
        """Every estimator at one budget and number of masks, as rows of the table."""
        chosen, results = {}, {}
        for name in self.arguments.estimators:
            chosen[name] = self.choose(photons, masks, name)
        for control in self.arguments.controls:
            chosen[control] = chosen[REFERENCE]
        for name, rates in chosen.items():
            results[name] = [
                self.trial(photons, masks, name, rates, seed, "test")
                for seed in range(self.arguments.seeds)
            ]
        reference = np.array([trial.accuracy for trial in results[REFERENCE]])
        for name, trials in results.items():
            accuracy = np.array([trial.accuracy for trial in trials])
            seconds = statistics.median(trial.seconds for trial in trials)
            print(
                f"| {photons:g} | {masks} | {name} | {chosen[name][0]:g}, {chosen[name][1]:g} | "
                f"{interval(accuracy, '.4f')} | "
                f"{interval(accuracy - reference, '+.4f') if name != REFERENCE else ''} | "
                f"{seconds:.1f} |",
                flush=True,
            )


def interval(values: np.ndarray, style: str) -> str:
    """Mean and half of Student's 95 % interval."""
    half = stats.t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / len(values) ** 0.5
    return f"{values.mean():{style}} ± {half:.4f}"


def rates_of(text: str) -> tuple[float, float]:
    lr, mask_lr = text.split(":")
    return float(lr), float(mask_lr)


def main(given: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--photons", type=float, nargs="+", default=[30, 100, 300, 1000])
    parser.add_argument("--masks", type=int, nargs="+", default=[10, 41])
    parser.add_argument("--estimators", nargs="+", choices=ESTIMATORS, default=list(ESTIMATORS))
    parser.add_argument("--seeds", type=int, default=5, help="of the result")
    parser.add_argument("--choice-seeds", type=int, default=1, help="to choose learning rates")
    parser.add_argument("--images", type=int, default=20_000, help="to train on, at most")
    parser.add_argument("--epochs", type=int, default=8)
    parser.add_argument(
        "--grid", type=rates_of, nargs="+", default=GRID, help="LR:MASK_LR; only one: no choice"
    )
    parser.add_argument("--controls", nargs="*", choices=CONTROLS, default=CONTROLS)
    parser.add_argument("--longer", type=int, default=3, help="times the epochs")
    parser.add_argument("--csv", type=Path, help="file for every training's accuracy")
    parser.add_argument("--quick", action="store_true", help="a moment's run that proves nothing")
    arguments = parser.parse_args(given)
    if REFERENCE not in arguments.estimators or arguments.seeds < 2:
        parser.error(f"differences need {REFERENCE} and at least two seeds")
    if arguments.quick:
        arguments.photons, arguments.masks, arguments.seeds = [100], [6], 2
        arguments.images, arguments.epochs, arguments.grid = 500, 2, GRID[:2]

    torch.set_num_threads(1)
    study = Study(arguments)
    print(
        f"{arguments.data}, {len(study.training_set.labels)} scenes, {arguments.epochs} epochs, "
        f"{arguments.seeds} seeds, torch {torch.__version__}\n"
    )
    print("| photons | masks | estimator | lr, mask lr | accuracy | less ml_gauss | seconds |")
    print("| --- | --- | --- | --- | --- | --- | --- |", flush=True)
    for photons, masks in itertools.product(arguments.photons, arguments.masks):
        study.cell(photons, masks)


if __name__ == "__main__":
    main()
