"""Corrections of counts: dead time, unequal detectors, ambient light, and clicks.

A counter registers more or less than arrives, and in proportion to what it counts: first what dead
time took is undone (`Corrections`), then the gains of its detectors.

Ambient light on the device is counted through each mask, and is no factor. A pass with the scene
dark measures it, readout by readout, beyond the dark counts that all-OFF frames have; it is then
subtracted from all scenes, and what all-ON frames hold of it from the flux. Its variance is that of
the photons by which it was measured, and is the same error in all scenes.

Clicks are corrected for nothing, as they are not in proportion to the light: of the photons in each
of the G equal gates of a frame's exposure the first alone. A detector that fires at most once in a
gate makes them, or `count_run` of the photons of any other. Of r expected photons a frame has

    k ~ Binomial(G, 1 - exp(-r / G))

clicks. Their budget comes from the all-ON and all-OFF frames of a whole run: a gate in which a
detector fires with the probability p has -log(1 - p) photons in the mean. Where gates hold more
than one photon in the mean, a detector is not gated, and the photons themselves tell it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.camera.dead_time import CorrectionFactors, CounterEffects, DeadTime
from deepfsi.hardware.counting.counts import LEAST_UNFIRED, RunLight
from deepfsi.hardware.patterns.manifest import Frame, Manifest

Gains = tuple[float, ...]
"""Relative efficiency of each detector; empty for equal ones."""


@dataclass(frozen=True)
class Corrections:
    """What a counter does to counts, undone by factors of them."""

    dead_time: DeadTime  # photons that arrive while it is blind are not counted
    gains: np.ndarray  # (inputs,): how many times as much of the light as usual each counts

    @classmethod
    def of(cls, effects: CounterEffects, manifest: Manifest, gains: Gains = ()) -> Self:
        """Corrections on the inputs of a manifest, or `InputError` for gains of others."""
        if gains and len(gains) != manifest.inputs:
            raise InputError(
                f"the flat field is of {len(gains)} detectors, and these patterns are for "
                f"{manifest.inputs}: record it with the same detectors"
            )
        return cls(effects.dead_time, np.array(gains or (1.0,) * manifest.inputs))

    def factors(self, rates: np.ndarray) -> CorrectionFactors:
        """Factors (S, F, inputs) of the counts of frames with these registered rates, counts/s.

        Those of dead time are at most those of the highest rate that has one.
        """
        lost = self.dead_time.correction(np.minimum(rates, self.dead_time.most_registered))
        return CorrectionFactors(lost.arrivals / self.gains, lost.variance / self.gains**2)

    def check(
        self, rates: np.ndarray, frames: Sequence[Frame], inputs: Sequence[int], name: str
    ) -> None:
        """Raise `InputError` where the counter is too near its saturation, rates (S, F, inputs)."""
        most = self.dead_time.most_registered
        if not (rates > most).any():
            return
        worst = _, frame, column = np.unravel_index(np.nanargmax(rates), rates.shape)
        raise InputError(
            f"{name} has {rates[worst]:.3g} counts/s on input {inputs[int(column)] + 1} in "
            f"{frames[int(frame)]}, and a dead time of {self.dead_time}, is corrected up to "
            f"{most:.3g}: dim the light, or give the counter's own dead time"
        )


@dataclass(frozen=True)
class Estimate:
    """Numbers of arrivals, as estimated from counts."""

    arrivals: np.ndarray
    variance: np.ndarray  # of their noise, of the same shape

    @classmethod
    def of(cls, gated: np.ndarray, factors: CorrectionFactors, manifest: Manifest) -> Self:
        """Of counts (P, R, f, inputs) of the masks' frames, from factors of all (P, F, inputs)."""
        of_masks = (slice(None), None, manifest.shown)
        return cls(gated * factors.arrivals[of_masks], gated * factors.variance[of_masks])

    def by_readout(self, manifest: Manifest) -> Self:
        """Those of readouts, from those of masks' frames."""
        return type(self)(*map(manifest.by_readout, (self.arrivals, self.variance)))


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
        gated: Estimate,
        lengths_s: np.ndarray,
        frames: np.ndarray,
        frames_s: np.ndarray,
    ) -> Self:
        """Light of exposures (E) with the scene dark."""
        exposures = len(gated.arrivals)
        rate, noise = np.zeros((2, manifest.inputs))
        flux = 0.0
        on = _rate(frames, frames_s, ALL_ON)
        off = _rate(frames, frames_s, ALL_OFF)
        if on is not None and off is not None:
            rate = manifest.dark_inputs(on.arrivals, off.arrivals)
            noise = manifest.dark_inputs(on.variance, off.variance)
            flux = float((on.arrivals - rate)[manifest.arm].sum())
        mean = gated.arrivals.mean(axis=0)
        variance = gated.variance.sum(axis=0) / exposures**2
        lengths = manifest.lengths_by_readout(lengths_s)
        lengths = np.expand_dims(lengths, tuple(range(2, 2 + len(manifest.several))))
        dark = manifest.by_rail(rate)[:, None]
        dark_noise = manifest.by_rail(noise)[:, None]
        return cls(
            manifest.by_readout(mean) - dark * lengths,
            manifest.by_readout(variance) + dark_noise * lengths**2,
            flux,
        )

    def of_flux(self, flux: np.ndarray, source: str) -> np.ndarray:
        """Flux of scenes without this light, or `InputError` if nothing is left."""
        rest = flux - self.flux
        if np.isfinite(rest).any() and not (rest > 0).any():
            raise InputError(
                f"{source} has no light beyond its background: all-ON frames of the scenes are not "
                "brighter than those of the dark scene; give the pass with the scene dark"
            )
        return rest


def _rate(photons: np.ndarray, seconds: np.ndarray, frames: list[int]) -> Estimate | None:
    """Counts/s (inputs,) in some frames; None where they were not counted."""
    spent = seconds[frames].sum()
    if not spent:
        return None
    total = photons[frames].sum(axis=0)
    return Estimate(total / spent, total.clip(min=0) / spent**2)


ALL_ON = [0, -2]
ALL_OFF = [1, -1]
"""Frames at the ends of a pass that are all ON, and those that are all OFF."""

ENDS = [0, 1, -2, -1]
"""Frames of a pass that are all ON, all OFF, all ON and all OFF."""


def variance_of_clicks(clicks: np.ndarray, gates: int) -> np.ndarray:
    """Variance of clicks of so many gates, as they tell it."""
    return clicks * (1 - clicks / gates)


def light_of_clicks(
    photons: np.ndarray,
    fired: np.ndarray,
    gates: np.ndarray,
    *,
    width_s: float,
    scenes: int,
    manifest: Manifest,
) -> RunLight:
    """Light of all scenes together, from the frames of `ENDS`."""
    arm = manifest.arm
    photons, fired, gates = (
        counts.reshape(-1, 2, 2, counts.shape[-1]).sum(axis=(0, 1))
        for counts in (photons, fired, gates)
    )  # (on and off, inputs)
    mean = photons / np.maximum(gates, 1)
    share = fired / np.maximum(gates, 1)
    with np.errstate(divide="ignore"):
        rate = np.where(mean > 1, mean, -np.log1p(-share)) / width_s
    dark = manifest.dark_inputs(rate[0], rate[1])
    certain = ((mean > 1) | (gates - fired >= LEAST_UNFIRED))[0, arm].all()
    flux = float((rate[0] - dark)[arm].sum()) if certain else np.nan
    on, off = share[:, arm].sum(axis=1) / width_s
    return RunLight(
        on_rate=np.full(scenes, on),
        off_rate=np.full(scenes, off),
        flux=np.full(scenes, flux if flux > 0 else np.nan),
        dark_rate=manifest.by_rail(np.tile(dark, (scenes, 1))),
    )


def check_clicks(clicks: int, refused: Mapping[str, bool]) -> None:
    """Raise `InputError` where what is of photon counts is asked for with clicks."""
    # refused: whether it was given, by its name
    for name, asked in refused.items():
        if asked:
            raise InputError(
                f"{name} is of photon counts, and this design reads clicks, of up to {clicks} "
                "gates a frame, as they are: leave it out"
            )
