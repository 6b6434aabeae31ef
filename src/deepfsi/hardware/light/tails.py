"""Chances of photon counts, from exact tails of the binomial distribution.

Two windows of one light share their photons like a coin's throws, whatever its brightness: given
the sum, the photons of one are binomial with its share of the time. So no rate need be known, and
few photons are as sound a base as many.
"""

import numpy as np
from scipy.special import betainc

FALSE_ALARMS = 1e-3
"""Chance of any fault of the light in a sound acquisition, at most."""

EXCESS = 1.1
"""Variance of sound counts over Poisson's at most: what afterpulses of up to 5 % add."""


def excess_chance(
    photons: np.ndarray,
    seconds: np.ndarray,
    others: np.ndarray,
    others_s: np.ndarray,
    ratio: np.ndarray | float = 1.0,
) -> np.ndarray:
    """Chance that a window holds at least these photons, given the sum of it and another."""
    photons, seconds, others, others_s, ratio = np.broadcast_arrays(
        *(np.asarray(each, np.float64) for each in (photons, seconds, others, others_s, ratio))
    )
    out = np.ones(photons.shape)
    which = (photons > 0) & (seconds > 0) & (others_s > 0)
    open_s = (ratio * seconds)[which]
    share = open_s / (open_s + others_s[which])
    out[which] = betainc(photons[which] / EXCESS, others[which] / EXCESS + 1, share)
    return out
