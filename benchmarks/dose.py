"""Impulse imaging under the best fixed distribution of light: a bound for the light law `dose`.

    python benchmarks/dose.py                           # MNIST on black, a dose of 250 photons
    python benchmarks/dose.py --epochs 1 --data digits

Under `dose` any masks are a random routing of the counts of such an imaging, so that what can be
told from these bounds them. A small convolutional network and the light of each pixel are trained
together on exact counts, drawn anew in every step, and tested once through the package: as a design
of one mask for each pixel that is lit by itself. Its accuracy is a lower estimate of the bound.
"""

import argparse

import torch
from torch import nn
from torch.nn import functional

from deepfsi import Scanner, design_of, evaluate, load_dataset
from deepfsi.camera.light import photons_per_pixel, summed_reflectance


class Crop(nn.Module):
    """Scenes of pixels side by side as pictures (batch, 1, side, side), less a dark margin."""

    def __init__(self, side: int, margin: int) -> None:
        super().__init__()
        self.side, self.margin = side, margin

    def forward(self, counts: torch.Tensor) -> torch.Tensor:
        """Pictures of counts (batch, N)."""
        rows = slice(self.margin, self.side - self.margin)
        return counts.view(-1, 1, self.side, self.side)[..., rows, rows]


def network(side: int, margin: int, classes: int) -> nn.Sequential:
    """From the counts of all pixels to logits."""
    return nn.Sequential(
        Crop(side, margin),
        nn.Conv2d(1, 24, 5, 2, 2),
        nn.ReLU(),
        nn.Conv2d(24, 48, 5, 2, 2),
        nn.ReLU(),
        nn.Flatten(),
        nn.Dropout(0.2),
        nn.Linear(48 * (-(-(side - 2 * margin) // 4)) ** 2, 160),
        nn.ReLU(),
        nn.Linear(160, classes),
    )


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--dose", type=float, default=250.0, help="photons on the scene")
    parser.add_argument("--epochs", type=int, default=18)
    parser.add_argument("--batch", type=int, default=250)
    parser.add_argument("--hold-out", type=int, default=0, help="test on these training scenes")
    parser.add_argument("--out", help="design file")
    arguments = parser.parse_args(words)

    data = load_dataset(arguments.data, rescale=(0.0, 1.0))
    data = data.hold_out(arguments.hold_out) if arguments.hold_out else data
    side, reflectance = data.image_shape[0], summed_reflectance(data.x_train)
    margin = side // 8
    photons = arguments.dose * reflectance / data.pixels
    x, y = torch.from_numpy(data.x_train), torch.from_numpy(data.y_train)

    torch.manual_seed(0)
    light = torch.zeros(side - 2 * margin, side - 2 * margin, requires_grad=True)
    net = network(side, margin, len(data.classes))

    def shares() -> torch.Tensor:
        """Light of each pixel (N,) over the mean, which is 1."""
        lit = light.flatten().softmax(dim=0).view_as(light) * data.pixels
        return functional.pad(lit, [margin] * 4).flatten()

    steps = len(x) // arguments.batch
    optimiser = torch.optim.Adam([{"params": net.parameters()}, {"params": [light]}])
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, [3e-3, 15e-3], total_steps=arguments.epochs * steps
    )
    for _ in range(arguments.epochs):
        for rows in torch.randperm(len(x))[: steps * arguments.batch].view(steps, -1):
            rates = photons_per_pixel(x[rows], photons, reflectance) * shares()
            counts = torch.poisson(rates.detach()) + rates - rates.detach()  # straight through
            functional.cross_entropy(net(counts), y[rows]).backward()
            optimiser.step()
            optimiser.zero_grad(set_to_none=True)
            schedule.step()

    masks = torch.diag(shares().detach())
    scanner = Scanner.from_rails(masks[None], "poisson")
    design = design_of(scanner, net.eval(), data, photons=photons, light="dose")
    if arguments.out:
        design.save(arguments.out)
    (result,) = evaluate(design, data, photons)
    print("| dose | budget Φ | counts | accuracy | 95 % interval |")
    print("| --- | --- | --- | --- | --- |")
    print(
        f"| {arguments.dose:g} | {photons:.4g} | {result.counts:.4g} | {result.accuracy:.4f} | "
        f"{result.low:.4f} to {result.high:.4f} |"
    )


if __name__ == "__main__":
    main()
