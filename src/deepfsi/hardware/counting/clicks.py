"""Clicks: of the photons in each of the G equal gates of a frame's exposure the first alone.

A detector that fires at most once in a gate makes them, or this module of the photons of any other.
Of r expected photons a frame has

    k ~ Binomial(G, 1 - exp(-r / G))

clicks. They are neither corrected for dead time nor rid of a background, as they are not in
proportion to the light.

The budget comes from the all-ON and all-OFF frames of a whole run: a gate in which a detector fires
with the probability p has -log(1 - p) photons in the mean. Where gates hold more than one photon in
the mean, a detector is not gated, and the photons themselves tell it.
"""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from deepfsi.base import InputError, time_text
from deepfsi.hardware.counting.acquisition import MOST_READOUTS, Acquisition, gates_of
from deepfsi.hardware.patterns.sequence import Manifest
from deepfsi.hardware.patterns.timing import ClickGates, Gates

ENDS = [0, 1, -2, -1]
"""Frames of a pass that are all ON, all OFF, all ON and all OFF."""

LEAST_UNFIRED = 25
"""Gates of all ON without a click that tell the light, at least: to 1 / 5 of a photon in each."""


@dataclass(frozen=True)
class ClickWindows:
    """Gates of a pass as windows, in order."""

    frame: np.ndarray  # (g,): Of each gate
    # (g,): When a gate opens after its frame's start, and for how long, seconds
    offset: np.ndarray
    length: np.ndarray  # (g,)
    gates: ClickGates

    @classmethod
    def of(cls, gates: ClickGates, scenes: int) -> Self:
        """Gates of a pass, or `InputError` if those of so many passes are too many."""
        each = gates.number * gates.exposures
        if scenes * each.sum() > MOST_READOUTS:
            raise InputError(
                f"{scenes * each.sum()} gates of {scenes} scenes are more than {MOST_READOUTS}: "
                "count fewer --repeats, or split the acquisition"
            )
        frame = np.repeat(np.arange(len(each)), each)
        place = np.arange(len(frame)) - (np.cumsum(each) - each)[frame]
        width = gates.width_s[frame]
        return cls(frame, gates.offset_s + place * width, width, gates)

    def sums(self, values: np.ndarray, shown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sums over the gates of each exposure: (P, R, f, inputs), and (P, 4, inputs) of `ENDS`."""
        # values (P, g, inputs)
        exposures = self.gates.exposures
        begins = np.cumsum(exposures) - exposures
        each = values.reshape(len(values), -1, self.gates.number, values.shape[-1]).sum(axis=2)
        repeats = np.arange(exposures[shown].max())[:, None]
        return each[:, begins[shown] + repeats], each[:, begins[ENDS]]


def light_of_clicks(
    ends: tuple[np.ndarray, np.ndarray, np.ndarray], width_s: float, scenes: int, manifest: Manifest
) -> dict[str, Any]:
    """Light of all scenes together, as of `Counts`, from the frames of `ENDS`."""
    # ends: photons and clicks (P, 4, inputs), and so many open gates (P, 4, 1) of one width. The
    # flux is NaN where they do not tell it: an input fired in nearly all gates of all ON, or not
    # more often than with all OFF
    photons, fired, gates = (
        each.reshape(-1, 2, 2, each.shape[-1]).sum(axis=(0, 1)) for each in ends
    )  # (on and off, inputs)
    held, share = photons / np.maximum(gates, 1), fired / np.maximum(gates, 1)
    with np.errstate(divide="ignore"):
        rate = np.where(held > 1, held, -np.log1p(-share)) / width_s
    arm = slice(0, manifest.detector_count)
    dark = manifest.dark_inputs(rate[0], rate[1])
    told = ((held > 1) | (gates - fired >= LEAST_UNFIRED))[0, arm].all()
    flux = float((rate[0] - dark)[arm].sum()) if told else np.nan
    on, off = share[:, arm].sum(axis=1) / width_s
    return {
        "on_rate": np.full(scenes, on),
        "off_rate": np.full(scenes, off),
        "flux": np.full(scenes, flux if flux > 0 else np.nan),
        "dark_rate": manifest.by_rail(np.tile(dark, (scenes, 1))),
        "faults": (),
    }


def check_budget_of_clicks(flux: np.ndarray, source: str) -> None:
    """Raise `InputError` where clicks do not tell the flux (S,)."""
    if not np.isfinite(flux).any():
        raise InputError(
            f"{source} does not tell its budget: all-ON frames leave less than {LEAST_UNFIRED} "
            "gates without a click, or click no more often than all-OFF ones; give `photons`, or "
            "look at the order of frames"
        )


def check_clicks(clicks: int, refused: dict[str, bool]) -> None:
    """Raise `InputError` where what is of photon counts is asked for with clicks."""
    # refused: what was given, by its name
    for name, given in refused.items():
        if given:
            raise InputError(
                f"{name} is of photon counts, and this design reads clicks, of up to {clicks} "
                "gates a frame, as they are: leave it out"
            )


def variance_of(clicks: np.ndarray, gates: int) -> np.ndarray:
    """Variance of clicks of so many gates, as they tell it."""
    return clicks * (1 - clicks / gates)


def check_gated(
    run: Acquisition, manifest: Manifest, gates: Gates, clicks: int | None, folder: object
) -> None:
    """Raise `InputError` if a gated detector made a file whose gates are not those counted."""
    known = (run.camera or {}).get("gates")
    if known is None:
        return
    planned = gates_of(run, manifest)
    same = np.array_equal(gates.length_s, planned.length_s) and gates.settle_s == planned.settle_s
    if known != clicks or not same:
        raise InputError(
            f"{folder} holds the first photons alone of {known} gates in "
            f"{time_text(run.exposure_s)}: "
            "count these gates, of that exposure and settle time, or record again"
        )
