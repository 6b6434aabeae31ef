"""Time the training of OViT against a plain PyTorch script, in turn on the same work.

    python benchmarks/ovit.py                                       # the transformer of ovit.toml
    python benchmarks/ovit.py --recipe ovit-full --images 45000 --rounds 2    # on a GPU

Plain is what a user would write: a DataLoader over whole images, which the model cuts in patches
in every step, two rails as two products and two noise draws, and the loss read in each step. Both
train the same masks and the same transformer, from the same start, on random images, with the same
batch, optimiser and schedule. Theirs is float32; ours has the package's own rule (bfloat16 for the
transformer on a GPU, where it stays under the photon noise). Ratios are of medians over epochs.
"""

import argparse
import statistics
import time
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, TensorDataset

from deepfsi.base.progress import Progress
from deepfsi.datasets.arrays import from_arrays
from deepfsi.datasets.dataset import Dataset
from deepfsi.exposure.training_set import TrainingSet, network_dtype
from deepfsi.jobs.designs import sensing_matrix
from deepfsi.jobs.job import Job
from deepfsi.training.learning import train
from deepfsi_paper.patches.settings import Patches
from deepfsi_paper.patches.transformer import Vit
from deepfsi_paper.studies import find
from moments import Moments

BUDGET, CLASSES = 1e4, 10


class Plain(nn.Module):
    """Masks and transformer as a user would write them."""

    def __init__(self, job: Job, data: Dataset, light: float) -> None:
        super().__init__()
        start = sensing_matrix("pca", job.masks, job.exposure.view(data))
        start = start / np.abs(start).sum(axis=0).max()
        self.unit = float(np.sqrt(np.mean(start**2)))
        self.masks = nn.Parameter(torch.tensor(start / self.unit, dtype=torch.float32))
        self.side, self.shape, self.light = job.exposure.patch, data.image_shape, light
        tokens = data.pixels // self.side**2
        self.norm = nn.BatchNorm1d(1, affine=False)
        self.vit = Vit(job.masks, tokens, CLASSES, **job.training.classifier_arguments)

    def forward(self, x: Tensor) -> Tensor:
        """Logits of images (B, H · W)."""
        matrix = self.masks * self.unit
        matrix = matrix / matrix.abs().sum(dim=0).clamp(min=1)
        images = (x * (BUDGET / self.light)).view(-1, 1, *self.shape)
        photons = nn.functional.unfold(images, self.side, stride=self.side).transpose(1, 2)
        plus = photons @ matrix.clamp(min=0).T
        minus = photons @ (-matrix).clamp(min=0).T
        plus = plus + torch.sqrt(plus + 1e-6) * torch.randn_like(plus)
        minus = minus + torch.sqrt(minus + 1e-6) * torch.randn_like(minus)
        counts = plus - minus
        centred = counts - counts.mean(dim=(0, 1))
        return self.vit(self.norm(centred.reshape(-1, 1)).view_as(counts))


def plain_epochs(scenes: TrainingSet, job: Job) -> list[float]:
    """Seconds of each epoch."""
    torch.manual_seed(0)
    data, settings = scenes.data, job.training
    model = Plain(job, data, scenes.summed_reflectance).to(scenes.device)
    images = TensorDataset(torch.from_numpy(data.x_train), torch.from_numpy(data.y_train))
    loader = DataLoader(images, batch_size=settings.batch, shuffle=True, drop_last=True)
    optimiser = torch.optim.AdamW(
        [
            {"params": [model.masks], "lr": settings.mask_lr, "weight_decay": 0.0},
            {"params": model.vit.parameters(), "lr": settings.lr, "weight_decay": settings.decay},
        ]
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, [settings.mask_lr, settings.lr], total_steps=settings.epochs * len(loader)
    )
    seconds = []
    for _ in range(settings.epochs):
        began = time.perf_counter()
        running = 0.0
        for x, y in loader:
            logits = model(x.to(scenes.device))
            loss = nn.functional.cross_entropy(logits, y.to(scenes.device))
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            running += loss.item()
        seconds.append(time.perf_counter() - began)
    return seconds


def our_epochs(scenes: TrainingSet, job: Job) -> list[float]:
    """Seconds of each epoch."""
    moments = Moments()

    def tick(share: float, what: str) -> None:
        if scenes.device.type == "cuda":
            torch.cuda.synchronize()
        moments.report(share, what)

    train(scenes, [job], report=Progress(tick))
    return moments.epochs(job.training.epochs)


def main(given: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recipe", default="ovit", help="ovit or ovit-full")
    parser.add_argument("--images", type=int, default=2000)
    parser.add_argument("--size", type=int, default=64, help="side of the images")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--epochs", type=int, default=2, help="of each round")
    parser.add_argument("--device", default="auto")
    arguments = parser.parse_args(given)

    recipe = find(arguments.recipe)[0].recipes(quick=False)[arguments.recipe]
    _, settings = next(recipe.trainings("deepfsi"))
    _, exposure = next(recipe.exposures("deepfsi"))
    rng = np.random.default_rng(0)
    x = rng.random((arguments.images, arguments.size, arguments.size), dtype=np.float32)
    data = from_arrays(x, np.arange(len(x)) % CLASSES, x[:CLASSES], np.arange(CLASSES))

    def job(epochs: int) -> Job:
        return Job(
            masks=exposure.patch**2,
            photons=BUDGET,
            camera="paper",
            exposure=Patches(patch=exposure.patch),
            training={**settings, "epochs": epochs},
        )

    scenes, timed, short = TrainingSet(data, arguments.device), job(arguments.epochs), job(1)
    batch, kind = timed.training.batch, network_dtype(timed, scenes.device)
    sizes = timed.training.classifier_arguments
    print(
        f"{len(x)} random images of {arguments.size}x{arguments.size}, batch {batch}, "
        f"width {sizes['width']}, depth {sizes['depth']}; {scenes.device.type}, "
        f"{torch.get_num_threads()} threads, ours {kind}, torch {torch.__version__}"
    )
    plain_epochs(scenes, short)
    our_epochs(scenes, short)
    times: dict[str, list[float]] = {"plain": [], "ours": []}
    for _ in range(arguments.rounds):
        times["plain"] += plain_epochs(scenes, timed)
        times["ours"] += our_epochs(scenes, timed)
    medians = {name: statistics.median(seconds) for name, seconds in times.items()}
    seen = len(x) // batch * batch
    for name, seconds in medians.items():
        whole = settings["epochs"] * 50_000 * seconds / seen / 60
        print(
            f"{name:5s} {seen / seconds:9.0f} images/s, {seconds:.3f} s an epoch (least "
            f"{min(times[name]):.3f}); {settings['epochs']} epochs of 50 000 images: "
            f"{whole:.1f} min"
        )
    print(f"ratio {medians['plain'] / medians['ours']:.2f}")


if __name__ == "__main__":
    main()
