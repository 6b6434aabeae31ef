"""Photon counts of each readout: their corrections, and their file counts.npz.

`Corrections` undo what dead time took, and then the gains of the detectors.

Clicks are not in proportion to the light, and are not corrected: each of the G equal gates of a
frame's exposure counts its first photon alone. With r expected photons a frame has

    k ~ Binomial(G, 1 - exp(-r / G))

clicks. The all-ON and all-OFF frames of a whole run tell the budget: a gate in which a detector
fires with the probability p has -log(1 - p) photons in the mean. Where gates hold more than one
photon in the mean, the detector is not gated, and its photons are the budget.

The file carries hashes of settings, patterns and photons.ptu: counts of other ones are refused.
"""

import io
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from deepfsi.base.arrays import read_npz
from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.files import hash_file, write_atomically
from deepfsi.base.models import Amount, Count, Positive, StrictModel
from deepfsi.camera.dead_time import (
    NO_DEAD_TIME,
    CorrectionFactors,
    DeadTime,
)
from deepfsi.counting.checks import SPOILING, Fault
from deepfsi.patterns.manifest import Frame, Manifest


@dataclass(frozen=True)
class Counts:
    """Photon counts of each readout; a single detector has no axis D."""

    counts: np.ndarray  # registered counts, int64, or those of a table
    arrivals: np.ndarray
    variance: np.ndarray
    valid: np.ndarray  # whether all readouts of an exposure were recorded
    flux: np.ndarray  # counts/s of all-ON frames beyond all-OFF ones, (S,)
    dark_rate: np.ndarray  # counts/s without light, (S, rails[, D])
    exposure_s: float
    settle_s: float
    lengths_s: np.ndarray  # for how long each readout is counted, seconds
    drift: float  # by how much passes lasted longer than planned on the counter's clock, a share
    inputs: tuple[int, ...]  # of the counter, 0 for input 1: those whose photons were counted
    faults: tuple[Fault, ...]
    dead_time: DeadTime = NO_DEAD_TIME  # for which the arrivals and all rates are corrected
    gains: tuple[float, ...] = ()  # relative efficiency of each detector, corrected too
    gates: int | None = None  # G of clicks, the first photons of the gates of a frame's exposure

    @property
    def background(self) -> np.ndarray:
        """Dark counts of each readout, float64 (S, rails, m[, D])."""
        if self.gates is not None:
            return np.zeros_like(self.counts[:, 0], float)  # clicks are read as they are
        # Detectors of an arm share the gates of its frames
        lengths = np.expand_dims(self.lengths_s, tuple(range(2, self.dark_rate.ndim)))
        return self.dark_rate[:, :, None] * lengths

    def signal(self) -> np.ndarray:
        """Arrivals less the background, float64 (S, R, rails, m[, D])."""
        return self.arrivals - self.background[:, None] * self.expand_to_counts(self.valid)

    @property
    def excess(self) -> np.ndarray:
        """Variance of the arrivals beyond Poisson's, 0 or more, float64 (S, R, rails, m[, D])."""
        return np.maximum(self.variance - np.maximum(self.arrivals, 0.0), 0.0)

    def expand_to_counts(self, exposures: np.ndarray) -> np.ndarray:
        """Array (S, R) of exposures, with axes of length 1 for the other axes of `counts`."""
        return np.expand_dims(exposures, tuple(range(2, self.counts.ndim)))

    @property
    def photons(self) -> np.ndarray:
        """Budget Φ of an exposure of each scene (S,): flux times exposure."""
        # In counts: the detector's efficiency is part of it
        return self.flux * self.exposure_s

    @property
    def spoilt(self) -> np.ndarray:
        """Scenes (S,), bool, whose counts a fault of the light has made meaningless."""
        out = np.zeros(len(self.valid), bool)
        for fault in self.faults:
            if fault.kind in SPOILING:
                out[slice(None) if fault.scene is None else fault.scene] = True
        return out

    def check_photons(self, folder: str | os.PathLike[str]) -> Self:
        """Give these counts; raise `InputError` if they are clicks."""
        if self.gates is not None:
            raise InputError(
                f"{folder} was counted in clicks, which are not in proportion to the light: record "
                "it with the patterns of a design or a scan for photon counts"
            )
        return self

    def check_budget(self, source: str) -> None:
        """Raise `InputError` if the counts tell the flux of no scene."""
        if not np.isfinite(self.flux).any():
            raise InputError(
                f"{source} does not tell its budget: all-ON frames leave less than 25 gates "
                "without a click, or click no more often than all-OFF ones; give `photons`, or "
                "look at the order of frames"
            )

    def save(self, path: Path, photons: Path, acquisition: str) -> None:
        """Write counts of a photon file, and of an acquisition with this hash."""
        fields = vars(self)
        arrays: dict[str, Any] = {
            name: value for name, value in fields.items() if isinstance(value, np.ndarray)
        }
        provenance = _Provenance(
            acquisition=acquisition,
            photons_sha256=hash_file(photons),
            repeats=self.counts.shape[1],
            **{name: value for name, value in fields.items() if name not in arrays},
        )
        arrays["about"] = np.frombuffer(provenance.model_dump_json().encode(), np.uint8)
        file = io.BytesIO()
        np.savez(file, **arrays)
        write_atomically(path, file.getvalue())

    @classmethod
    def read(cls, path: Path, photons: Path, acquisition: str) -> Self:
        """Read counts; `InputError` if they are of another acquisition hash or photon file."""
        again = "make it with `deepfsi camera count`"
        arrays: dict[str, Any] = read_npz(path, again)
        try:
            about = arrays.pop("about").tobytes()
            with as_input_error(str(path), again):
                provenance = _Provenance.model_validate_json(about)
            # Files of earlier versions hold more
            stored = {**arrays, **dict(provenance)}
            counts = cls(**{name: stored[name] for name in cls.__dataclass_fields__})
        except KeyError as missing:
            raise InputError(f"{path} has no array {missing}: {again}") from None
        if provenance.acquisition != acquisition:
            raise InputError(f"{path} is of another acquisition than acquisition.json: {again}")
        # counts may be read where the photon file, which is large, was left behind
        if photons.is_file() and hash_file(photons) != provenance.photons_sha256:
            raise InputError(f"{path} is of another {photons.name} than the one beside it: {again}")
        return counts


class _Provenance(StrictModel):
    """Settings of a count, and hashes of the acquisition and its photons.ptu."""

    acquisition: str
    photons_sha256: str
    repeats: Count
    exposure_s: Positive
    settle_s: Amount
    drift: float
    inputs: tuple[int, ...]
    faults: tuple[Fault, ...]
    dead_time: DeadTime = NO_DEAD_TIME
    gains: tuple[Positive, ...] = ()
    gates: Count | None = None


@dataclass(frozen=True)
class Corrections:
    """Corrections of counts for dead time and gains, as factors."""

    dead_time: DeadTime  # photons that arrive while it is blind are not counted
    gains: np.ndarray  # (inputs,): how many times as much of the light as usual each counts

    @classmethod
    def of(cls, dead_time: DeadTime, manifest: Manifest, gains: tuple[float, ...] = ()) -> Self:
        """Corrections on the inputs of a manifest, with a gain for each; default: equal gains."""
        if gains and len(gains) != manifest.inputs:
            raise InputError(
                f"the flat field is of {len(gains)} detectors, and these patterns are for "
                f"{manifest.inputs}: record it with the same detectors"
            )
        return cls(dead_time, np.array(gains or (1.0,) * manifest.inputs))

    def factors(self, rates: np.ndarray) -> CorrectionFactors:
        """Factors (S, F, inputs) of the counts of frames with these registered rates, counts/s.

        A rate above the highest that is corrected has the factor of that one.
        """
        lost = self.dead_time.correction(np.minimum(rates, self.dead_time.most_registered))
        return CorrectionFactors(lost.arrivals / self.gains, lost.variance / self.gains**2)

    def check(
        self, rates: np.ndarray, frames: Sequence[Frame], inputs: Sequence[int], name: str
    ) -> None:
        """Raise `InputError` if rates (S, F, inputs) are too near the saturation of the counter."""
        most = self.dead_time.most_registered
        if not (rates > most).any():
            return
        worst = _, frame, column = np.unravel_index(np.nanargmax(rates), rates.shape)
        raise InputError(
            f"{name} has {rates[worst]:.3g} counts/s on input {inputs[int(column)] + 1} in "
            f"{frames[int(frame)]}, and a dead time of {self.dead_time}, is corrected up to "
            f"{most:.3g}: dim the light, or give the counter's own dead time"
        )


ALL_ON = [0, -2]
ALL_OFF = [1, -1]
"""Indices in a pass of the frames that are all ON, and of those that are all OFF."""

ENDS = [0, 1, -2, -1]
"""Indices of the sentinels of a pass: all ON, all OFF, all ON, all OFF."""


def light_of_clicks(
    photons: np.ndarray, fired: np.ndarray, *, gates: int, width_s: float, manifest: Manifest
) -> tuple[float, np.ndarray]:
    """Flux of all exposures together, and dark rates (inputs,).

    `photons`, and the gates that `fired`, are (E, 4, inputs), of the frames of `ENDS` in E
    exposures. The flux is NaN where too few gates stay without a click.
    """
    arm = manifest.on_inputs
    opened = 2 * gates * len(photons)
    photons, fired = (
        counts.reshape(-1, 2, 2, counts.shape[-1]).sum(axis=(0, 1)) for counts in (photons, fired)
    )  # (on and off, inputs)
    mean = photons / opened
    with np.errstate(divide="ignore"):
        # photons, too: where gates hold more than one, the detector was not gated
        rate = np.where(mean > 1, mean, -np.log1p(-(fired / opened))) / width_s
    # The second arm is dark when all mirrors are ON
    dark = np.append(rate[1, arm], rate[0, arm.stop :])
    # 25 gates without a click tell the light to 1 / 5 of a photon in each
    certain = ((mean > 1) | (opened - fired >= 25))[0, arm].all()
    flux = float((rate[0] - dark)[arm].sum()) if certain else np.nan
    return flux, dark


def refuse_photon_settings(*settings: object) -> None:
    """Raise `InputError` if any setting of photon counts is given for clicks."""
    if any(setting is not None for setting in settings):
        raise InputError(
            "dead time, backgrounds, flat fields, gains and read noise are of photon counts, and "
            "clicks are read as they are: leave them out"
        )
