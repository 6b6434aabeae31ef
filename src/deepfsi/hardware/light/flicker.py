"""Periodic light: a periodogram of photons within frames.

A mask's light is steady while its frame is shown, whatever the scene. So what the parts of each
frame lack or have beyond their share is noise, unless the light itself has a rhythm. Blocks of some
tenths of a second are compared with each frequency by themselves, as no lamp keeps its phase for
long, and their evidence is added.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import chdtrc

from deepfsi.hardware.light.tails import EXCESS

BLOCK_S = 0.5
"""Time over which a rhythm keeps its phase at least, seconds."""

MOST_HZ = 5e3
"""Fastest rhythm that is looked for."""

MOST_FREQUENCIES = 4096
"""Frequencies that are tried at most."""

LEAST_PHOTONS = 100
"""Photons that a block must hold to say something."""

AT_ONCE = 2**22
"""Sines that are held in memory."""


@dataclass(frozen=True)
class _Block:
    """Frames of a pass that follow each other."""

    middles: np.ndarray  # (f, K): Times of the parts of each frame, seconds
    lacks: np.ndarray  # (P, f, K): Photons of each part less its share of the frame's
    photons: np.ndarray  # (P, f)


class Periodogram:
    """Evidence for rhythms, of all passes so far."""

    def __init__(self) -> None:
        self._tried = np.empty(0)  # Hz, those of the first passes
        self._found = np.zeros((4, 0))  # as of `_gather`

    def add(self, photons: np.ndarray, seconds: np.ndarray, middles: np.ndarray) -> None:
        """Add passes whose frames have the same times."""
        # photons, seconds (P, F, K); middles (F, K)
        whole = np.maximum(seconds.sum(axis=2, keepdims=True), 1e-300)
        every = photons.sum(axis=2)
        lacks = photons - every[..., None] * seconds / whole
        number = np.floor((middles[:, 0] - middles[0, 0]) / BLOCK_S).astype(int)
        cuts = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(number)]
        blocks = [_Block(middles[a:b], lacks[:, a:b], every[:, a:b]) for a, b in pairwise(cuts)]
        if not len(self._tried):
            self._tried = _frequencies(blocks)
            self._found = np.zeros((4, len(self._tried)))
        each = max(1, AT_ONCE // middles.size)
        for a in range(0, len(self._tried), each):
            found, so_far = _gather(blocks, self._tried[a : a + each]), self._found[:, a : a + each]
            so_far[1] = np.maximum(so_far[1], found[1])
            so_far[[0, 2, 3]] += found[[0, 2, 3]]

    def strongest(self, chance: float) -> tuple[float, float] | None:
        """Strongest rhythm beyond chance, if any: Hz, and its amplitude as a share of the mean."""
        # The pass that shows most of it is left out where there are three or more: what one pass
        # alone shows is no rhythm
        if not len(self._tried):
            return None
        total, strongest, count, size = self._found
        many = count >= 3
        left = np.where(many, total - strongest, total)
        chances = chdtrc(np.maximum(2 * (count - many), 1), left) * len(self._tried)
        best = int(np.argmin(chances))
        if not (count[best] and chances[best] <= chance):
            return None
        best = int(np.argmax(np.where(chances <= chance, left, 0)))
        amplitude = np.sqrt(EXCESS * max(total[best] - 2 * count[best], 0) / size[best])
        return float(self._tried[best]), float(amplitude)


def _frequencies(blocks: list[_Block]) -> np.ndarray:
    """Frequencies in Hz of which the longest block has a whole period, and parts can see."""
    if blocks[0].middles.shape[1] < 2:
        return np.empty(0)
    longest = max(float(np.ptp(block.middles)) for block in blocks)
    part = float(np.median(np.diff(blocks[0].middles, axis=1)))
    if longest <= 0 or part <= 0:
        return np.empty(0)
    top = min(0.5 / part, MOST_HZ)
    first, step = 1 / longest, 0.5 / longest
    number = int(min(max((top - first) / step + 1, 0), MOST_FREQUENCIES))
    return first + step * np.arange(number)


def _gather(blocks: list[_Block], hertz: np.ndarray) -> np.ndarray:
    """Evidence for each frequency: sum, largest, how many blocks, and their sensitivity (4, M)."""
    out = np.zeros((4, len(hertz)))
    for block in blocks:
        phase = 2 * np.pi * block.middles[..., None] * hertz
        cosine, sine = np.cos(phase), np.sin(phase)
        centred = [wave - wave.mean(axis=1, keepdims=True) for wave in (cosine, sine)]
        number = block.photons.astype(np.float64)
        lacks = block.lacks.reshape(len(number), -1)
        u, v = (lacks @ wave.reshape(-1, len(hertz)) for wave in (cosine, sine))
        a = number @ (centred[0] ** 2).mean(axis=1)
        b = number @ (centred[1] ** 2).mean(axis=1)
        c = number @ (centred[0] * centred[1]).mean(axis=1)
        determinant = a * b - c * c
        sees = (number.sum(axis=1) >= LEAST_PHOTONS)[:, None] & (
            determinant > 1e-3 * (a + b) ** 2 / 4
        )
        safe = np.where(sees, determinant, 1.0)
        evidence = np.where(sees, (u * u * b - 2 * u * v * c + v * v * a) / safe / EXCESS, 0.0)
        out[0] += evidence.sum(axis=0)
        out[1] = np.maximum(out[1], evidence.max(axis=0))
        out[2] += sees.sum(axis=0)
        out[3] += np.where(sees, (a + b) / 2, 0.0).sum(axis=0)
    return out
