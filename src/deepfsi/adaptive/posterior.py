"""Prior and posterior of the scene in exposures that see their own masks, look after look.

The prior holds training scenes x_k. Other scenes lie near them: x_k + e, where e is normal with one
covariance for all k. The knowledge of e depends on k only by a term linear in x_k: one product a
readout gives the likelihoods of all scenes. The light varies with e, and counts have a negative
binomial law. With e = 0 they are Poisson counts, and this is the
posterior of the ideal observer of the same masks.

The next mask is chosen greedily. A candidate separates the likeliest classes in two groups: its
mirrors are ON where the mean scenes of the groups differ most for the photon noise that they bring.
Scenes drawn from the posterior say which candidate's counts tell most of the class.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch import Tensor
from torch.nn import functional

from deepfsi.adaptive.choice import difference_masks, draw_scenes, information
from deepfsi.base.errors import InputError
from deepfsi.camera.camera import Camera
from deepfsi.camera.light import summed_reflectance
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.designfile.design_file import Temperatures
from deepfsi.designfile.view_test import SceneModel
from deepfsi.exposure.kind import temperatures_at
from deepfsi.jobs.exposures import AdaptiveMasks
from deepfsi.physics.noise import Poisson

CENTRE_SPREAD = 1.4
"""Distance of new scenes from centres of clusters, as a multiple of that of the clusters' members.

Chosen on 1024 validation images of MNIST at 1e4 photons: with 1 the posterior is too sure.
"""

LEAST_LIGHT = 1e-6
"""Least light of a scene through a mask, over that of the whole mean scene."""

LEAST_WEIGHT = 1e-30
"""Least probability of a class that odds are taken of."""

LARGEST_SIZE = 1e9
"""Size of the negative binomial law beyond which it is Poisson's within float32."""

LIKELIHOODS_AT_ONCE = 2**22
"""Log-likelihoods in memory at a time, 16 MiB in float32."""

MOST_EXPOSURES = 32
"""Exposures that are computed at a time, at most: a thousand of them take twice as long each."""


class ScenePrior:
    """Equally likely scenes, as sums of a mean and components.

    An exposed scene lies near one of them. The difference is normal; its covariance is that of the
    differences between nearest neighbours of a class, times the square of `spread`. Components are
    scaled so that this covariance is the identity. With a spread of 0 the exposed scene is one of
    them, and components are principal components.

    With `clusters` the centres of clusters stand for the scenes, each as likely as its members
    together, and the covariance is that of the scenes about their centres, times the square of
    `CENTRE_SPREAD`.

    Shapes: x (n, N); labels (n,).
    """

    def __init__(
        self,
        x: np.ndarray,
        labels: np.ndarray,
        classes: int,
        components: int = 120,
        spread: float = 0.0,
        clusters: int | None = None,
    ) -> None:
        # rows of x by class: the scenes of the prior, or those that its centres stand for
        self.order = np.argsort(labels, kind="stable")
        scenes = torch.from_numpy(np.ascontiguousarray(x[self.order], np.float32))
        self.labels = torch.from_numpy(labels[self.order].astype(np.int64))
        self.sizes: list[int] = torch.bincount(self.labels, minlength=classes).tolist()
        self.summed_reflectance = summed_reflectance(x)
        self.spread = float(spread)
        self.mean = scenes.mean(dim=0)  # (N,)
        centred = scenes - self.mean
        vectors = torch.linalg.eigh(centred.double().T @ centred.double())[1]
        kept = vectors[:, -min(components, scenes.shape[1]) :].float()
        self.components = kept.T.contiguous()  # (d, N)
        self.coefficients = centred @ kept  # (n, d)
        self.members = torch.ones(len(self))  # training scenes that each scene stands for
        # of the classes' probabilities after each look; None before they are calibrated
        self.temperatures: Temperatures | None = None
        if clusters is not None:
            self.spread = CENTRE_SPREAD
            self._scale(self._cluster(clusters) * self.spread)
        elif spread:
            self._scale(self._neighbours() * spread)

    def __len__(self) -> int:
        """Number of scenes."""
        return len(self.labels)

    @property
    def classes(self) -> int:
        """Number of classes, C."""
        return len(self.sizes)

    @property
    def class_shares(self) -> Tensor:
        """Probabilities (C,) of the classes before any look."""
        shares = (self.members / self.members.sum()).split(self.sizes)
        return torch.stack([share.sum() for share in shares])

    @property
    def exposed_at_once(self) -> int:
        """Exposures at a time: memory holds their likelihoods, caches their masks."""
        return max(1, min(MOST_EXPOSURES, LIKELIHOODS_AT_ONCE // len(self)))

    def calibrated(self, odds: Tensor, looks: int, photons: float) -> Tensor:
        """Probabilities (..., C) of the classes of log odds (..., C) after some looks at a budget.

        A temperature divides the odds, so that without light the classes keep their shares.
        """
        shares = self.class_shares.log()
        if self.temperatures is None:
            return (odds + shares).softmax(dim=-1)
        temperature = temperatures_at(self.temperatures, looks - 1, photons).to(shares)
        return (odds / temperature + shares).softmax(dim=-1)

    def light(self, masks: Tensor) -> tuple[Tensor, Tensor]:
        """Light of the mean scene through masks (..., N), and of each component (..., d)."""
        return masks @ self.mean, masks @ self.components.T

    @property
    def model(self) -> SceneModel | None:
        """Normal scenes of each class with the same moments; None of too few scenes."""
        members = self.members.numpy().astype(float)
        labels = self.labels.numpy()
        sizes = np.bincount(labels, members, minlength=self.classes)
        if not SceneModel.are_enough(sizes):
            return None
        scenes = self.coefficients.double().numpy()
        centres = np.stack([
            np.average(scenes[labels == k], axis=0, weights=members[labels == k])
            for k in range(self.classes)
        ])  # fmt: skip
        scale = np.sqrt(members / (sizes.sum() - self.classes))[:, None]
        residuals = (scenes - centres[labels]) * scale
        identity = np.eye(scenes.shape[1])
        if members.max() > 1:  # scenes lie about the centres that stand for them
            residuals = np.concatenate([residuals, identity])
        components = self.components.double().numpy()
        # fewer scenes than components leave the square singular
        square = np.linalg.cholesky(residuals.T @ residuals + 1e-9 * identity).T @ components
        means = self.mean.double().numpy() + centres @ components
        return SceneModel.of(means, square, sizes / sizes.sum())

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All that a file needs, coefficients in 8 bits: n · (d + 4) bytes, and N · d · 4."""
        steps = self.coefficients.abs().amax(dim=0).clamp(min=1e-12) / 127
        levels = (self.coefficients / steps).round().to(torch.int8)
        tensors = {"mean": self.mean, "components": self.components}
        tensors |= {"steps": steps, "levels": levels}
        temperatures = vars(self.temperatures) if self.temperatures else {}
        return {
            **{name: tensor.numpy() for name, tensor in tensors.items()},
            "sizes": np.array(self.sizes),
            "members": self.members.numpy().astype(np.int32),
            "numbers": np.array([self.summed_reflectance, self.spread]),
            **{f"temperature_{name}": array for name, array in temperatures.items()},
        }

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray]) -> "ScenePrior":
        """Prior from the `arrays` of a design file, without training data."""
        # `__init__` takes scenes, which a file does not hold
        prior = cls.__new__(cls)
        prior.sizes = arrays["sizes"].tolist()
        prior.labels = torch.arange(len(prior.sizes)).repeat_interleave(torch.tensor(prior.sizes))
        prior.members = torch.from_numpy(arrays["members"]).float()
        prior.summed_reflectance, prior.spread = arrays["numbers"].tolist()
        prior.mean = torch.from_numpy(arrays["mean"])
        prior.components = torch.from_numpy(arrays["components"])
        levels = torch.from_numpy(arrays["levels"]).float()
        prior.coefficients = levels * torch.from_numpy(arrays["steps"])
        prior.temperatures = None
        if "temperature_logs" in arrays:
            fitted = {name: arrays[f"temperature_{name}"] for name in ("logs", "budgets")}
            prior.temperatures = Temperatures.restored(fitted, len(fitted["logs"]))
        return prior

    def subset(self, count: int, seed: int = 0) -> "ScenePrior":
        """Prior of about `count` of the scenes, at least one of each class."""
        rng = np.random.default_rng(seed)
        sizes = np.array(self.sizes)
        kept = np.minimum(sizes, np.maximum(sizes * count // len(self), 1))
        starts = np.cumsum([0, *sizes[:-1]])
        rows = [
            start + np.sort(rng.choice(size, number, replace=False))
            for start, size, number in zip(starts, sizes, kept, strict=True)
        ]
        arrays = self.arrays
        chosen = {name: arrays[name][np.concatenate(rows)] for name in ("levels", "members")}
        return ScenePrior.restored(arrays | chosen | {"sizes": kept})

    def _cluster(self, clusters: int) -> Tensor:
        """Replace the scenes by centres of clusters; differences (n, d) of scenes from them."""
        from sklearn.cluster import KMeans

        centres = []
        members = []
        differences = []
        for scenes in self.coefficients.split(self.sizes):
            with threadpool_limits(1):  # threads would add up in any order
                means = KMeans(clusters, random_state=0).fit(scenes.numpy())
            cluster = torch.from_numpy(means.labels_).long()
            members.append(torch.bincount(cluster, minlength=clusters).float())
            if not members[-1].all():
                raise InputError(
                    f"a class has fewer than {clusters} different scenes: give fewer `clusters`"
                )
            sums = torch.zeros(clusters, scenes.shape[1]).index_add_(0, cluster, scenes)
            centres.append(sums / members[-1][:, None])
            differences.append(scenes - centres[-1][cluster])
        self.sizes = [clusters] * self.classes
        self.labels = torch.arange(self.classes).repeat_interleave(clusters)
        self.coefficients = torch.cat(centres)
        self.members = torch.cat(members)
        return torch.cat(differences)

    def _neighbours(self) -> Tensor:
        """Differences (n, d) of up to 3000 scenes from their nearest neighbours of their class."""
        # cdist compares each with all scenes of its class: 3000 bound its time
        order = torch.randperm(len(self), generator=torch.Generator().manual_seed(0))
        chosen = order[:3000].sort().values
        starts = np.cumsum([0, *self.sizes[:-1]])
        differences = [self.coefficients[:0]]
        by_class = self.coefficients.split(self.sizes)
        for start, scenes in zip(starts.tolist(), by_class, strict=True):
            rows = chosen[(chosen >= start) & (chosen < start + len(scenes))] - start
            if len(scenes) < 2:
                continue
            distances = torch.cdist(scenes[rows], scenes)
            # a scene is not its own neighbour
            distances[torch.arange(len(rows)), rows] = torch.inf
            differences.append(scenes[rows] - scenes[distances.argmin(dim=1)])
        return torch.cat(differences)

    def _scale(self, differences: Tensor) -> None:
        """Scale components so that the covariance of differences (n, d) is the identity."""
        differences = differences.double()
        if not differences.any():
            raise InputError(
                "no scene of a class differs from the one most like it, and adaptive masks learn "
                "from how scenes differ: give more scenes, without copies"
            )
        covariance = differences.T @ differences / len(differences)
        # in directions in which scenes hardly differ, noise of a few would pass for certainty;
        # a direction without differences would have infinite coefficients
        least = 1e-3 * covariance.diagonal().mean()
        covariance += least * torch.eye(len(covariance), dtype=torch.double)
        variances, vectors = torch.linalg.eigh(covariance)
        self.components = (vectors * variances.sqrt()).float().T.contiguous() @ self.components
        self.coefficients = self.coefficients @ (vectors / variances.sqrt()).float()


@dataclass(frozen=True, eq=False)
class LookOptics:
    """Optics of a look: one mirror device, one or several detectors, one arm or both."""

    photons: float  # budget Φ of a whole exposure
    dark: float | Tensor = 0.0  # (arms * D,)
    arms: int = 1  # 2 if the light of mirrors that are OFF is counted, too
    detectors: Tensor | None = None  # (N,), detector of each pixel, 0 .. D-1

    @classmethod
    def of(cls, camera: Camera, image_shape: tuple[int, ...], photons: float) -> "LookOptics":
        """Optics of a camera that counts; `InputError` where it clicks, or shows no such masks."""
        AdaptiveMasks.check_camera(camera)
        if camera.clicks is not None:
            raise InputError(
                f"this design is for photon counts, and {camera.noise_name} noise is of clicks: "
                'give `noise="poisson"`, or learn a design for clicks'
            )
        labels = camera.detector_map(image_shape).labels
        arms = LIGHT_LAWS[camera.light].arms
        detectors = None if labels is None else torch.from_numpy(labels)
        return cls(photons, camera.dark_counts, arms, detectors=detectors)

    @property
    def dark_sum(self) -> float:
        """Sum of the dark counts over all readouts of an exposure."""
        return float(torch.as_tensor(self.dark).sum())

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


def sum_by_class(weights: Tensor, sizes: Sequence[int]) -> Tensor:
    """Class probabilities (b, C) of probabilities (b, n) of scenes that are sorted by class."""
    by_class = weights.split(list(sizes), dim=1)
    sums = torch.stack([scenes.sum(dim=1) for scenes in by_class], dim=1)
    return sums / sums.sum(dim=1, keepdim=True)


def confidence_of(probabilities: Tensor) -> Tensor:
    """Probability (...) of the likeliest class, of (..., C), in double precision."""
    # 1 less the rest: small probabilities keep their digits where the likeliest rounds to 1
    rest = probabilities.scatter(-1, probabilities.argmax(dim=-1, keepdim=True), 0.0)
    return 1 - rest.double().sum(dim=-1)


class Look(NamedTuple):
    """One look of exposures."""

    masks: Tensor  # (b, N) of 0 and 1
    counts: Tensor  # (b, Q)
    light: Tensor  # (b, Q), counts that are expected without dark ones


class AdaptivePosterior:
    """Posterior of the scene in b exposures that see masks of their own."""

    def __init__(self, prior: ScenePrior, exposures: int, optics: LookOptics) -> None:
        self.prior = prior
        self.optics = optics
        # counts of one fully reflecting pixel in a whole exposure
        self.gain = optics.photons / prior.summed_reflectance
        d = prior.coefficients.shape[1]
        frequent = (prior.members / prior.members.max()).log()
        # log-probabilities of the scenes, up to a constant
        self.log_weights = torch.zeros(exposures, len(prior)) + frequent
        # (b, r, d), one direction for each readout so far: Σ = 1 − their sum of squares
        self._known_directions = torch.zeros(exposures, 0, d)
        self._shift = torch.zeros(exposures, d)  # mean of e of the mean scene
        self._looks = 0
        self._weights: Tensor | None = None
        self._class_sums: Tensor | None = None

    def __len__(self) -> int:
        """Number of exposures, b."""
        return len(self.log_weights)

    def rows_of(self, rows: Tensor) -> Self:
        """Posterior of the exposures where `rows` (b,) is true."""
        kept = copy(self)
        kept.log_weights = self.log_weights[rows]
        kept._known_directions = self._known_directions[rows]
        kept._shift = self._shift[rows]
        kept._weights = kept._class_sums = None
        return kept

    def next_masks(self, share: float, generator: torch.Generator) -> Tensor:
        """The next masks (b, N) of 0 and 1, for a share of the exposure."""
        masks = self.candidates()
        indices, drawn = draw_scenes(self.weights, generator, 128)
        mean, responses = self._light(masks)  # (b, P, Q), (b, P, Q, d)
        unseen = self.times_covariance(responses)
        scenes = self.prior.coefficients[indices].transpose(1, 2)  # (b, d, S), same for all masks
        light = mean[..., None] + (unseen.flatten(1, 2) @ scenes).unflatten(1, mean.shape[1:])
        gain = self.gain * share
        dark = torch.as_tensor(self.optics.dark * share)[..., None]
        # a sum of mean and components may fall below 0, light does not
        counts = light.clamp(min=0) * gain + dark
        unknown = unseen @ responses.transpose(2, 3) if self.prior.spread else None
        if unknown is not None:
            # a small change of a count n is 1 / √n times as large on the scale 2 √n
            mean_counts = (counts * drawn[:, None, None]).sum(dim=-1, keepdim=True)
            scale = mean_counts.clamp(min=1e-6).rsqrt() * gain
            unknown = unknown * scale * scale.transpose(2, 3)
        members = functional.one_hot(self.prior.labels[indices], self.prior.classes)
        best = information(counts, members * drawn[..., None], unknown).argmax(dim=1)
        return masks[torch.arange(len(masks)), best]

    def candidates(self) -> Tensor:
        """Masks (b, P, N) that separate the likeliest classes in two groups."""
        differ = self.group_differences()
        # a black pixel would have an infinite difference over its light
        scene = self.scene.clamp(min=1e-3)[:, None]  # reflectance of the mean scene at least
        areas = self.optics.areas(scene)
        return difference_masks(differ, scene.expand_as(differ), areas, self.optics.arms)

    def group_differences(self) -> Tensor:
        """Differences (b, P, N) of the mean scenes of two groups of the likeliest classes.

        On one arm either group is the brighter one; on two the masks of both are the same.
        """
        probabilities = self.class_probabilities
        sums = self.class_sums
        count = min(4, probabilities.shape[1])  # classes that a mask is to separate at most
        likely, top = probabilities.topk(count, dim=1)
        likeliest = sums.gather(1, top[..., None].expand(-1, -1, sums.shape[-1]))
        # the bits of each number part the classes in two groups; the last is always in the second,
        # or each pair of groups would come twice
        numbers = torch.arange(1, 2 ** (count - 1))
        groups = (numbers[:, None] >> torch.arange(count) & 1).to(sums.dtype)
        means = [
            (group @ likeliest) / (likely @ group.T).clamp(min=1e-9)[..., None]
            for group in (groups, 1 - groups)
        ]
        differ = self.times_covariance(means[0] - means[1]) @ self.prior.components
        return torch.cat([differ, -differ], dim=1) if self.optics.arms == 1 else differ

    def look_at(self, x: Tensor, share: float, generator: torch.Generator) -> Look:
        """Draw the next look at scenes (b, N); `update` takes it in."""
        masks = self.next_masks(share, generator)
        expected = self.expected(masks, x, share)
        light = expected - self.optics.dark * share
        return Look(masks, Poisson().draw(expected, generator), light)

    def misfit(self, masks: Tensor, counts: Tensor, share: float) -> Tensor:
        """Squared distance (b,) of counts (b, Q) behind the next masks (b, N) from those expected.

        Its metric is the covariance of the counts, so that its mean is Q where scenes are as the
        prior has them.
        """
        mean, responses = self._light(masks)
        gain = self.gain * share
        dark = torch.as_tensor(self.optics.dark * share)
        unseen = self.times_covariance(responses)
        weights = self.weights[..., None]
        scenes = unseen @ self.prior.coefficients.T  # (b, Q, n)
        of_mean = scenes @ weights
        deviations = scenes - of_mean
        light = (mean + of_mean[..., 0]).clamp(min=0)
        expected = light * gain + dark
        covariance = (deviations * weights[:, None, :, 0]) @ deviations.transpose(1, 2)
        if self.prior.spread:
            covariance = covariance + unseen @ responses.transpose(1, 2)
        noise = torch.diag_embed(expected.clamp(min=1e-6))
        residuals = (counts - expected)[..., None]
        solved = torch.linalg.solve(covariance * gain**2 + noise, residuals)
        return (residuals * solved)[..., 0].sum(dim=1)

    def expected(self, masks: Tensor, x: Tensor, share: float) -> Tensor:
        """Expected counts (b, Q) of scenes (b, N) behind masks (b, N)."""
        light = (self.optics.readouts(masks) @ x[..., None])[..., 0]
        return light * (self.gain * share) + self.optics.dark * share

    def update(self, masks: Tensor, counts: Tensor, share: float) -> None:
        """Take in counts (b, Q) behind masks (b, N) that were shown for a share of the exposure."""
        posterior_mean = self.class_sums.sum(dim=1)  # (b, d), before this look
        mean, responses = self.prior.light(self.optics.readouts(masks))
        dark = torch.as_tensor(self.optics.dark * share, dtype=torch.double)
        darks = dark.expand(counts.shape[1]).tolist()
        gain = self.gain * share
        for counted, mean_light, response, dark_counts in zip(
            counts.unbind(1), mean.unbind(1), responses.unbind(1), darks, strict=True
        ):
            self._take(posterior_mean, counted, mean_light, response, gain=gain, dark=dark_counts)
        self._end_look()

    def _take(
        self,
        posterior_mean: Tensor,
        counts: Tensor,
        mean_light: Tensor,
        response: Tensor,
        gain: float,
        dark: float,
    ) -> None:
        """Take in a readout: counts (b,), light of the mean scene (b,) and of components (b, d)."""
        # With n counts, a response a, a gain g, rates μ_k of the scenes, μ of the mean one and Σ of
        # e, light of a variance v = aᵀΣa makes counts negative binomial, of a size s = μ²/(g²v):
        #     log p_k += n log(μ_k/μ) − (n + s) log1p((μ_k/μ − 1) μ/(μ + s))
        # and the mean and covariance of e follow as those of a normal law:
        #     e += Σa (n − μ_e)/(g (v + μ/g²)),   Σ −= Σa aᵀΣ/(v + μ/g²)
        least = LEAST_LIGHT * float(self.prior.mean.sum())
        unseen = self.times_covariance(response)  # Σa
        offset = mean_light + (response * self._shift).sum(dim=1)
        rate = (offset + (unseen * posterior_mean).sum(dim=1)).clamp(min=least) * gain + dark
        light = torch.addmm(offset[:, None], unseen, self.prior.coefficients.T)
        light = light.clamp_(min=least)
        # relative to the mean scene: differences of likelihoods alone need float32's digits
        ratio = light.mul_(gain).add_(dark).div_(rate[:, None])
        self.log_weights.addcmul_(ratio.log(), counts[:, None])
        if not self.prior.spread:
            self.log_weights.sub_(ratio.sub_(1).mul_(rate[:, None]))
            return
        variance = (response * unseen).sum(dim=1).clamp(min=0)
        size = (rate**2 / (variance * gain**2)).clamp(max=LARGEST_SIZE)[:, None]
        share = rate[:, None] / (rate[:, None] + size)
        self.log_weights.sub_(ratio.sub_(1).mul_(share).log1p_().mul_(counts[:, None] + size))
        total = variance + rate / gain**2
        innovation = ((counts - dark) / gain - offset) / total
        self._shift = self._shift + unseen * innovation[:, None]
        known = (unseen / total.sqrt()[:, None])[:, None]
        self._known_directions = torch.cat([self._known_directions, known], dim=1)

    def _end_look(self) -> None:
        """Count a look, and drop the stored probabilities: the counts changed them."""
        self._weights = self._class_sums = None
        self._looks += 1

    def times_covariance(self, vectors: Tensor) -> Tensor:
        """Product (b, ..., d) of the covariance of e, given the counts, with (b, ..., d)."""
        known = self._known_directions
        if not known.shape[1]:
            return vectors
        flat = vectors.flatten(1, -2) if vectors.dim() > 2 else vectors[:, None]
        # Σ is the identity before all looks
        flat = flat - (flat @ known.transpose(1, 2)) @ known
        return flat.view(vectors.shape)

    def _light(self, masks: Tensor) -> tuple[Tensor, Tensor]:
        """Light (b, ..., Q) of the mean scene and the mean of e, and of components (b, ..., Q, d).

        Masks are (b, ..., N).
        """
        mean, responses = self.prior.light(self.optics.readouts(masks))
        shift = (responses.flatten(1, -2) @ self._shift[..., None])[..., 0]
        return mean + shift.view(mean.shape), responses

    @property
    def weights(self) -> Tensor:
        """Probabilities (b, n) of the scenes of the prior."""
        if self._weights is None:
            self._weights = self.log_weights.softmax(dim=1)
        return self._weights

    @property
    def class_sums(self) -> Tensor:
        """Sums (b, C, d) over each class of coefficients times probabilities of its scenes."""
        if self._class_sums is None:
            sizes = self.prior.sizes
            weights = self.weights.split(sizes, 1)
            scenes = self.prior.coefficients.split(sizes)
            sums = [w @ x for w, x in zip(weights, scenes, strict=True)]
            self._class_sums = torch.stack(sums, dim=1)
        return self._class_sums

    @property
    def class_probabilities(self) -> Tensor:
        """Sums (b, C) of the probabilities of scenes over the classes."""
        return sum_by_class(self.weights, self.prior.sizes)

    @property
    def odds(self) -> Tensor:
        """Logarithms (b, C) of the probabilities of the classes over those before all looks."""
        probabilities = self.class_probabilities.clamp(min=LEAST_WEIGHT)
        return probabilities.log() - self.prior.class_shares.log()

    @property
    def probabilities(self) -> Tensor:
        """Calibrated probabilities (b, C) of the classes."""
        if self.prior.temperatures is None or not self._looks:
            return self.class_probabilities
        return self.prior.calibrated(self.odds, self._looks, self.optics.photons)

    @property
    def scene(self) -> Tensor:
        """Mean scene (b, N) of the posterior."""
        coefficients = self._shift + self.times_covariance(self.class_sums.sum(dim=1))
        return self.prior.mean + coefficients @ self.prior.components
