"""The exposure of a design as the header of its file has it: one entry for each kind.

An entry and the tensors beside it rebuild the exposure of a trained design. Nothing of a field's
name, order or default may change: files are read again by them.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field

from deepfsi.base.models import StrictModel, UserModel
from deepfsi.camera.names import Widths

LARGEST_SCORE = 4.0
"""Bound of the scores whose softmax dwells are: the longest is e⁸ times the shortest at most.

A mask that is never shown is never learned, and the scores would not come back from there.
"""


class _Entry(StrictModel):
    """Entry of a design file's header: no further fields, and no conversions."""

    model_config = ConfigDict(strict=True)

    def count_stops(self, masks: int) -> int:
        """K, numbers of masks, of m, or of looks, after which an exposure can be classified."""
        return 1


class FixedEntry(_Entry):
    """Exposure of which all masks are needed, each with its own dwell."""

    kind: Literal["fixed"] = "fixed"


class ConditionedEntry(_Entry):
    """Exposure of fixed dwells whose classifier has the budget and the number of masks as inputs.

    Attributes
    ----------
    photons : float
        Lowest budget of the training.
    span : float
        Highest over lowest.
    masks : int
        m, of the whole sequence.
    nested : int
        Smallest number of first masks that can be classified alone; 0 if only all can.
    width : int
        Features of each mask.
    used : float
        Share of the light law that the masks take within the whole sequence.
    """

    photons: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    span: Annotated[float, Field(ge=1, allow_inf_nan=False)]
    masks: Annotated[int, Field(ge=1)]
    nested: Annotated[int, Field(ge=0)] = 0
    width: Annotated[int, Field(ge=1)] = 1
    used: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 1.0
    kind: Literal["conditioned"] = "conditioned"

    def count_stops(self, masks: int) -> int:
        """K, numbers of first masks, of m, that can be classified alone."""
        return masks - (self.nested or masks) + 1


class LooksEntry(_Entry):
    """Exposure of several looks, whose dwells a network chooses from the counts so far.

    Attributes
    ----------
    looks : int
        K, each 1 / K of the exposure.
    hidden : tuple of int
        Widths of the hidden layers of the network that chooses dwells.
    shortest : float
        Shortest dwell of a frame, a share of the exposure.
    """

    looks: Annotated[int, Field(ge=2, le=64)]
    hidden: Widths
    shortest: Annotated[float, Field(ge=0, lt=1)]
    kind: Literal["adaptive"] = "adaptive"

    def count_stops(self, masks: int) -> int:
        """K, an answer after each look."""
        return self.looks


class PatchesEntry(_Entry):
    """Exposure of fixed dwells, with a detector for each patch of an image.

    Attributes
    ----------
    side : int
        Of a patch, pixels.
    """

    side: Annotated[int, Field(ge=1)]
    kind: Literal["patches"] = "patches"


class PassingEntry(_Entry):
    """Scenes that pass a pattern, which is a tensor of the file.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns of a scene.
    bins : int
        Time bins of a transit.
    speed : float
        Pixels a bin.
    jitter : float
        Standard deviation of the place of an exposure, pixels.
    speed_jitter : float
        Standard deviation of its speed over the mean one.
    """

    shape: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]]
    bins: Annotated[int, Field(ge=1)]
    speed: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    jitter: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    speed_jitter: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    kind: Literal["passing"] = "passing"


ExposureEntry = Annotated[
    FixedEntry | ConditionedEntry | LooksEntry | PatchesEntry | PassingEntry,
    Field(discriminator="kind"),
]
"""Field of a header: how the masks of a design are exposed, where they are known before."""


class AdaptiveMasks(UserModel):
    """Exposure with adaptive masks: how a design that makes each next mask looks at a scene.

    Examples
    --------
    >>> from deepfsi.jobs.entries import AdaptiveMasks
    >>> AdaptiveMasks(looks=3, growth=4).shares
    [0.14285714285714285, 0.2857142857142857, 0.5714285714285714]
    """

    looks: int = Field(
        16, ge=1, le=1024, strict=True, description="masks that are shown one after another"
    )
    growth: float = Field(
        1.0,
        ge=1e-3,
        le=1e3,
        description="share of the exposure that the last look takes, over that of the first",
    )
    until: float = Field(
        1.0,
        gt=0,
        le=1,
        description="probability of a class above which the exposure stops; 1 for never",
    )
    components: int = Field(
        120, ge=1, strict=True, description="principal components of the scenes that are kept"
    )
    spread: float = Field(
        0.7,
        ge=0,
        allow_inf_nan=False,
        description="how far scenes lie from those of the prior, over the distance of neighbours "
        "in it; 0 if they are among them",
    )

    clusters: int | None = Field(
        None,
        ge=1,
        strict=True,
        description="clusters of each class whose centres stand for its scenes; all scenes unless "
        "given",
    )

    @property
    def shares(self) -> list[float]:
        """Share of the exposure that each look takes; their sum is 1."""
        each = self.growth ** np.linspace(0, 1, self.looks)
        return (each / each.sum()).tolist()
