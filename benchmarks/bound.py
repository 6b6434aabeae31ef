"""A larger classifier on impulse imaging: a bound for designs, and its tightness.

    python benchmarks/bound.py                          # MNIST, 1e2 to 1e5 photons
    python benchmarks/bound.py --epochs 1 --photons 1e4

Any `column` design is a random routing of impulse imaging's counts, so that what can be told from
these bounds it. A small convolutional network is trained on exact counts of all pixels, drawn anew
in every step, chosen by nothing, and tested once; its accuracy is a lower estimate of the bound.
"""

import argparse

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from deepfsi import load_dataset
from deepfsi.base.intervals import wilson
from deepfsi.camera.light import photons_per_pixel, summed_reflectance


def network(side: int, classes: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(1, 24, 5, stride=2, padding=2),
        nn.ReLU(),
        nn.Conv2d(24, 48, 3, stride=2, padding=1),
        nn.ReLU(),
        nn.Flatten(),
        nn.Linear(48 * (-(-side // 4)) ** 2, 192),
        nn.ReLU(),
        nn.Linear(192, classes),
    )


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--photons", type=float, nargs="+", default=[1e2, 1e3, 1e4, 1e5])
    parser.add_argument("--epochs", type=int, default=12)
    parser.add_argument("--batch", type=int, default=250)
    arguments = parser.parse_args(words)

    data = load_dataset(arguments.data)
    side, reflectance = data.image_shape[0], summed_reflectance(data.x_train)
    x, y = torch.from_numpy(data.x_train), torch.from_numpy(data.y_train)
    steps = len(x) // arguments.batch
    print("| photons | accuracy | 95 % interval, test images |")
    print("| --- | --- | --- |")
    for photons in arguments.photons:
        torch.manual_seed(0)
        net = network(side, len(data.classes))
        unit = float((x[:1000].mean() * photons / reflectance + 1e-12) ** 0.5)

        def counts(scenes: torch.Tensor, photons=photons, unit=unit) -> torch.Tensor:
            rates = photons_per_pixel(scenes, photons, reflectance)
            mean = photons_per_pixel(x.mean(dim=0), photons, reflectance)
            return ((torch.poisson(rates) - mean) / unit).view(-1, 1, side, side)

        optimiser = torch.optim.AdamW(net.parameters())
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, 2e-3, total_steps=arguments.epochs * steps
        )
        for _ in range(arguments.epochs):
            for rows in torch.randperm(len(x))[: steps * arguments.batch].view(steps, -1):
                functional.cross_entropy(net(counts(x[rows])), y[rows]).backward()
                optimiser.step()
                optimiser.zero_grad(set_to_none=True)
                schedule.step()
        with torch.no_grad():
            chunks = torch.from_numpy(data.x_test).split(1000)
            guess = torch.cat([net(counts(chunk)).argmax(dim=1) for chunk in chunks]).numpy()
        accuracy = float(np.mean(guess == data.y_test))
        low, high = wilson(accuracy, len(guess))
        print(f"| {photons:g} | {accuracy:.4f} | {low:.4f} to {high:.4f} |", flush=True)


if __name__ == "__main__":
    main()
