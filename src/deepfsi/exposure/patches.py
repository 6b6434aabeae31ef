"""Training on images that are seen patch by patch: one job alone trains on them."""

from torch import Tensor

from deepfsi.exposure.trained import PatchExposure
from deepfsi.exposure.training import ExposureTraining, JobGroup, deviation
from deepfsi.jobs import Patches
from deepfsi.physics import Draws, Scanner, project


class PatchTraining(ExposureTraining):
    """Masks of patches, and the features of every patch of images."""

    def __init__(self, group: JobGroup) -> None:
        super().__init__(group)
        asked = self.job.exposure
        assert isinstance(asked, Patches)
        exposure = PatchExposure(asked.patch)
        self.exposures = [exposure]
        self.tokens = exposure.tokens(self.training_set.data.image_shape)
        self.masks = self.learned_masks() if self.learns else self.fixed_masks(self.named_rails())

    def prepare(self) -> None:
        """Cut images (n, P, N) to patches of the pixels that the masks have."""
        lit = self.scenes.varying
        patches = self.scenes.full.view(-1, self.tokens, self.scenes.data.pixels)
        self.x = patches[..., lit] if self.learns and not lit.all() else patches
        self.mean = self.x.mean(dim=(0, 1))
        self.scanner = Scanner(self.masks, self.noise.of_jobs(slice(1)).kind)
        self.photons = float(self.noise.gain)

    def inputs(self, draws: Draws) -> Tensor:
        """Features (B, 1, P, m), standardised in their batch."""
        [stream] = draws.streams
        counts = self.scanner(self.x[stream.rows] * self.photons, stream.generator)
        counts = counts / self.photons
        features = (counts - project(self.mean, self.masks().difference)).squeeze(2)
        over = (0, 1) if self.scale == "each" else (0, 1, 2)
        std = deviation(features.square().mean(dim=over), "each")
        return (features / std).unsqueeze(1)
