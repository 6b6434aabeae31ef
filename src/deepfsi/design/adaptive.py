"""Exposures that look several times: what was counted decides how long each mask is shown next.

One device shows the same masks in every look, each for its own share of the time (`free-dwell`).
In the first look these *dwells* are the same for all scenes; a small network then chooses those of
each further look from the counts so far. Masks that would tell what is already known get hardly
any time. Counts n of a look are Poisson counts given those before it, and its dwells d depend on
these alone, so that the likelihood of a mask's rate r is a constant times r^Σn · e^(−rΣd): sums
over the looks hold all that they say of the scene, and are what both networks are shown.

The classifier learns to answer after every look, so that an exposure may end when it is sure.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np
import torch
from pydantic import Field
from pydantic.dataclasses import dataclass as validated
from torch import Tensor

from deepfsi.design.classifiers import Mlp, restored
from deepfsi.design.exposure import STRICT, Exposure, ExposureKind, Read, Show
from deepfsi.errors import InputError
from deepfsi.optics import constraints
from deepfsi.optics.constraints import Light

LARGEST_SCORE = 4.0
"""Bound of the scores whose softmax dwells are: the longest is e⁸ times the shortest at most.

A mask that is never shown is never learned, and the scores would not come back from there.
"""


def expose(
    choose: Callable[[Tensor], Tensor], show: Show, looks: int, mean: Tensor, std: Tensor
) -> Iterator[Exposure]:
    """Exposures after each look: one loop for training, tests and a camera, for one or many.

    Parameters
    ----------
    choose : callable
        Network from (..., 2 m + 1), the inputs of the classifier so far and the share of the
        exposure that is left, to scores (..., m): dwells of the next look are their softmax.
    show : callable
        Shows the masks for given shares of the exposure; returns counts over the budget, and the
        shares that it did show.
    looks : int
        K, each 1 / K of the exposure.
    mean, std : tensor, shape (..., m)
        As for `Exposure.inputs`, with the leading axes of the exposures.
    """
    features = total = torch.zeros_like(mean)
    seen = Exposure(features, total)
    for look in range(looks):
        left = torch.full_like(total[..., :1], 1 - look / looks)
        scores = choose(torch.cat([seen.inputs(mean, std), left], dim=-1))
        dwell = (LARGEST_SCORE * torch.tanh(scores / LARGEST_SCORE)).softmax(dim=-1) / looks
        counts, shown = show(dwell)
        features, total = features + counts, total + shown
        seen = Exposure(features, total)
        yield seen


@dataclass(frozen=True)
class AdaptiveDwells(ExposureKind):
    """Exposure of several looks, whose dwells a network chooses from the counts so far.

    The masks' rails, and the statistics of their features, are those of equal dwells, 1 / m.

    Attributes
    ----------
    network : Mlp
        From 2 m + 1 inputs to m outputs.
    looks : int
        K.
    """

    network: Mlp
    looks: int
    kind = "adaptive"

    def header(self) -> "AdaptiveShape":
        """Entry of the design file's header, of which `restored` makes the kind again."""
        return AdaptiveShape(self.looks, self.network.hidden)

    def to(self, device: str | torch.device) -> "AdaptiveDwells":
        """The kind on a device."""
        return replace(self, network=self.network.to(device))

    def check(self, rails: Tensor, light: Light, image_shape: tuple[int, ...]) -> None:
        """Raise `ValueError` unless rails can be exposed so; parameters as for `Design`."""
        equal = constraints.excess(rails, "equal-dwell") < constraints.SLACK
        if not (equal and light == "free-dwell" and len(rails) == 1):
            raise ValueError("dwells are chosen for frames of one device that all have the same")

    def input_count(self, masks: int) -> int:
        """Number of the classifier's inputs: features and dwells."""
        return 2 * masks

    def expose(
        self, read: Read, rates: Tensor, photons: float, mean: Tensor, std: Tensor
    ) -> Iterator[Exposure]:
        """Exposures after each look, parameters as for `ExposureKind.expose`."""

        def show(dwell: Tensor) -> tuple[Tensor, Tensor]:
            shown = rates * (photons * rates.shape[-1] * dwell.unsqueeze(-2))
            return read(shown) / photons, dwell

        return self.expose_live(show, mean.expand(*rates.shape[:-2], -1), std)

    def expose_live(self, show: Show, mean: Tensor, std: Tensor) -> Iterator[Exposure]:
        """Exposures after each look at a camera, parameters as for `ExposureKind.expose`."""
        return expose(self.network, show, self.looks, mean, std)

    def stops(self, rails: Tensor, light: Light) -> tuple[tuple[int, ...], np.ndarray]:
        """Numbers of looks after which an exposure may stop, and the share taken then."""
        after = range(1, self.looks + 1)
        return tuple(after), np.array(after) / self.looks

    def check_fixed(self) -> None:
        """Raise `InputError`: dwells are not fixed."""
        raise InputError(
            "this design chooses dwells while the exposure runs, which a fixed sequence of "
            "patterns or one graph cannot: use Design.classify_live in a program of yours"
        )

    def check_noise(self, noise: str) -> None:
        """Raise `InputError` unless the noise is that of photons."""
        if noise not in ("poisson", "ml_gauss", "none"):
            raise InputError(
                "a design of several looks is for photon noise: use poisson, ml_gauss or none"
            )

    def check_dwell(self, given: bool) -> None:
        """Raise `InputError` if dwells are not given."""
        if not given:
            raise InputError(
                "dwells go with a design that chooses them, and only with it: give dwell, or use "
                "`classify_live`"
            )


@validated(frozen=True, config=STRICT)
class AdaptiveShape:
    """Entry of a design file's header for `AdaptiveDwells`: looks, and widths of its network."""

    looks: Annotated[int, Field(ge=2, le=64)]
    hidden: tuple[Annotated[int, Field(ge=1)], ...]
    kind: Literal["adaptive"] = field(default="adaptive", kw_only=True)

    def restored(self, weights: dict[str, Tensor], masks: int) -> AdaptiveDwells:
        """The exposure of m masks, with its network's weights from a design file."""
        sizes = {"inputs": 2 * masks + 1, "classes": masks, "hidden": self.hidden}
        return AdaptiveDwells(restored(Mlp, weights, **sizes), self.looks)
