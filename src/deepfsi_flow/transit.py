"""Scenes that pass a static pattern: each time bin counts the light behind another place of it.

A scene of H × W pixels moves along the rows of a pattern of H × P pixels, at v pixels a bin, for T
bins of one length. At the shift p column j of the scene lies on column j + p of the pattern, and

    C(p) = Σ_j P_{j + p} x_j

is linear between whole shifts, as pixels are squares: all whole shifts, one product with a matrix,
give it everywhere. A bin counts while the scene moves on, so that its rate is the mean of C over
the v pixels that the scene passes in it, and Φ / T of the light times that.

With jitter the middle of the path, and the speed, are others in each exposure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from deepfsi.physics.detection import Rails, Readouts
from deepfsi.physics.laws import FixedMasks, LearnedMasks, check_levels, through

SLOWEST = 0.01
"""Least speed of an exposure over the mean one, where a draw is less."""


@dataclass(frozen=True)
class ScenePath:
    """Path of scenes along a pattern, and its jitter."""

    shape: tuple[int, int]  # H and W of a scene
    width: int  # P, columns of the pattern
    bins: int  # T
    speed: float  # v, pixels a bin
    jitter: float = 0.0
    speed_jitter: float = 0.0

    @property
    def shifts(self) -> int:
        """K, number of whole shifts, from one beside the pattern to the other."""
        return self.width + self.shape[1] + 1

    @property
    def moves(self) -> bool:
        """True if exposures differ in place or speed."""
        return self.jitter > 0 or self.speed_jitter > 0

    def every_shift(self, pattern: Tensor) -> Tensor:
        """Matrix (..., K, N) of a pattern (..., H, P) at every whole shift."""
        width = self.shape[1]
        windows = functional.pad(pattern, (width, width)).unfold(-1, width, 1)
        return windows.movedim(-2, -3).flatten(-2)

    def edges(
        self, shape: Sequence[int], generator: torch.Generator | None, device: torch.device
    ) -> Tensor:
        """Places (*shape, T + 1) of the ends of bins among the shifts, drawn with the jitter."""
        time = torch.arange(self.bins + 1, device=device) - self.bins / 2
        middle = (self.shifts - 1) / 2
        if not self.moves:
            return (middle + self.speed * time).expand(*shape, -1)
        draws = torch.randn(2, *shape, 1, generator=generator, device=device)
        speed = self.speed * (1 + self.speed_jitter * draws[1]).clamp(min=SLOWEST)
        return middle + self.jitter * draws[0] + speed * time

    def means(self, correlation: Tensor, edges: Tensor) -> Tensor:
        """Means (..., T) of C over each bin, of its values (..., K) at whole shifts."""
        # its integral is a sum of trapezoids to the shift below, and a part of the next one
        *_, shifts = correlation.shape
        lead = torch.broadcast_shapes(correlation.shape[:-1], edges.shape[:-1])
        between = (correlation[..., 1:] + correlation[..., :-1]) / 2
        summed = functional.pad(between.cumsum(dim=-1), (1, 0))
        place = edges.clamp(0, shifts - 1)
        low = place.floor().clamp(max=shifts - 2)
        part = place - low
        index = low.long().expand(*lead, -1)
        here, next_, whole = (
            sums.expand(*lead, -1).gather(-1, index + step)
            for sums, step in ((correlation, 0), (correlation, 1), (summed, 0))
        )
        integral = whole + part * here + part.square() / 2 * (next_ - here)
        return (integral.diff(dim=-1) / edges.diff(dim=-1)).clamp(min=0)  # of rounding

    def matrix(self, pattern: Tensor) -> Tensor:
        """Sensing matrix (..., T, N) of a pattern (..., H, P) without jitter."""
        columns = self.every_shift(pattern).transpose(-2, -1)
        edges = ScenePath(self.shape, self.width, self.bins, self.speed).edges(
            (), None, pattern.device
        )
        return self.means(columns, edges).transpose(-2, -1) / self.bins

    def open(self, device: torch.device) -> Tensor:
        """Rails (1, T, N) of an open pattern as wide as the path: all of the light."""
        pixels = self.shape[0] * self.shape[1]
        return torch.full((1, self.bins, pixels), 1 / self.bins, device=device)

    def readouts(self, device: torch.device) -> Readouts:
        """Readouts of the bins: all are counted, for one time."""
        shown = torch.ones(2, 1, self.bins, dtype=torch.bool, device=device)
        shown[1] = False
        bins = torch.arange(self.bins, device=device)
        return Readouts(shown, shown / self.bins, bins.expand_as(shown))


class FixedPattern(FixedMasks):
    """A pattern that does not learn; `forward` gives rails of its nominal matrix."""

    pattern: Tensor  # (R, H, P)

    def __init__(self, pattern: Tensor, transit: ScenePath) -> None:
        super().__init__(transit.matrix(pattern).unsqueeze(-3))
        self.transit = transit
        self.register_buffer("pattern", pattern)


class LearnedPattern(LearnedMasks):
    """A pattern that learns, in [0, 1], from logits (R, H, P).

    Grey levels have the gradient of the continuous pattern, as those of `LearnedMasks`.
    """

    def __init__(self, start: Tensor, transit: ScenePath, levels: int = 0) -> None:
        nn.Module.__init__(self)
        self.transit = transit
        self.levels = levels
        self.weight = nn.Parameter(start)

    @property
    def pattern(self) -> Tensor:
        """The pattern (R, H, P)."""
        grey = torch.sigmoid(self.weight)
        if not self.levels:
            return grey
        with torch.no_grad():
            shown = in_levels(grey, self.levels)
        return through(grey, shown)

    def forward(self) -> Rails:
        """Rails of the nominal matrix, (R, T, N)."""
        return Rails(self.transit.matrix(self.pattern))


def in_levels(pattern: Tensor, levels: int) -> Tensor:
    """A pattern (..., H, P) in grey levels from dark to open; `InputError` if these are too few."""
    check_levels(levels)
    steps = levels - 1
    return (pattern * steps).round() / steps
