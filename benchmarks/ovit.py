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
from deepfsi.training.patches import Patches, PatchJob, PatchTraining, precision, train
from torch import Tensor, nn
from torch.utils.data import DataLoader, TensorDataset

from deepfsi.datasets import from_arrays
from deepfsi.design.classifiers import Vit
from deepfsi.progress import Moments, Report
from deepfsi_paper.studies import find

BUDGET, CLASSES = 1e4, 10


class Plain(nn.Module):
    """Masks and transformer as a user would write them."""

    def __init__(self, patches: Patches, settings: PatchTraining) -> None:
        super().__init__()
        start = patches.matrix("pca")
        start = start / np.abs(start).sum(axis=0).max()
        self.unit = float(np.sqrt(np.mean(start**2)))
        self.masks = nn.Parameter(torch.tensor(start / self.unit, dtype=torch.float32))
        self.side, self.shape = patches.side, patches.data.image_shape
        self.light = patches.summed_reflectance
        tokens, pixels = patches.x.shape[1:]
        self.norm = nn.BatchNorm1d(1, affine=False)
        self.vit = Vit(
            pixels, tokens, CLASSES, settings.width, settings.depth, settings.heads, settings.hidden
        )

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


def plain_epochs(patches: Patches, settings: PatchTraining) -> list[float]:
    """Seconds of each epoch."""
    torch.manual_seed(0)
    model = Plain(patches, settings).to(patches.device)
    data = patches.data
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
            logits = model(x.to(patches.device))
            loss = nn.functional.cross_entropy(logits, y.to(patches.device))
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            running += loss.item()
        seconds.append(time.perf_counter() - began)
    return seconds


def our_epochs(patches: Patches, settings: PatchTraining) -> list[float]:
    """Seconds of each epoch."""
    moments = Moments()

    def tick(share: float, what: str) -> None:
        if patches.device.type == "cuda":
            torch.cuda.synchronize()
        moments.report(share, what)

    train(patches, PatchJob(photons=BUDGET, patch=patches.side, training=settings), Report(tick))
    return moments.epochs(settings.epochs)


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
    settings = recipe.training.model_copy(update={"epochs": arguments.epochs})
    rng = np.random.default_rng(0)
    x = rng.random((arguments.images, arguments.size, arguments.size), dtype=np.float32)
    data = from_arrays(x, np.arange(len(x)) % CLASSES, x[:CLASSES], np.arange(CLASSES))
    patches = Patches(data, recipe.patch, arguments.device)
    kind = precision(PatchJob(photons=BUDGET, training=settings), patches)
    print(
        f"{len(x)} random images of {arguments.size}x{arguments.size}, batch {settings.batch}, "
        f"width {settings.width}, depth {settings.depth}; {patches.device.type}, "
        f"{torch.get_num_threads()} threads, ours {kind}, torch {torch.__version__}"
    )
    short = settings.model_copy(update={"epochs": 1})
    plain_epochs(patches, short)
    our_epochs(patches, short)
    times: dict[str, list[float]] = {"plain": [], "ours": []}
    for _ in range(arguments.rounds):
        times["plain"] += plain_epochs(patches, settings)
        times["ours"] += our_epochs(patches, settings)
    medians = {name: statistics.median(seconds) for name, seconds in times.items()}
    seen = len(x) // settings.batch * settings.batch
    for name, seconds in medians.items():
        whole = recipe.training.epochs * 50_000 * seconds / seen / 60
        print(
            f"{name:5s} {seen / seconds:9.0f} images/s, {seconds:.3f} s an epoch (least "
            f"{min(times[name]):.3f}); {recipe.training.epochs} epochs of 50 000 images: "
            f"{whole:.1f} min"
        )
    print(f"ratio {medians['plain'] / medians['ours']:.2f}")


if __name__ == "__main__":
    main()
