"""Adaptive masks of a dictionary that stays on the device: tables choose an index.

No look is loaded into the device, and none multiplies masks with scenes. Counts n of a look behind
mask p change the log-probability of scene k by n · U[p, k] − V[p, k], with two tables.

Scenes near those of the prior differ from them by a normal e, which `AdaptivePosterior` learns from
look to look. Tables cannot: each look has a negative binomial law of its own. As e is the same in
all looks, they tell less together than apart, and the likelihood of each is taken to a power below
1 (P. Grünwald and T. van Ommen, Bayesian Analysis 12, 1069 (2017), on models that are not right).

Masks are compared by what their counts tell of the class, as in `AdaptivePosterior`. Each decision
compares the next part of the dictionary. The same counts give the same masks.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.adaptive.posterior import (
    LARGEST_SIZE,
    LEAST_LIGHT,
    AdaptivePosterior,
    LookOptics,
    ScenePrior,
)
from deepfsi.base.arrays import check_memory
from deepfsi.base.errors import InputError

COMPARED_SCENES = (16, 32)
"""Least and largest number of scenes drawn from the posterior to compare masks by.

A large prior draws more. A prior with fewer scenes takes all.
"""

SUMMED = 16
"""Scenes of a block. Blocks are drawn by their summed probabilities, then a scene of the block."""

TABLED = 64
"""Masks whose tables are computed at a time."""

POWER = 0.85
"""Power of the likelihood of a look, where scenes lie near those of the prior.

Chosen on training images of MNIST that were left out of the prior.
"""


@dataclass(frozen=True, eq=False)
class _MaskTables:
    """Tables of the counts of a look, for n scenes behind each of P masks."""

    by_count: np.ndarray  # (P, n), U, added to a scene's log-probability for each count
    constant: np.ndarray  # (P, n), V, subtracted from it in each look
    parts: Sequence[np.ndarray]  # indices (p,) of the masks that each decision compares
    scales: Sequence[np.ndarray]  # (n, p)
    noises: Sequence[np.ndarray]  # (p,)
    members: np.ndarray  # (n, C + 1), 1 for the class of a scene, and for all together

    @classmethod
    def of(cls, masks: Tensor, prior: ScenePrior, optics: LookOptics, share: float) -> Self:
        """Tables of masks (P, N) for a share of the exposure."""
        count = len(masks)
        scenes = len(prior)
        needed = 12 * scenes * (count + 2 * TABLED)
        advice = "give fewer scenes, or a smaller `dictionary`"
        check_memory(needed, "the tables of these masks and scenes", advice)
        gain = optics.photons / prior.summed_reflectance * share
        dark = optics.dark_sum * share
        least = LEAST_LIGHT * float(prior.mean.sum())
        weights = prior.members / prior.members.sum()
        mean, components = prior.light(masks)
        nearby = components.square().sum(dim=1) * gain**2 * bool(prior.spread)
        power = POWER if prior.spread else 1.0
        by_count = np.empty((count, scenes), np.float32)
        constant = np.empty_like(by_count)
        # each decision compares one part: about 500 masks, or more where the probabilities of many
        # scenes take longer
        parts = np.array_split(np.arange(count), max(1, round(count / max(500, scenes / 30))))
        scales = [np.empty((scenes, len(part)), np.float32) for part in parts]
        noises = [np.empty(len(part), np.float32) for part in parts]
        for part, scale, noise in zip(parts, scales, noises, strict=True):
            for rows in torch.from_numpy(part).split(TABLED):
                light = torch.addmm(mean[rows, None], components[rows], prior.coefficients.T)
                counts = light.clamp_(min=least).mul_(gain).add_(dark)
                expected = counts @ weights
                variance = nearby[rows]
                size = (expected**2 / variance).clamp(max=LARGEST_SIZE)
                roots = 2 * (counts + 3 / 8).sqrt()
                roots -= (roots @ weights)[:, None]
                places = rows.numpy() - part[0]  # a tensor of one number is no array to NumPy
                scale[:, places] = roots.T.numpy()
                noise[places] = (1 + variance / expected).numpy()
                ratio = counts.div_(expected[:, None])
                # the law of `AdaptivePosterior._take`, with `logs` for its log1p
                logs = ((ratio - 1) * (expected / (expected + size))[:, None]).log1p_()
                by_count[rows] = (ratio.log() - logs).mul_(power).numpy()
                constant[rows] = logs.mul_(power * size[:, None]).numpy()
        members = np.ones((scenes, prior.classes + 1), np.float32)
        members[:, :-1] = functional.one_hot(prior.labels, prior.classes).numpy()
        return cls(by_count, constant, parts, scales=scales, noises=noises, members=members)


@dataclass(eq=False)
class MaskDictionary:
    """Masks among which adaptive masks are chosen."""

    masks: Tensor  # (P, N), of 0 and 1, none twice, none without a mirror that is ON
    _tables: tuple[tuple[Any, ...], _MaskTables] | None = field(default=None, repr=False)

    def __len__(self) -> int:
        """Number of masks, P."""
        return len(self.masks)

    @classmethod
    def drawn(cls, masks: Tensor, count: int, generator: torch.Generator) -> "MaskDictionary":
        """At most `count` different masks, drawn from masks (M, N)."""
        different = torch.unique(masks.bool(), dim=0)
        different = different[different.any(dim=1)]
        order = torch.randperm(len(different), generator=generator)[:count]
        return cls(different[order].float())

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray]) -> "MaskDictionary | None":
        """Dictionary of the arrays of a design file; None where it has none."""
        if "dictionary" not in arrays:
            return None
        bits = np.unpackbits(arrays["dictionary"], axis=1, count=len(arrays["mean"]))
        return cls(torch.from_numpy(bits).float())

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The masks, 8 pixels a byte, as a design file has them."""
        return {"dictionary": np.packbits(self.masks.bool().numpy(), axis=1)}

    def tables(self, prior: ScenePrior, optics: LookOptics, share: float) -> _MaskTables:
        """Tables for scenes and a budget; the last ones are kept."""
        key = prior, optics.photons, optics.dark_sum, share
        if self._tables is None or self._tables[0] != key:
            self._tables = key, _MaskTables.of(self.masks, prior, optics, share)
        return self._tables[1]

    @cached_property
    def _indices(self) -> dict[bytes, int]:
        return {row.tobytes(): index for index, row in enumerate(self.masks.numpy())}

    def indices(self, masks: Tensor) -> list[int]:
        """Indices of masks (b, N) in the dictionary; `KeyError` where it lacks one."""
        return [self._indices[row.tobytes()] for row in masks.numpy()]


class DictionaryPosterior(AdaptivePosterior):
    """Posterior of the scene in b exposures with masks of a dictionary, by tables."""

    def __init__(
        self,
        dictionary: MaskDictionary,
        prior: ScenePrior,
        exposures: int,
        optics: LookOptics,
        share: float,
    ) -> None:
        super().__init__(prior, exposures, optics)
        if optics.arms > 1 or optics.detectors is not None:
            raise InputError(
                "masks of a dictionary are chosen for one detector and one arm: give a camera of "
                "these, or leave `dictionary` out"
            )
        self.dictionary = dictionary
        self.tables = dictionary.tables(prior, optics, share)
        # scenes of the prior for each that is drawn
        drawn = int(np.clip(len(prior) // 1800, *COMPARED_SCENES))
        self._points = np.arange(drawn, dtype=np.float32) / drawn
        self._ones = np.ones(drawn, np.float32)
        self._block = np.ones(SUMMED, np.float32)
        self._running = np.triu(np.ones((SUMMED, SUMMED), np.float32))  # sums of the first scenes
        self._sums = np.zeros((-(-len(prior) // SUMMED), SUMMED), np.float32)
        self._powers = self._sums.reshape(-1)[: len(prior)]
        self._change = np.empty(len(prior), np.float32)

    def next_masks(self, share: float, generator: torch.Generator) -> Tensor:
        """The next masks (b, N); nothing is drawn."""
        part = self._looks % len(self.tables.parts)  # compared in this look
        first = int(self.tables.parts[part][0])
        indices = [
            first + int(self._odds(logs, part).argmax()) for logs in self.log_weights.numpy()
        ]
        # a slice of one takes a fifth of the time of an index
        single = len(indices) == 1
        return self.dictionary.masks[slice(indices[0], indices[0] + 1) if single else indices]

    def update(self, masks: Tensor, counts: Tensor, share: float) -> None:
        """Take in counts (b, 1) behind masks (b, N); all looks take the share of the tables."""
        tables = self.tables
        change = self._change
        indices = self.dictionary.indices(masks)
        for logs, index, count in zip(
            self.log_weights.numpy(), indices, counts[:, 0].tolist(), strict=True
        ):
            np.multiply(tables.by_count[index], count, out=change)
            np.subtract(change, tables.constant[index], out=change)
            np.add(logs, change, out=logs)
        self._end_look()

    def _odds(self, logs: np.ndarray, part: int) -> np.ndarray:
        """Variance (p,) between classes over that within, for the masks of a part.

        `logs` (n,) are log-probabilities of the scenes.
        """
        scale = self.tables.scales[part]
        noise = self.tables.noises[part]
        powers = self._powers  # a view of `_sums`, which `_draw` reads
        np.subtract(logs, logs.max(), out=powers)
        np.exp(powers, out=powers)
        if len(powers) <= len(self._ones):
            weights = powers
            members = self.tables.members * powers[:, None]
            drawn = scale
        else:
            rows = self._draw()
            weights = self._ones
            members = self.tables.members.take(rows, axis=0, mode="clip")
            drawn = scale.take(rows, axis=0, mode="clip")
        sums = members.T @ drawn  # of each class, and of all together
        sums *= sums
        sizes = self._ones[: len(members)] @ members
        shares = 1 / np.maximum(sizes, 1e-12)
        between = shares[:-1] @ sums[:-1]
        within = weights @ (drawn * drawn)
        within -= between
        within += noise * sizes[-1]
        between -= sums[-1] * shares[-1]
        between /= within
        return between

    def _draw(self) -> np.ndarray:
        """Scenes (S,) at equal steps of the sum of their probabilities, `_powers`."""
        # sums of blocks first: a running sum of all takes longer, and loses digits in float32
        blocks = self._sums @ self._block
        ends = blocks.cumsum()
        # the golden ratio spreads the starts of the looks evenly, and draws no random number
        shift = self._looks * ((math.sqrt(5) - 1) / 2) % 1 / len(self._points)
        points = (self._points + shift) * ends[-1]
        block = ends.searchsorted(points)
        ends -= blocks
        points -= ends.take(block)
        inside = self._sums.take(block, axis=0) @ self._running
        return block * SUMMED + (inside < points[:, None]).argmin(axis=1)
