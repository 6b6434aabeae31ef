"""Posterior of the scene in exposures that see masks of their own, look after look.

Scenes near a scene k of the prior are x_k + e, with a normal e whose covariance is the same for all
k. What the counts tell of e is the same for all k, too, but for a term that is linear in the scene:
the likelihood of all scenes takes one product a readout, as for e = 0. Counts are then those of a
negative binomial law, Poisson counts of a light that varies about its mean as e makes it; with
e = 0 they are Poisson counts, and this is the posterior of the ideal observer of the same masks.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.camera import LIGHT_LAWS, Camera
from deepfsi.exposure.prior import ScenePrior
from deepfsi.exposure.temperatures import temperatures_at
from deepfsi.jobs import AdaptiveMasks

DIMMEST = 1e-6
"""Least light of a scene through a mask, over that of the whole mean scene."""

LEAST_WEIGHT = 1e-30
"""Least probability of a class that odds are taken of."""

LARGEST_SIZE = 1e9
"""Size of the negative binomial law beyond which it is Poisson's within float32."""


@dataclass(frozen=True, eq=False)
class LookOptics:
    """Optics of a look: one mirror device, one or several detectors, one arm or both.

    Parameters
    ----------
    photons : float
        Budget Φ of a whole exposure.
    dark : float or tensor, shape (arms * D,)
        Dark counts of each detector, or of each readout, in a whole exposure.
    arms : int
        2 if the light of mirrors that are OFF is counted, too.
    detectors : tensor, shape (N,), optional
        Detector of each pixel, 0 .. D-1; one detector unless given.
    """

    photons: float
    dark: float | Tensor = 0.0
    arms: int = 1
    detectors: Tensor | None = None

    @classmethod
    def of(cls, camera: Camera, image_shape: tuple[int, ...], photons: float) -> "LookOptics":
        """Optics of a camera; `InputError` where it shows no binary masks, or has read noise."""
        AdaptiveMasks.check_camera(camera)
        labels, arms = camera.detector_map(image_shape).labels, LIGHT_LAWS[camera.light].arms
        detectors = None if labels is None else torch.from_numpy(labels)
        return cls(photons, camera.dark_counts, arms, detectors)

    def areas(self, masks: Tensor) -> Tensor:
        """Pixels (D, N) of each detector, 1 where it sees them."""
        if self.detectors is None:
            return masks.new_ones(1, masks.shape[-1])
        count = int(self.detectors.max()) + 1
        return functional.one_hot(self.detectors, count).T.to(masks.dtype)

    def readouts(self, masks: Tensor) -> Tensor:
        """Pixels that each readout sees (..., arms · D, N), of masks (..., N)."""
        rails = torch.stack([masks, 1 - masks] if self.arms == 2 else [masks], dim=-2)
        if self.detectors is None:
            return rails
        return (rails[..., None, :] * self.areas(masks)).flatten(-3, -2)

    def count(self, masks: Tensor, x: Tensor, share: float, gain: float) -> Tensor:
        """Expected counts (b, Q) of scenes (b, N) for a share of the exposure, Φ / s = gain."""
        seen = self.readouts(masks)
        return (seen @ x[..., None])[..., 0] * (gain * share) + self.dark * share


def class_chances(weights: Tensor, sizes: Sequence[int]) -> Tensor:
    """Class probabilities (b, C) of probabilities (b, n) of scenes that are sorted by class."""
    sums = torch.stack([part.sum(dim=1) for part in weights.split(list(sizes), dim=1)], dim=1)
    return sums / sums.sum(dim=1, keepdim=True)


class AdaptivePosterior:
    """Posterior of the scene in b exposures that see masks of their own.

    Parameters
    ----------
    prior : ScenePrior
    exposures : int
        b.
    optics : LookOptics
    """

    def __init__(self, prior: ScenePrior, exposures: int, optics: LookOptics) -> None:
        self.prior, self.optics = prior, optics
        self.gain = optics.photons / prior.summed_reflectance
        """Counts of one fully reflecting pixel in a whole exposure."""
        d = prior.coefficients.shape[1]
        frequent = (prior.members / prior.members.max()).log()
        self.logs = torch.zeros(exposures, len(prior)) + frequent
        """Log-probabilities of the scenes, up to a constant."""
        self._known = torch.zeros(exposures, 0, d)  # directions in which e is known by now
        self._shift = torch.zeros(exposures, d)  # mean of e of the mean scene
        self._looks = 0
        self._weights: Tensor | None = None
        self._class_sums: Tensor | None = None

    def __len__(self) -> int:
        """Number of exposures, b."""
        return len(self.logs)

    def part(self, rows: Tensor) -> "AdaptivePosterior":
        """Posterior of some of the exposures, (b,) true."""
        some = AdaptivePosterior(self.prior, 0, self.optics)
        some.logs, some._known, some._shift = self.logs[rows], self._known[rows], self._shift[rows]
        some._looks = self._looks
        return some

    def expected(self, masks: Tensor, x: Tensor, share: float) -> Tensor:
        """Expected counts (b, Q) of scenes (b, N) behind masks (b, N) for a share of the whole."""
        return self.optics.count(masks, x, share, self.gain)

    def update(self, masks: Tensor, counts: Tensor, share: float) -> None:
        """Take in counts (b, Q) behind masks (b, N) that were shown for a share of the exposure."""
        here = self.class_sums.sum(dim=1)  # (b, d): mean scene of the posterior before this look
        mean, parts = self.prior.light(self.optics.readouts(masks))
        dark = torch.as_tensor(self.optics.dark * share, dtype=torch.double)
        darks = dark.expand(counts.shape[1]).tolist()
        for each, at_mean, through, own in zip(
            counts.unbind(1), mean.unbind(1), parts.unbind(1), darks, strict=True
        ):
            self._take(here, each, at_mean, through, self.gain * share, own)
        self._weights = self._class_sums = None
        self._looks += 1

    def _take(
        self,
        here: Tensor,
        counts: Tensor,
        at_mean: Tensor,
        through: Tensor,
        gain: float,
        dark: float,
    ) -> None:
        """One readout: counts (b,), light of the mean scene (b,) and of the components (b, d)."""
        least = DIMMEST * float(self.prior.mean.sum())
        left = self.unknown(through)  # what scenes change of the light, given all before
        offset = at_mean + (through * self._shift).sum(dim=1)
        usual = (offset + (left * here).sum(dim=1)).clamp(min=least) * gain + dark
        light = torch.addmm(offset[:, None], left, self.prior.coefficients.T).clamp_(min=least)
        # relative to the mean scene: differences of likelihoods alone need float32's digits
        ratio = light.mul_(gain).add_(dark).div_(usual[:, None])
        self.logs.addcmul_(ratio.log(), counts[:, None])
        if not self.prior.spread:
            self.logs.sub_(ratio.sub_(1).mul_(usual[:, None]))
            return
        variance = (through * left).sum(dim=1).clamp(min=0)
        size = usual**2 / (variance * gain**2).clamp(min=1e-30)
        size = size.clamp(max=LARGEST_SIZE)[:, None]
        part = usual[:, None] / (usual[:, None] + size)
        self.logs.sub_(ratio.sub_(1).mul_(part).log1p_().mul_(counts[:, None] + size))
        total = variance + usual / gain**2
        found = ((counts - dark) / gain - offset) / total
        self._shift = self._shift + left * found[:, None]
        self._known = torch.cat([self._known, (left / total.sqrt()[:, None])[:, None]], dim=1)

    def unknown(self, parts: Tensor) -> Tensor:
        """Product (b, ..., d) of the covariance of e, given the counts, with (b, ..., d)."""
        if not self._known.shape[1]:
            return parts
        flat = parts.flatten(1, -2) if parts.dim() > 2 else parts[:, None]
        flat = flat - (flat @ self._known.transpose(1, 2)) @ self._known
        return flat.view(parts.shape)

    def seen(self, parts: Tensor) -> Tensor:
        """Light (b, ...) that the mean of e adds to that of the mean scene, of (b, ..., d)."""
        return (parts.flatten(1, -2) @ self._shift[..., None])[..., 0].view(parts.shape[:-1])

    @property
    def weights(self) -> Tensor:
        """Probabilities (b, n) of the scenes of the prior."""
        if self._weights is None:
            self._weights = self.logs.softmax(dim=1)
        return self._weights

    @property
    def class_sums(self) -> Tensor:
        """Sums (b, C, d) of the coefficients of scenes by their probabilities, over classes."""
        if self._class_sums is None:
            self._class_sums = self.prior.mean_classes(self.weights)
        return self._class_sums

    @property
    def class_weights(self) -> Tensor:
        """Sums (b, C) of the probabilities of scenes over the classes."""
        return class_chances(self.weights, self.prior.sizes)

    @property
    def chances(self) -> Tensor:
        """Probabilities (b, C) of the classes: sums of scenes, calibrated where few are known.

        A temperature τ makes of the odds of classes to those before all looks their power 1 / τ.
        Without light the classes keep their shares.
        """
        fitted = self.prior.temperatures
        if fitted is None or not self._looks:
            return self.class_weights
        shares = self.prior.class_shares.log()
        budget = torch.tensor([self.optics.photons], dtype=torch.double)
        temperature = temperatures_at(fitted, self._looks - 1, budget).to(shares)
        odds = self.class_weights.clamp(min=LEAST_WEIGHT).log() - shares
        return (odds / temperature + shares).softmax(dim=1)

    @property
    def scene(self) -> Tensor:
        """Mean scene (b, N) of the posterior."""
        here = self._shift + self.unknown(self.class_sums.sum(dim=1))
        return self.prior.mean + here @ self.prior.components
