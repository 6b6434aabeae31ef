"""Settings of a live run, as the acquisition's file has them."""

import math
from typing import Literal

from deepfsi.base.models.strict import Count, Positive, Share, StrictModel
from deepfsi.camera.dead_time import CounterEffects


class StopRule(StrictModel):
    """When an exposure stops."""

    # Confidence above which the exposure stops; 1 for never before the last look
    threshold: Share
    # Budget that it was chosen at, and within a factor of √10 of which it holds; any if None
    photons: Positive | None = None

    def stops(self, confidence: float, photons: float) -> bool:
        """True if an exposure of a budget may stop at a confidence."""
        near = self.photons is None or abs(math.log10(photons / self.photons)) <= 0.5
        return near and confidence > self.threshold


class _LiveLooks(StrictModel):
    """Settings of the looks of a live run, which its file has first."""

    shortest_ns: Count  # Shortest gate; frames whose dwells are shorter are not shown
    # Budget of an exposure where it is known; that of the all-ON frames so far if None
    photons: Positive | None = None
    rule: StopRule | None = None  # When an exposure stops; never before its last look if None


class LiveSettings(CounterEffects, _LiveLooks):
    """Settings of a live run, with the effects of the counter that are corrected for."""

    background: Literal[False] = False  # Of earlier versions
    latencies: dict[str, float] | None = None  # Of virtual devices, seconds
