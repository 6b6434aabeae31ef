"""Dead time of a counter: arrivals from registered counts.

After an arrival the counter is blind for the dead time τ. At a steady rate n of arrivals, and with
y = n τ, it registers

    r = n / (1 + y)   non-paralysable        r = n exp(-y)   paralysable: lost arrivals blind it too

and m counts in a time far longer than τ, of variance m / (1 + y)² or m (1 - 2 y exp(-y)). Each
rule is solved for n at the rate of a frame, in which the light is steady. Of the m counts of its
gates come N = m n/r arrivals, of variance

    N (1 + y)   non-paralysable        N exp(y) (1 - 2 y exp(-y)) / (1 - y)²   paralysable

for all gates of the frame together; a single gate among several has at most this.
"""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from deepfsi.base.models import StrictModel

LONGEST_DEAD_TIME_S = 1e-5
"""Longest dead time with a correction, seconds: a gate must hold many of them."""


class DeadTime(StrictModel):
    """Dead time of a counter with its detector."""

    seconds: float = Field(ge=0, le=LONGEST_DEAD_TIME_S)  # For which it is blind after a photon
    # True if an arrival that is lost makes it blind again, as overlapping pulses of a
    # photomultiplier do
    paralysable: bool = False

    def __str__(self) -> str:
        return f"{self.seconds * 1e9:g} ns, {'' if self.paralysable else 'non-'}paralysable"

    @property
    def most_registered(self) -> float:
        """Highest rate with a correction, counts/s."""
        # arrivals in a dead time: beyond, an error of a tenth in the dead time makes more than a
        # tenth in the light
        most = 0.5 if self.paralysable else 1.0
        lost = np.exp(-most) if self.paralysable else 1 / (1 + most)
        return float(most * lost / self.seconds) if self.seconds else np.inf

    def registered(self, rate: np.ndarray) -> np.ndarray:
        """Counts/s at steady rates of arrivals."""
        if self.paralysable:
            return rate * np.exp(-rate * self.seconds)
        return rate / (1 + rate * self.seconds)

    def correction(self, registered: np.ndarray) -> "CorrectionFactors":
        """Factors for counts at registered rates, counts/s, up to `most_registered`; NaN is 0."""
        rate = np.nan_to_num(np.asarray(registered, np.float64)) * self.seconds
        if not self.paralysable:
            gain = 1 / (1 - rate)
            return CorrectionFactors(gain, gain**2)
        from scipy.special import lambertw

        # The branch of weak light: y exp(-y) = r τ has a second solution, beyond the peak
        blind = -lambertw(-rate).real
        gain = np.exp(blind)
        return CorrectionFactors(gain, (1 - 2 * rate) * gain**2 / (1 - blind) ** 2)


@dataclass(frozen=True)
class CorrectionFactors:
    """Factors that turn registered counts into arrivals."""

    arrivals: np.ndarray  # arrivals for each count, in the shape of the rates
    variance: np.ndarray  # variance of the arrivals for each count, of the same shape


NO_DEAD_TIME = DeadTime(seconds=0.0)
"""Nothing is lost."""
