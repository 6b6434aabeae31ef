"""Base of the kinds of exposure: their settings, and what a job asks of them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from deepfsi.base.models import UserModel

if TYPE_CHECKING:
    from torch import Generator

    from deepfsi.camera.camera import Camera
    from deepfsi.datasets import Dataset
    from deepfsi.design.exposure.trained import TrainedExposure as Trained
    from deepfsi.jobs.designs import Code


class Job(Protocol):
    """A job, as far as its exposure asks for it: `training.job.Job`."""

    @property
    def design(self) -> str:
        """Name of the design."""

    @property
    def masks(self) -> int:
        """Number of masks, m."""

    @property
    def photons(self) -> float:
        """Lowest budget."""

    @property
    def training(self) -> Any:
        """Settings of the training."""

    @property
    def code(self) -> "Code":
        """All that the design's name implies."""

    @property
    def optics(self) -> "Camera":
        """The camera as the design has it."""

    @property
    def noise(self) -> str:
        """Name of the noise that is trained under."""

    def features(self, image_shape: tuple[int, ...]) -> int:
        """Numbers that are read of the masks of scenes of a shape, k."""


TRAINING_NOISE = {"poisson": "ml_gauss"}
"""Noise that is trained under in place of a camera's own."""


class Exposure(UserModel):
    """An exposure of which every mask is shown once, and all are needed."""

    training: ClassVar[dict[str, Any]] = {"start": "pca"}
    """Settings of the training where none are given."""

    @property
    def parts(self) -> int:
        """Parts of an exposure after which the network answers."""
        return 1

    side_by_side: ClassVar[bool] = True
    """Whether jobs that differ in budget and seed train together."""

    of_classes: ClassVar[bool] = False
    """Whether it is decided by the probabilities of classes."""

    rounds_products: ClassVar[bool] = True
    """Whether products of masks in bfloat16 were tried."""

    def rounds_networks(self, device: str, wide: bool) -> bool:
        """True if networks are faster in bfloat16: wide ones, on a processor."""
        return device == "cpu" and wide

    def highest(self, photons: float) -> float:
        """Highest budget of a training whose lowest is `photons`."""
        return photons

    def training_noise(self, noise: str) -> str:
        """Noise to train under where the camera has another."""
        return TRAINING_NOISE.get(noise, noise)

    def brightest(self, masks: int) -> int:
        """Fewest masks, of m, that the whole light may come to."""
        return masks

    @property
    def own_count(self) -> int | None:
        """Number of masks, where the exposure has it and a design no choice."""
        return None

    def optics(self, camera: "Camera") -> dict[str, Any]:
        """Fields of the camera that the exposure decides."""
        return {}

    def words(self, camera: "Camera") -> str:
        """The camera in a few lines, as it exposes."""
        return camera.words

    def seen(self, data: "Dataset") -> "Dataset":
        """The data as the masks see it: whole scenes."""
        return data

    def scene(self, data: "Dataset") -> "Dataset":
        """One training scene as the masks see it: its shape, and the classes."""
        return self.seen(replace(data, x_train=data.x_train[:1], y_train=data.y_train[:1]))

    def begin(self, job: Job, image_shape: tuple[int, ...], seed: "Generator") -> "Trained":
        """The exposure of a design that is to be trained on scenes of a shape."""
        # Where it has a network of its own, that is untrained
        from deepfsi.design.exposure.trained import FixedExposure

        return FixedExposure()

    def faults(self, job: Job) -> list[str]:
        """Everything that a job asks of this exposure and that cannot be had."""
        return []

    def test_faults(self, noises: Sequence[str]) -> list[str]:
        """Everything in noises of tests that cannot be had."""
        return []
