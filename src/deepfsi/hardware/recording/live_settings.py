"""Settings of a live run, as the acquisition's file has them."""

from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from deepfsi.hardware.recording.dead_time import NO_DEAD_TIME, DeadTime

MARGIN_NS = 2000
"""Time by which a picture outlasts its gate at least, so that markers may be off, ns."""

CLOCKS_DIFFER = 2e-4
"""Share of its gate by which a picture outlasts it at least, so that clocks may differ."""


def margin_ns(gate_ns: np.ndarray) -> np.ndarray:
    """Time by which pictures outlast their gates, ns."""
    return np.maximum(MARGIN_NS, CLOCKS_DIFFER * gate_ns)


class StopRule(BaseModel):
    """When an exposure stops, as `design.stopping.StoppingRule` has it.

    Attributes
    ----------
    temperatures : tuple of float
        What the logits are divided by after each look; none where all are 1.
    threshold : float
        Confidence above which the exposure stops; 1 for never before the last look.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    temperatures: tuple[Annotated[float, Field(gt=0, allow_inf_nan=False)], ...] = ()
    threshold: float = Field(1.0, ge=0, le=1)


class Live(BaseModel):
    """Settings of a live run.

    Attributes
    ----------
    shortest_ns : int
        Shortest gate; frames whose dwells are shorter are not shown.
    photons : float or None
        Budget of an exposure where it is known; that of the all-ON frames so far if None.
    rule : StopRule or None
        When an exposure stops; never before its last look if None.
    dead_time : DeadTime
        Of the counter, to be corrected for.
    latencies : dict or None
        Of virtual devices, seconds.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    shortest_ns: int = Field(ge=1)
    photons: float | None = Field(None, gt=0, allow_inf_nan=False)
    rule: StopRule | None = None
    dead_time: DeadTime = NO_DEAD_TIME
    latencies: dict[str, float] | None = None
