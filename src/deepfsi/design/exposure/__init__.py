"""Kinds of exposure: what is shown when, and what the network is told.

    Fixed     every mask once, each for its own dwell; all are needed for an answer
    Range     the same for a range of budgets, and the network is told the budget
    Nested    the first masks alone give an answer, too, and the network is told how many
    Looks     several looks; the counts so far choose the dwells of the next
    Patches   an image seen patch by patch, with a detector for each patch and mask
    Passing   a scene that passes a static pattern, of which each time bin is a readout

These are the settings. What a trained design does with them is in the modules beside.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field, SerializeAsAny

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.design.exposure.base import Exposure as Exposure
from deepfsi.design.exposure.base import Job as Job
from deepfsi.design.exposure.transits import Passing as Passing

if TYPE_CHECKING:
    from torch import Generator

    from deepfsi.datasets import Dataset
    from deepfsi.design.exposure.trained import TrainedExposure as Trained


LOOKING = ("free-dwell", "two-arm")
"""Light laws under which dwells can be chosen."""

PHOTONIC = ("ml_gauss", "poisson", "camera", "none")
"""Noises under which dwells can be chosen."""


class Fixed(Exposure):
    """Every mask is shown once, for a dwell of its own, and all are needed for an answer.

    Examples
    --------
    >>> import deepfsi
    >>> deepfsi.Job(masks=10, photons=1e4).exposure == deepfsi.Fixed()
    True
    """


class Conditioned(Exposure):
    """Base of those whose network is told the budget, and how many masks were shown."""

    span: float

    def highest(self, photons: float) -> float:
        """The other end of the range."""
        return photons * self.span

    def begin(self, job: Job, image_shape: tuple[int, ...], seed: "Generator") -> "Trained":
        """One whose classifier is told budget and masks; parameters as of `Exposure.begin`."""
        from deepfsi.design.exposure.conditioned import ConditionedExposure

        width = job.features(image_shape) // job.masks
        fewest = getattr(self, "nested", 0)
        return ConditionedExposure(job.photons, self.span, job.masks, fewest, width)

    def faults(self, job: Job) -> list[str]:
        """Another training noise than MLGauss, or masks that learn under one."""
        if job.code.learned_under:
            left = f"{job.design}, whose masks learn under {job.code.learned_under} noise"
        elif job.noise != "ml_gauss":
            left = f"{job.noise} noise, or train under ml_gauss"
        else:
            return []
        return [f"a range of budgets and nested masks are trained under ml_gauss: leave out {left}"]


class Range(Conditioned):
    """One design for a range of budgets, which are log-uniform in its training.

    Examples
    --------
    >>> import deepfsi
    >>> deepfsi.Range(span=1e4).highest(1e2)
    1000000.0
    """

    # Highest budget over the lowest, `photons`; those of the training are log-uniform between
    span: float = Field(gt=1, le=1e12, description="highest budget over the lowest, `photons`")


class Nested(Conditioned):
    """One design whose first masks alone already give an answer.

    Examples
    --------
    >>> import deepfsi
    >>> deepfsi.Job(masks=16, photons=1e5, exposure=deepfsi.Nested(nested=2)).exposure.span
    1.0
    """

    # Smallest number of first masks from which the network must classify
    nested: int = Field(
        ge=1,
        description="nested masks: smallest number of first masks from which the network must "
        "classify",
    )
    # Highest budget over the lowest; 1 for one budget
    span: float = Field(1.0, ge=1, le=1e12, description="highest budget over the lowest")

    def brightest(self, masks: int) -> int:
        """Those that are shown at least."""
        return self.nested

    def faults(self, job: Job) -> list[str]:
        """Those of all conditioned ones, or more nested masks than there are."""
        found = super().faults(job)
        if self.nested > job.masks:
            found.append(
                f"the first {self.nested} of {job.masks} masks cannot be nested: give at most "
                f"{job.masks}"
            )
        return found


class Looks(Exposure):
    """Several looks of equal length: the counts so far choose the dwells of the next look.

    Examples
    --------
    >>> import deepfsi
    >>> deepfsi.Job(masks=16, photons=1e4, exposure=deepfsi.Looks(looks=4)).noise
    'poisson'
    """

    of_classes: ClassVar[bool] = True

    training: ClassVar[dict[str, Any]] = {"start": "class-pairs"}
    """On MNIST's validation images at 1e4 photons, 64 masks and 4 looks 0.866; 0.845 from pca."""

    rounds_products: ClassVar[bool] = False

    # K, each 1 / K of the exposure
    looks: int = Field(
        ge=2,
        le=64,
        description="parts (looks) of an exposure: the counts so far choose the dwells of the "
        "next part",
    )

    @property
    def parts(self) -> int:
        """K."""
        return self.looks

    def training_noise(self, noise: str) -> str:
        """The camera's own: a look shows many masks too shortly for MLGauss."""
        return noise

    def brightest(self, masks: int) -> int:
        """One: a look may show nothing else."""
        return 1

    def begin(self, job: Job, image_shape: tuple[int, ...], seed: "Generator") -> "Trained":
        """One whose network chooses dwells; parameters as of `Exposure.begin`."""
        from deepfsi.design.classifiers import Mlp
        from deepfsi.design.exposure.looks import Dwells, LooksExposure

        camera = job.optics
        dwells = Dwells.of(job.masks, camera.light, camera.rails)
        inputs = job.features(image_shape) + dwells.count + 1
        network = Mlp(inputs, dwells.count, job.training.hidden, 0.0, seed)
        return LooksExposure(dwells, network, self.looks, camera.shortest_share)

    def faults(self, job: Job) -> list[str]:
        """Designs and optics whose dwells cannot be chosen, and looks that are too short."""
        found, camera = [], job.optics
        if job.code.every_pixel or job.code.learned_under or job.code.own:
            found.append(
                f"{job.design} has one look only: several looks are for deepfsi and for named "
                "designs that one device shows"
            )
        if camera.light not in LOOKING:
            found.append(
                f"several looks choose how long one device shows each frame, not {camera.light}: "
                '`light="free-dwell"` or "two-arm" goes with them'
            )
        elif (camera.light, camera.rails, camera.readout) == ("free-dwell", "dual", "difference"):
            found.append(
                "several looks show each rail for a time of its own, whose counts are to be read "
                'by themselves: use `readout="both"`, or `rails="single"`'
            )
        found += self.test_faults([job.noise])
        if camera.shortest_share * self.looks > 1:
            found.append(
                f"a frame lasts {camera.shortest_share:g} of the exposure at least, and a look "
                f"{1 / self.looks:g}: give fewer looks, or a longer exposure"
            )
        return found

    def test_faults(self, noises: Sequence[str]) -> list[str]:
        """Noise other than that of photons."""
        strange = [noise for noise in noises if noise not in PHOTONIC]
        return [f"several looks are for photon noise: leave {noise} noise out" for noise in strange]


class Patches(Exposure):
    """An image seen patch by patch: the same masks for all patches, read by a transformer.

    A patch has a detector for each mask, and a budget is of the whole image, which the patches
    share as they share its light.

    Examples
    --------
    >>> import deepfsi
    >>> seen = deepfsi.Patches(patch=4)
    >>> deepfsi.Job(masks=8, photons=1e4, camera="paper", exposure=seen).training.classifier
    'vit'
    """

    training: ClassVar[dict[str, Any]] = {
        "start": "pca",
        "classifier": "vit",
        "epochs": 15,
        "batch": 100,
        "lr": 2e-3,
        "mask_lr": 2e-2,
        "decay": 0.05,
    }

    side_by_side: ClassVar[bool] = False
    rounds_products: ClassVar[bool] = False

    # Side of a patch, pixels. A patch has a detector for each mask, and a budget is of the whole
    # image, which the patches share as they share its light
    patch: int = Field(ge=2, description="side of a patch, pixels, of an image seen by patches")

    def seen(self, data: "Dataset") -> "Dataset":
        """Every patch of the training images as a scene of its own; no test scenes."""
        import numpy as np
        import torch

        from deepfsi.design.exposure.trained import cut

        if len(data.image_shape) != 2:
            raise InputError(f"{data.name} holds no images: patches need two sides")
        patches = cut(torch.from_numpy(data.x_train), data.image_shape, self.patch).numpy()
        return replace(
            data,
            x_train=patches.reshape(-1, self.patch**2),
            y_train=np.repeat(data.y_train, patches.shape[1], axis=0),
            x_test=np.zeros((0, self.patch**2), np.float32),
            y_test=data.y_test[:0],
            image_shape=(self.patch, self.patch),
        )

    def begin(self, job: Job, image_shape: tuple[int, ...], seed: "Generator") -> "Trained":
        """One that cuts images in patches; parameters as of `Exposure.begin`."""
        from deepfsi.design.exposure.trained import PatchExposure

        return PatchExposure(self.patch)

    def rounds_networks(self, device: str, wide: bool) -> bool:
        """True on a GPU: a processor is slower with it at a transformer's size."""
        return device == "cuda"

    def faults(self, job: Job) -> list[str]:
        """Optics that no patch has, and noise that was not tried."""
        found, camera = [], job.optics
        if camera.light != "column":
            found.append("a patch has a detector for each readout: give the light law column")
        if job.code.seeded or job.code.learned_under or job.code.own:
            found.append(f"{job.design} is not for patches: give deepfsi or a named design")
        if job.noise != "ml_gauss" or camera.mask_levels((self.patch, self.patch)):
            found.append("patches are trained under photon noise, with continuous masks")
        if job.training.classifier != "vit":
            found.append("patches are classified by a transformer: give classifier vit")
        return found


KINDS: dict[str, type[Exposure]] = {
    "looks": Looks,
    "patch": Patches,
    "nested": Nested,
    "span": Range,
    "bins": Passing,
    "speed": Passing,
    "jitter": Passing,
    "speed_jitter": Passing,
    "pattern_width": Passing,
}
"""Kind of exposure by the setting that asks for it; the first that is given counts."""

EXPOSURE_FIELDS = ("nested", "looks", "patch", *Passing.model_fields)
"""Settings that ask for an exposure by an option of their own; a range is one of budgets."""

NEUTRAL = {"looks": "1", "nested": "0", "span": "1", "patch": "0", "bins": "0"}
"""Values of these settings that ask for nothing."""


def find_exposure(given: Any) -> Any:
    """Exposure of its settings: none for `Fixed`, ``{"looks": 4}`` for `Looks`, and so on."""
    if not isinstance(given, Mapping):
        return given
    asked = {
        name: value
        for name, value in given.items()
        if str(value).removesuffix(".0") != NEUTRAL.get(name)
    }
    for name, kind in KINDS.items():
        if name not in asked:
            continue
        if strange := asked.keys() - kind.model_fields.keys():
            raise InputError(
                f"{', '.join(sorted(strange))} and {name} are of different exposures: give one"
            )
        with as_input_error():
            return kind(**asked)
    if asked:
        raise InputError(
            f"an exposure has no setting {', '.join(asked)}: give one of {', '.join(KINDS)}"
        )
    return Fixed()


AnyExposure = Annotated[SerializeAsAny[Exposure], BeforeValidator(find_exposure)]
"""Field of a model: an exposure, or its settings."""
