"""Settings of scenes that pass a static pattern; `passing` is what a trained design does."""

from math import ceil
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic import Field

from deepfsi.base.errors import InputError
from deepfsi.design.exposure.base import Exposure, Job

if TYPE_CHECKING:
    from torch import Generator

    from deepfsi.camera.camera import Camera
    from deepfsi.datasets import Dataset
    from deepfsi.design.exposure.trained import TrainedExposure as Trained
    from deepfsi.optics.transit import Transit


STATIC = (
    "this design is one static pattern that scenes pass, which no sequence of frames shows: write "
    "the pattern with `deepfsi mask`"
)
"""Why it is not for a device's frames."""


class Passing(Exposure):
    """Scenes that move past one static pattern: each time bin is a readout.

    The pattern is learned (`deepfsi`) or drawn ON and OFF (`random`). Its middle is where the scene
    is in the middle of the bins; place and speed are drawn for each exposure where they jitter.

    Examples
    --------
    >>> import deepfsi
    >>> job = deepfsi.Job(photons=1e4, exposure=deepfsi.Passing(bins=16, speed=0.5, jitter=1))
    >>> job.masks, job.optics.light
    (16, 'equal-dwell')
    """

    training: ClassVar[dict[str, Any]] = {"start": "random"}
    rounds_products: ClassVar[bool] = False

    bins: int = Field(
        32,
        ge=2,
        le=4096,
        description="time bins of a scene that passes a static pattern; 32 unless given",
    )
    speed: float = Field(
        1.0,
        gt=0,
        allow_inf_nan=False,
        description="speed of a passing scene, pixels a bin; 1 unless given",
    )
    jitter: float = Field(
        0.0,
        ge=0,
        allow_inf_nan=False,
        description="standard deviation of a passing scene's place in an exposure, pixels; 0 "
        "unless given",
    )
    speed_jitter: float = Field(
        0.0,
        ge=0,
        le=0.3,
        description="standard deviation of a passing scene's speed over the mean one; 0 unless "
        "given",
    )
    pattern_width: int | None = Field(
        None,
        ge=1,
        le=2**16,
        description="columns of the static pattern; the scene's and those that it passes unless "
        "given",
    )

    @property
    def own_count(self) -> int:
        """T, its bins."""
        return self.bins

    def optics(self, camera: "Camera") -> dict[str, Any]:
        """Bins of equal length."""
        return {"light": "equal-dwell"}

    def words(self, camera: "Camera") -> str:
        """Path and jitter of the scenes."""
        return (
            f"scenes pass a static pattern at {self.speed:g} pixels a bin; one detector counts "
            f"{self.bins} bins\njitter: {self.jitter:g} pixels rms of the place, "
            f"{self.speed_jitter:g} rms of the speed over the mean one"
        )

    def path(self, image_shape: tuple[int, ...]) -> "Transit":
        """Path of scenes of a shape, or `InputError` where they have left the pattern too early."""
        from deepfsi.optics.transit import Transit

        if len(image_shape) != 2:
            raise InputError("spectra pass no pattern: give images")
        height, scene = image_shape
        width = self.pattern_width or scene + ceil(self.bins * self.speed)
        if self.bins * self.speed > width + scene:
            raise InputError(
                f"scenes of {scene} columns pass a pattern of {width} in {width + scene} pixels, "
                f"and {self.bins} bins at {self.speed:g} are {self.bins * self.speed:g}: give "
                "fewer `bins`, a lower `speed` or a larger `pattern_width`"
            )
        return Transit(
            (height, scene), width, self.bins, self.speed, self.jitter, self.speed_jitter
        )

    def seen(self, data: "Dataset") -> "Dataset":
        """Whole scenes, or `InputError` where they cannot pass."""
        self.path(data.image_shape)
        return data

    def begin(self, job: Job, image_shape: tuple[int, ...], seed: "Generator") -> "Trained":
        """One whose pattern is not known yet; parameters as of `Exposure.begin`."""
        from deepfsi.design.exposure.passing import PassingExposure

        return PassingExposure(self.path(image_shape))

    def faults(self, job: Job) -> list[str]:
        """Designs that are no one pattern, and optics other than one detector behind it."""
        found, camera = [], job.optics
        if job.design not in ("deepfsi", "random"):
            found.append(
                f"{job.design} is a set of masks, and scenes pass one pattern: give `deepfsi`, "
                "which learns it, or `random`"
            )
        elif job.code.learned and job.training.start != "random":
            found.append("a pattern that scenes pass starts at random: leave `start` out")
        one = camera.rails == "single" and camera.detectors in ("1x1", "1")
        if not one or camera.device is not None or camera.shortest_dwell:
            found.append(
                "scenes pass a static pattern before one detector: give single rails, no "
                "`detectors`, no `device` and no `shortest_dwell`"
            )
        if job.masks != self.bins:
            found.append(
                f"{job.masks} masks and {self.bins} bins are one number: leave `masks` out"
            )
        return found
