"""Settings of scenes that pass a static pattern, and their entry in design files."""

from collections.abc import Iterator
from math import ceil
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from deepfsi.base.errors import InputError
from deepfsi.base.models import Amount, Count, Positive
from deepfsi.camera.camera import Camera
from deepfsi.datasets.dataset import Dataset
from deepfsi.jobs.exposures import Entry, Exposure

if TYPE_CHECKING:
    from deepfsi.jobs.job import Job

STATIC = (
    "this design is one static pattern that scenes pass, which no sequence of frames shows: write "
    "the pattern with `deepfsi mask`"
)
"""Why a passing scene's design is not for a device's frames."""


class PassingEntry(Entry):
    """Scenes that pass a pattern, which is a tensor of the file."""

    shape: tuple[Count, Count]  # rows and columns of a scene
    bins: Count  # time bins of a transit
    speed: Positive  # pixels a bin
    jitter: Amount  # standard deviation of the place of an exposure, pixels
    speed_jitter: Amount  # standard deviation of its speed over the mean one
    kind: Literal["passing"] = "passing"
    no_frames: ClassVar[str] = STATIC
    restored_by: ClassVar[str] = "deepfsi_flow.exposure:PassingExposure"


class Passing(Exposure):
    """Scenes that move past one static pattern: each time bin is a readout.

    The pattern is learned (`deepfsi`) or drawn ON and OFF (`random`). Its middle is where the scene
    is in the middle of the bins; place and speed are drawn for each exposure where they jitter.

    Examples
    --------
    >>> import deepfsi
    >>> job = deepfsi.Job(photons=1e4, exposure=Passing(bins=16, speed=0.5, jitter=1))
    >>> job.masks, job.optics.light
    (16, 'equal-dwell')
    """

    training: ClassVar[dict[str, Any]] = {"start": "random"}
    trained_by: ClassVar[str] = "deepfsi_flow.exposure:PassingTraining"
    entry_type: ClassVar[type[Entry]] = PassingEntry
    allow_bf16: ClassVar[bool] = False

    bins: int = Field(
        default=32,
        ge=2,
        le=4096,
        description="time bins of a scene that passes a static pattern",
    )
    speed: Positive = Field(default=1.0, description="speed of a passing scene, pixels a bin")
    jitter: Amount = Field(
        default=0.0,
        description="standard deviation of a passing scene's place in an exposure, pixels",
    )
    speed_jitter: float = Field(
        default=0.0,
        ge=0,
        le=0.3,
        description="standard deviation of a passing scene's speed over the mean one",
    )
    pattern_width: int | None = Field(
        default=None,
        ge=1,
        le=2**16,
        description="columns of the static pattern; the scene's and those that it passes unless "
        "given",
    )

    @property
    def fixed_mask_count(self) -> int:
        """T, its bins."""
        return self.bins

    def optics(self, camera: Camera) -> dict[str, Any]:
        """Bins of equal length."""
        return {"light": "equal-dwell"}

    def describe(self, camera: Camera) -> str:
        """Path and jitter of the scenes."""
        return (
            f"scenes pass a static pattern at {self.speed:g} pixels a bin; one detector counts "
            f"{self.bins} bins\njitter: {self.jitter:g} pixels rms of the place, "
            f"{self.speed_jitter:g} rms of the speed over the mean one"
        )

    def columns(self, image_shape: tuple[int, ...]) -> int:
        """P of the pattern, or `InputError` where scenes of a shape have left it too early."""
        if len(image_shape) != 2:
            raise InputError("spectra pass no pattern: give images")
        _, scene = image_shape
        width = self.pattern_width or scene + ceil(self.bins * self.speed)
        if self.bins * self.speed > width + scene:
            raise InputError(
                f"scenes of {scene} columns pass a pattern of {width} in {width + scene} pixels, "
                f"and {self.bins} bins at {self.speed:g} are {self.bins * self.speed:g}: give "
                "fewer `bins`, a lower `speed` or a larger `pattern_width`"
            )
        return width

    def view(self, data: Dataset) -> Dataset:
        """Whole scenes, or `InputError` where they cannot pass."""
        self.columns(data.image_shape)
        return data

    def faults(self, job: "Job") -> Iterator[str]:
        """Designs that are no one pattern, and optics other than one detector behind it."""
        camera = job.optics
        if job.design not in ("deepfsi", "random"):
            yield (
                f"{job.design} is a set of masks, and scenes pass one pattern: give `deepfsi`, "
                "which learns it, or `random`"
            )
        elif job.facts.learned and job.training.start != "random":
            yield "a pattern that scenes pass starts at random: leave `start` out"
        one = camera.rails == "single" and camera.one_detector
        if not one or camera.device is not None or camera.shortest_dwell:
            yield (
                "scenes pass a static pattern before one detector: give single rails, no "
                "`detectors`, no `device` and no `shortest_dwell`"
            )
        if job.masks != self.bins:
            yield f"{job.masks} masks and {self.bins} bins are one number: leave `masks` out"
