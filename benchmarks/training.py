"""Time an epoch of DeepFSI against a plain PyTorch script, side by side on the same work.

    python benchmarks/training.py                        # 92 and 1024 masks, bfloat16 and float32
    python benchmarks/training.py --masks 92 --rounds 5

Plain is what a user would write: a DataLoader over the tensors, two rails as two products and two
noise draws, the loss read each step. Both have the same scenes, batch, epochs, optimiser, schedule,
start, constraint and noise. The two train in turn, and the ratio is of the medians of their epochs;
the bare products are the four matrix products of a step alone, forward and backward. Accuracies are
under exact Poisson noise, after --epochs epochs of each.
"""

import argparse
import statistics
import time

import numpy as np
import torch
from torch import nn
from torch.utils.data import DataLoader, TensorDataset

from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import load_dataset
from deepfsi.evaluation.accuracy import evaluate
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs.job import Job
from deepfsi.jobs.training import Training
from deepfsi.training.learning import train
from moments import Moments

BUDGET, BATCH, LR, MASK_LR = 1e4, 500, 5e-3, 5e-2


class Plain(nn.Module):
    """Masks and classifier as a user would write them."""

    def __init__(self, start: np.ndarray, light: float) -> None:
        super().__init__()
        start = start / np.abs(start).sum(axis=0).max()
        self.unit = float(np.sqrt(np.mean(start**2)))
        self.masks = nn.Parameter(torch.tensor(start / self.unit, dtype=torch.float32))
        self.light = light
        self.network = nn.Sequential(
            nn.BatchNorm1d(len(start), affine=False),
            nn.Linear(len(start), 40),
            nn.ReLU(),
            nn.Linear(40, 128),
            nn.ReLU(),
            nn.Linear(128, 10),
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Logits of scenes (B, N)."""
        matrix = self.masks * self.unit
        matrix = matrix / matrix.abs().sum(dim=0).clamp(min=1)
        photons = x * (BUDGET / self.light)
        plus = photons @ matrix.clamp(min=0).T
        minus = photons @ (-matrix).clamp(min=0).T
        if self.training:
            plus = plus + torch.sqrt(plus + 1e-6) * torch.randn_like(plus)
            minus = minus + torch.sqrt(minus + 1e-6) * torch.randn_like(minus)
        else:
            plus, minus = torch.poisson(plus), torch.poisson(minus)
        return self.network(plus - minus)


def plain_epochs(
    data: Dataset, start: np.ndarray, light: float, epochs: int
) -> tuple[list[float], float]:
    """Seconds of each epoch, and test accuracy."""
    torch.manual_seed(0)
    model = Plain(start, light)
    loader = DataLoader(
        TensorDataset(torch.from_numpy(data.x_train), torch.from_numpy(data.y_train)),
        batch_size=BATCH,
        shuffle=True,
    )
    optimiser = torch.optim.Adam(
        [
            {"params": [model.masks], "lr": MASK_LR},
            {"params": model.network.parameters(), "lr": LR},
        ]
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, [MASK_LR, LR], total_steps=epochs * len(loader)
    )
    seconds = []
    for _ in range(epochs):
        began = time.perf_counter()
        running = 0.0
        for x, y in loader:
            loss = nn.functional.cross_entropy(model(x), y)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            running += loss.item()
        seconds.append(time.perf_counter() - began)
    model.eval()
    with torch.no_grad():
        guess = model(torch.from_numpy(data.x_test)).argmax(dim=1).numpy()
    return seconds, float((guess == data.y_test).mean())


def our_epochs(
    training_set: TrainingSet, data: Dataset, masks: int, epochs: int, precision: str
) -> tuple[list[float], float]:
    """Seconds of each epoch, and test accuracy."""
    settings = Training(epochs=epochs, batch=BATCH, lr=LR, mask_lr=MASK_LR, precision=precision)
    moments = Moments()
    job = Job(masks=masks, photons=BUDGET, camera="paper", training=settings)
    design = train(training_set, [job], report=moments.report)[0]
    seconds = moments.epochs(epochs)
    return seconds, evaluate(design, data, BUDGET, draws=1)[0].accuracy


def bare_products(count: int, masks: int, precision: str) -> float:
    """Seconds of an epoch's matrix products alone: two forward and two backward a step."""
    kind = getattr(torch, precision)
    x = torch.rand(BATCH, 1024).to(kind)
    both = torch.rand(2 * masks, 1024).to(kind)
    back = torch.rand(BATCH, 2 * masks).to(kind)
    steps = count // BATCH
    for _ in range(steps // 4):
        _ = x @ both.T, back.T @ x
    began = time.perf_counter()
    for _ in range(steps):
        _ = x @ both.T, back.T @ x
    return time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--masks", type=int, nargs="+", default=[92, 1024])
    parser.add_argument("--precision", nargs="+", default=["bfloat16", "float32"])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--epochs", type=int, default=3, help="of each round")
    arguments = parser.parse_args()

    data = load_dataset(arguments.data)
    training_set = TrainingSet(data, "cpu")
    print(
        f"{data.name}, {len(data.x_train)} scenes of {data.pixels} pixels, batch {BATCH}, ", end=""
    )
    print(f"{BUDGET:g} photons, {torch.get_num_threads()} threads, torch {torch.__version__}")
    print(f"{'masks':>5} {'products':>9} {'plain s/epoch':>14} {'ours':>7} {'ratio':>6} ", end="")
    print(f"{'bare':>7} {'share':>6}  accuracy plain, ours")
    for masks in arguments.masks:
        start = training_set.matrix("pca", masks, 0)
        for precision in arguments.precision:
            our_epochs(training_set, data, masks, 1, precision)
            times: dict[str, list[float]] = {"plain": [], "ours": [], "bare": []}
            for _ in range(arguments.rounds):
                seconds, plain = plain_epochs(
                    data, start, training_set.summed_reflectance, arguments.epochs
                )
                times["plain"] += seconds
                seconds, ours = our_epochs(training_set, data, masks, arguments.epochs, precision)
                times["ours"] += seconds
                times["bare"].append(bare_products(len(data.x_train), masks, precision))
            medians = {name: statistics.median(values) for name, values in times.items()}
            print(
                f"{masks:5d} {precision:>9} {medians['plain']:14.3f} {medians['ours']:7.3f} "
                f"{medians['plain'] / medians['ours']:6.2f} {medians['bare']:7.3f} "
                f"{medians['bare'] / medians['ours']:6.0%}  {plain:.4f}, {ours:.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
