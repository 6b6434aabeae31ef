"""The optical front end as a layer: photons per pixel in, noisy features out."""

import torch
from torch import Tensor, nn

from deepfsi.base.errors import InputError
from deepfsi.physics.detection import Detection, Rails, Readouts
from deepfsi.physics.laws import FixedMasks
from deepfsi.physics.noise import Expectation, NoiseFunction, make_noise, normal


class Scanner(nn.Module):
    """Masks, detectors and their noise: (..., N) photons → (..., k) feature counts y⁺ − y⁻.

    An ordinary module: put it in front of any network and train both. Images (..., H, W) are
    flattened.

    Parameters
    ----------
    masks : FixedMasks or LearnedMasks
        Module whose rails are ([replicas,] m, N).
    noise : {"poisson", "gaussian", "ml_gauss", "camera", "click", "none"}, Noise or callable
        `poisson` is photon noise; train under it or under its smooth stand-in `ml_gauss`, and test
        under `poisson`. `camera` adds dark counts and read noise. `click` is for detectors that
        fire at most once a frame, `Click(gates)` once in each of several gates. Your own noise is a
        function from expected counts and a generator to counts, or its import path.
    sigma : float
        Read noise in counts rms per readout, for gaussian and camera noise.
    dark : float
        Expected dark counts of a detector in the whole exposure, for camera noise.
    detection : Detection, optional
        Detectors, and how two rails become features. Default: one detector, which reads the
        difference, so that k = m.

    Examples
    --------
    >>> import deepfsi, torch
    >>> rails = torch.tensor([[[0.5, 0.0]], [[0.0, 0.5]]])  # (2 rails, 1 mask, 2 pixels)
    >>> deepfsi.Scanner.from_rails(rails, noise="none")(torch.tensor([30.0, 10.0]))
    tensor([10.])
    """

    def __init__(
        self,
        masks: nn.Module,
        noise: str | NoiseFunction = "poisson",
        sigma: float = 1.0,
        dark: float = 0.0,
        detection: Detection | None = None,
    ) -> None:
        super().__init__()
        self.masks = masks
        self.noise = make_noise(noise, sigma=sigma, dark=dark)
        self.detection = detection or Detection()

    @classmethod
    def from_rails(
        cls,
        rails: Tensor,
        noise: str | NoiseFunction = "poisson",
        sigma: float = 1.0,
        dark: float = 0.0,
        detection: Detection | None = None,
    ) -> "Scanner":
        """Scanner with fixed rails (2 or 1, m, N): shares of each pixel's light.

        Parameters as for `Scanner`.
        """
        return cls(FixedMasks(rails), noise, sigma, dark, detection)

    def forward(self, photons: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Noisy features (..., [replicas,] k) of photons (..., N) or (..., H, W), in counts.

        Differentiable in the masks. Gaussian noise and `ml_gauss` are drawn once for both rails,
        which has the same distribution.
        """
        noise = self.noise
        seen = self.detection
        rails: Rails = self.masks()  # once: learned masks compute them from their weights
        arranged = rails.map(seen.arrange)
        read = seen.readouts(arranged)
        if noise.draws_rails:
            rates = self.rates(photons, rails)
            counts = seen.features(self.read(rates, generator, rails))
            light = Expectation(seen.features(rates), seen.totals(rates), read)
            return noise.gradient(counts, light)
        masks = seen.read_of(arranged)
        if not noise.depends_on_light:
            masks = Rails(masks.difference)  # spares the product with the total
        mean, total = project_rails(self._light(photons, rails), masks, seen.count)
        return mean + noise.deviation(Expectation(mean, total, read)) * normal(mean, generator)

    def counts(self, photons: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Noisy counts (..., [replicas,] rails, m · D) of photons (..., N).

        The last axis has the D detectors of the first mask, then of the next. A rail that is dark
        by construction counts 0.
        """
        return self.read(self.rates(photons), generator)

    def rates(self, photons: Tensor, rails: Rails | None = None) -> Tensor:
        """Expected counts of each rail; shapes as `counts`. Known rails save time."""
        rails = rails or self.masks()
        frames = self.detection.arrange(rails.stacked)
        return project(self._light(photons, rails), frames, self.detection.count)

    def read(
        self, rates: Tensor, generator: torch.Generator | None = None, rails: Rails | None = None
    ) -> Tensor:
        """Noisy counts of rails from their expected counts; shapes as `counts`."""
        read = self._readouts(rates.shape[-2], rails or self.masks())
        return self.noise.sample(rates, read, self.noise.dark_counts(read.time), generator)

    def dark_counts(self, rails: int) -> Tensor:
        """Expected dark counts (rails, m · D) of an exposure; a dark rail is not read out."""
        read = self._readouts(rails, self.masks())
        return torch.where(read.active, self.noise.dark_counts(read.time), 0.0)

    def _readouts(self, count: int, rails: Rails) -> Readouts:
        """Readouts (..., rails, m · D): which rails are read out, and for how long."""
        arranged = rails.map(self.detection.arrange)
        # as differences, whatever the network reads: counts are rail by rail
        both = Detection(count=self.detection.count).readouts(arranged)
        read = Readouts(*(tensor.movedim(0, -2)[..., :count, :] for tensor in both))
        return read._replace(time=read.time.detach())

    def _light(self, photons: Tensor, rails: Rails) -> Tensor:
        """Photons of scenes (..., N) or images (..., H, W), arranged by detector."""
        pixels = rails.difference.shape[-1]
        if photons.shape[-1] != pixels and photons.shape[-2:].numel() == pixels:
            photons = photons.flatten(-2)
        # masks take the type of photons: whole numbers would make them dark
        if photons.shape[-1] != pixels or not photons.is_floating_point():
            raise InputError(
                f"{photons.dtype} photons of shape {tuple(photons.shape)} do not fit masks of "
                f"{pixels} pixels: give real numbers (..., {pixels}), or images of {pixels} pixels"
            )
        return self.detection.arrange(photons)


def project(photons: Tensor, masks: Tensor, detectors: int = 1) -> Tensor:
    """Product of scenes (..., N) with masks (*lead, m, N): (..., *lead, m · detectors).

    It is computed in the type of the scenes and returned in the wider of the two types.
    """
    low = masks.flatten(0, -2).to(photons.dtype)
    if detectors == 1:
        product = photons @ low.T
    else:
        pieces = (tensor.unflatten(-1, (detectors, -1)) for tensor in (photons, low))
        product = torch.einsum("...dp,kdp->...kd", *pieces).flatten(-2)
    wider = torch.promote_types(photons.dtype, masks.dtype)
    return product.to(wider).unflatten(-1, (*masks.shape[:-2], masks.shape[-2] * detectors))


def project_rails(photons: Tensor, rails: Rails, detectors: int = 1) -> tuple[Tensor, Tensor]:
    """Products of scenes with difference and total; a single rail has one product for both."""
    if rails.count == 1:
        mean = project(photons, rails.difference, detectors)
        return mean, mean
    low = rails.map(lambda masks: masks.to(photons.dtype)).combined
    wider = torch.promote_types(photons.dtype, rails.difference.dtype)
    mean, counts = project(photons, low, detectors).to(wider).unbind(-rails.difference.ndim)
    return mean, counts
