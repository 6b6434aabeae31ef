"""Settings of a recording, and the calibration of the camera that recorded it."""

import os
from dataclasses import replace
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat, model_validator

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.files import read_text, write_atomically
from deepfsi.base.models import Amount, Count, Positive, Share, StrictModel
from deepfsi.camera.dead_time import NO_DEAD_TIME, DeadTime
from deepfsi.camera.detectors import MOST_INPUTS
from deepfsi.patterns.manifest import GatePlan, Manifest

MOST_READOUTS = 2**21
"""Largest number of gates, and of readouts, that are counted at once."""


class Scene(StrictModel):
    """One scene of a recording."""

    name: str = Field(max_length=1000)  # By which results name it
    label: str | None = Field(default=None, max_length=1000)  # Its class, where that is known
    # Of its picture as the design of the patterns sees it, where there is one: tells scenes that
    # the design was trained on (`provenance.scene_hashes`)
    hash: str | None = Field(
        default=None, pattern="^[0-9a-f]{8}$", exclude_if=lambda known: known is None
    )


class StopRule(StrictModel):
    """When an exposure stops."""

    threshold: Share  # Confidence above which the exposure stops
    photons: None = None  # Of earlier versions


class LiveSettings(StrictModel):
    """Settings of a live run."""

    shortest_ns: Count  # Shortest gate of the device
    photons: Positive | None = None  # Of earlier versions
    rule: StopRule | None = None  # When an exposure stops; never before its last look if None
    dead_time: DeadTime = NO_DEAD_TIME  # Of the counter, to be corrected for
    background: Literal[False] = False  # Of earlier versions
    latencies: dict[str, float] | None = None  # Of virtual devices, seconds


class Acquisition(StrictModel):
    """Settings of a recording: one pass over the patterns for each scene, in turn."""

    schema_version: Literal[1] = 1
    # In the order of their passes
    scenes: tuple[Scene, ...] = Field(min_length=1, max_length=2**16)
    exposure_s: Positive  # Total exposure over the masks' frames, seconds
    # Time before the first gate of each frame, seconds
    settle_s: Amount
    repeats: int = Field(ge=1, le=MOST_READOUTS)  # Gates in each frame
    # Which of the counter's marker inputs the device's trigger is wired to
    marker_bit: Literal[1, 2, 4, 8] = 1
    # Of the counter, 0 for input 1: one for each detector; on two arms first those that see mirrors
    # ON, then those that see mirrors OFF
    inputs: tuple[Annotated[int, Field(ge=0, lt=MOST_INPUTS)], ...] = Field(
        default=(0,), min_length=1, max_length=MOST_INPUTS
    )
    # Photons/s on the device for the training scenes' mean, where known
    flux: Positive | None = None
    camera: dict[str, Any] | None = None  # Settings of a virtual camera
    seed: int | None = None  # Of a virtual recording
    # Of a run whose dwells were chosen from counts; `shown.jsonl` then says what was shown
    live: LiveSettings | None = None
    # Of the bytes of patterns/manifest.json; `prepare` fills it in
    manifest_sha256: str | None = Field(default=None, pattern=r"^[0-9a-f]{64}$")

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        if len(set(self.inputs)) < len(self.inputs):
            raise ValueError("each detector needs an input of its own")
        return self

    @classmethod
    def plan(
        cls,
        manifest: Manifest,
        scenes: tuple[Scene, ...],
        *,
        exposure_s: float | None = None,
        settle_s: float | None = None,
        repeats: int | None = None,
        **fields: Any,
    ) -> Self:
        """Plan a recording of patterns; device and frames give the settings that are None."""
        fields = {"inputs": tuple(range(manifest.inputs)), **fields}
        settle = manifest.device.settle_us * 1e-6 if settle_s is None else settle_s
        exposure = exposure_s
        if exposure is None:
            longest = manifest.longest_exposure_s(settle + manifest.usual_tolerance_s)
            exposure = max(longest, 0) / (repeats or 1)
        with as_input_error():
            # one repeat until the gates are known
            planned = cls(scenes=scenes, exposure_s=exposure, settle_s=settle, repeats=1, **fields)
        gates = planned.gates(manifest, exposure, repeats=repeats)
        return planned.model_copy(update={"repeats": gates.repeats})

    def gates(
        self,
        manifest: Manifest,
        exposure_s: float | None = None,
        *,
        repeats: int | None = None,
        click_gates: int = 1,
    ) -> GatePlan:
        """Gates as recorded, or of another exposure; as many as fit where `repeats` is None.

        Each holds `click_gates` shorter ones, in which a detector clicks once at most.
        """
        if exposure_s is None:
            exposure_s = self.exposure_s
            repeats = self.repeats
        gates = GatePlan.of(manifest, exposure_s, self.settle_s, repeats)
        most = MOST_READOUTS // (len(self.scenes) * manifest.readouts * click_gates)
        if most < (repeats or 1):
            raise InputError(
                f"{len(self.scenes)} scenes with {repeats or 1} repeats are more than "
                f"{MOST_READOUTS} gates: give fewer repeats, or split the acquisition"
            )
        return replace(gates, repeats=min(gates.repeats, most))

    @property
    def digest(self) -> str:
        """Hash of the settings."""
        return sha256(self.model_dump_json().encode()).hexdigest()

    def check_fixed(self, folder: str | os.PathLike[str]) -> None:
        """Raise `InputError` for a live run, which shows other frames for each scene."""
        if self.live:
            raise InputError(
                f"{folder} is a live run, which is counted while it is recorded: use `deepfsi "
                "camera classify`"
            )

    def check(self, manifest: Manifest, name: str) -> None:
        """Raise `InputError`, which says `name`, unless the settings fit these patterns."""
        if len(self.inputs) != manifest.inputs:
            raise InputError(
                f"{name} has {len(self.inputs)} inputs, and its patterns need {manifest.inputs}: "
                "give one for each detector"
            )
        if bool(self.live) != (manifest.looks is not None):
            raise InputError(
                f"{name} is {'' if self.live else 'not '}of a live run, and its patterns are "
                f"{'not ' if self.live else ''}of adaptive masks, which are chosen while the "
                "exposure runs: use `deepfsi camera live`"
            )
        if self.live:
            return
        try:
            self.gates(manifest)
        except InputError as error:
            raise InputError(f"{name}: {error}") from None


def _invertible(rows: tuple[Any, ...]) -> tuple[Any, ...]:
    if abs(np.linalg.det(np.array(rows))) < 1e-9:
        raise ValueError("the homography cannot be inverted")
    return rows


_Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Homography = Annotated[tuple[_Row, _Row, _Row], AfterValidator(_invertible)]
"""Rows of a homography of (across, down, 1) in unit squares."""


class Calibration(StrictModel):
    """View of a display through a camera, and the counts that come from neither.

    It stands beside the recordings made with it, as `calibration.json`. Places on the display and
    on the device are (across, down) in a *unit square* each: the displayed image, and the area of
    the device that the cells of a mask fill. So a calibration made with a few large cells serves
    masks with many small ones.
    """

    schema_version: Literal[1] = 1
    # Version of the package that wrote it
    deepfsi: str = Field(default_factory=lambda: version("deepfsi"))
    homography: Homography  # Display → device
    residual: Amount  # Root mean square distance of the spots from it, cells
    error: Amount  # Standard error of the place of the display's worst corner, cells
    spots: int = Field(ge=4)  # Spots that it rests on
    shown: int = Field(ge=4)  # Spots that were shown
    # Standard deviation of a Gaussian, down and across, in the device's unit square
    blur: tuple[Share, Share] = (0.0, 0.0)
    # (down, across): Light of each cell relative to the brightest, for a uniform scene that fills
    # the view
    flat: tuple[tuple[Share, ...], ...] = Field(default=((1.0,),), min_length=1)
    dark: Amount = 0.0  # Counts/s with all mirrors OFF and the display black
    ambient: Amount | None = None  # Of earlier versions
    dead_time: DeadTime | None = None  # Of the counter, for which the run of spots was corrected

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if len({len(row) for row in self.flat}) != 1 or not any(map(any, self.flat)):
            raise ValueError("the flat field is dark, or its rows differ in length")
        return self

    @property
    def doubts(self) -> list[str]:
        """Reasons to distrust it, one line each; none if all is well."""
        reasons = []
        if self.spots < min(16, self.shown):
            reasons.append(
                f"only {self.spots} of {self.shown} spots are seen, and 16 or more are wanted: "
                "expose longer, show larger spots or aim the camera"
            )
        if self.residual > 0.25:
            reasons.append(
                f"the spots lie {self.residual:.2f} cells from one perspective, and up to 0.25 are "
                "well: the lens bends lines, something moved, or there is too little light"
            )
        if self.error > 0.1:
            reasons.append(
                f"the view is known to {self.error:.2f} cells, and 0.1 are wanted: give "
                f"{(self.error / 0.1) ** 2:.2g} times the light"
            )
        return reasons

    def lines(self) -> list[str]:
        """Say how many spots the view rests on, how well it is known, and its dark counts."""
        return [
            f"{self.spots} of {self.shown} spots, {self.residual:.2f} cells from the fit (rms); "
            f"the view is known to {self.error:.2f} cells at the display's corners",
            f"dark {self.dark:.4g} counts/s",
        ]

    def save(self, folder: Path) -> Path:
        """Write `calibration.json` into a folder, which is made if need be."""
        path = folder / "calibration.json"
        return write_atomically(path, self.model_dump_json(indent=1).encode())

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read `calibration.json` of a folder."""
        path = Path(folder) / "calibration.json"
        content = read_text(path, 2**26, "calibrate the camera")
        with as_input_error(f"'{path}'", "calibrate the camera again"):
            return cls.model_validate_json(content)
