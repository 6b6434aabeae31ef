"""Background of the masks: what readouts hold of light that does not come from the scene.

Ambient light on the device is counted through each mask. A pass with the scene dark measures it,
readout by readout, beyond the dark counts that all-OFF frames have; it is then subtracted from all
scenes, and what all-ON frames hold of it from the flux. Its variance is that of the photons by
which it was measured, and is the same error in all scenes.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from deepfsi.base import InputError
from deepfsi.hardware.patterns.sequence import Manifest


@dataclass(frozen=True)
class Ambient:
    """Light of one exposure that does not come from the scene."""

    counts: np.ndarray  # (rails, m[, D]): Counts of each readout beyond its dark counts
    variance: np.ndarray  # (rails, m[, D]): Of these as they were measured
    flux: float  # Counts/s of all-ON frames beyond all-OFF ones

    @classmethod
    def none(cls, manifest: Manifest) -> Self:
        """No such light: it was not measured, and is not subtracted."""
        empty = np.zeros((manifest.rails, manifest.masks, *manifest.several))
        return cls(empty, empty, 0.0)

    @classmethod
    def of(
        cls,
        manifest: Manifest,
        gates: tuple[np.ndarray, np.ndarray],
        frames: tuple[np.ndarray, np.ndarray],
        lengths_s: np.ndarray,
    ) -> Self:
        """Light of exposures with the scene dark: arrivals and variance (E, f, inputs) in gates."""
        # frames: arrivals (F, inputs) in whole frames, all passes together, and their times (F,);
        # none of the sentinels' are needed, and dark counts are then part of the light.
        # lengths_s (f,): of the gates of the masks' frames
        exposures, (found, seconds) = len(gates[0]), frames
        rate, noise, flux = np.zeros(manifest.inputs), np.zeros(manifest.inputs), 0.0
        on, off = (_rate(found, seconds, ends) for ends in ([0, -2], [1, -1]))
        if on is not None and off is not None:
            rate, noise = (manifest.dark_inputs(*each) for each in zip(on, off, strict=True))
            flux = float((on[0] - rate)[: manifest.detector_count].sum())
        mean, variance = gates[0].mean(axis=0), gates[1].sum(axis=0) / exposures**2
        lengths = manifest.lengths_by_readout(lengths_s)
        lengths = np.expand_dims(lengths, tuple(range(2, 2 + len(manifest.several))))
        dark, dark_noise = (manifest.by_rail(each)[:, None] for each in (rate, noise))
        counts = manifest.by_readout(mean) - dark * lengths
        return cls(counts, manifest.by_readout(variance) + dark_noise * lengths**2, flux)

    def of_flux(self, flux: np.ndarray, source: str) -> np.ndarray:
        """Flux of scenes without this light, or `InputError` if nothing is left."""
        left = flux - self.flux
        if np.isfinite(left).any() and not (left > 0).any():
            raise InputError(
                f"{source} has no light beyond its background: all-ON frames of the scenes are not "
                "brighter than those of the dark scene; give the pass with the scene dark"
            )
        return left


def _rate(
    found: np.ndarray, seconds: np.ndarray, ends: list[int]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Counts/s (inputs,) in some frames, and their variance; None where they were not counted."""
    spent = seconds[ends].sum()
    if not spent:
        return None
    photons = found[ends].sum(axis=0)
    return photons / spent, photons.clip(min=0) / spent**2
