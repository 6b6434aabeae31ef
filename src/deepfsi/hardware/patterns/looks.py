"""Looks whose dwells or masks are chosen while the exposure runs, as a manifest has them."""

import math
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from deepfsi.base.models import StrictModel

SUM_SLACK = 1e-3
"""Share of a look by which the dwells of the first one may differ from it together."""


class Looks(StrictModel):
    """Looks at the same masks, whose frames are loaded once, or at a new mask each."""

    count: int = Field(ge=1, le=1024)  # K
    each_rail: bool  # Whether the two rails of a mask are frames with dwells of their own
    # Dwells of the first look, shares of the exposure; 0 for frames that it does not show. Those of
    # later ones are chosen from the counts so far: mask by mask, and those of a mask's two rails
    # follow one another
    first: tuple[Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)], ...]
    # Shortest dwell that the design was learned for, a share of the exposure
    shortest: float = Field(ge=0, lt=1)
    # Of `loop.safetensors`, the networks that choose them; none where each look takes one new mask,
    # which the design beside it makes, and the one frame of a mask is that of the first look
    loop_sha256: str | None = Field(pattern=r"^[0-9a-f]{64}$")

    @model_validator(mode="after")
    def _whole(self) -> "Looks":
        equal = math.isclose(sum(self.first) * self.count, 1, abs_tol=SUM_SLACK)
        if not equal and not self.adaptive:
            raise ValueError(f"the dwells of the first look are not 1/{self.count} together")
        return self

    @property
    def adaptive(self) -> bool:
        """True where masks are made while the exposure runs."""
        return self.loop_sha256 is None

    def dwells(self, masks: int) -> int:
        """Number of dwells of a look at so many masks."""
        return masks * (2 if self.each_rail else 1)

    def places(self, masks: np.ndarray, minus: np.ndarray) -> np.ndarray:
        """Places (f,) among a look's dwells of frames' masks (f,), `minus` of negative rails."""
        return 2 * masks + minus if self.each_rail else masks
