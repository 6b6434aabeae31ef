"""Features of a training step: products of scenes with masks, noise, standardisation."""

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi.design.adaptive import expose
from deepfsi.design.classifiers import Replicas
from deepfsi.design.conditioning import Conditioning, chances, first
from deepfsi.optics import constraints
from deepfsi.optics.masks import Fixed, Learned
from deepfsi.optics.noise import root
from deepfsi.optics.scanner import lit, measure, project, project_pair
from deepfsi.training.draws import FeatureNoise, SeedStream, side_by_side
from deepfsi.training.job import Job, products
from deepfsi.training.training_set import TrainingSet

CHUNK = 4096
"""Scenes that are multiplied at once outside the steps."""


def statistics(
    scenes: TrainingSet, jobs: Sequence[Job], masks: Fixed | Learned, means: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Mean and spread of the features over the training set and its noise, and mean x S.

    Parameters
    ----------
    scenes : TrainingSet
    jobs : sequence of Job
    masks : Fixed or Learned
    means : tensor, shape (n, R or 1, m), optional
        x D of all training scenes, where it is known.

    Returns
    -------
    tuple of tensor
        Each (R, m), for scenes of unit reflectance: to be divided by `TrainingSet.light`.
    """
    difference, total = masks()
    centre, light = (project(scenes.full.mean(dim=0), rails) for rails in (difference, total))
    power = torch.zeros_like(centre)
    for place, x in enumerate(scenes.full.split(CHUNK)):
        rows = slice(place * CHUNK, place * CHUNK + len(x))
        mean = project(x, difference) if means is None else means[rows]
        power += (mean - centre).square().sum(dim=0)
    noise = FeatureNoise(scenes, jobs).variance(light, lit(difference, total))
    often = torch.ones_like(power[0])
    if jobs[0].training.told:
        factor, often = _exposures(jobs[0], constraints.separate(difference, total))
        noise = noise * factor
    power = power / len(scenes.full) + noise
    if jobs[0].training.scale == "common":
        power = (power * often).sum(dim=-1, keepdim=True) / often.sum()
        power = power.expand_as(noise)
    spread = torch.where(power > 0, power, 1.0).sqrt()
    return centre.expand_as(spread), spread, light.expand_as(spread)


def _exposures(job: Job, rails: Tensor) -> tuple[Tensor, Tensor]:
    """What budgets and numbers of masks do to the noise of each mask in the mean of training.

    Returns
    -------
    factor : tensor, shape (R or 1, m)
        Noise variance over that of the lowest budget and all masks, in the mean over exposures that
        show the mask.
    often : tensor, shape (m,)
        In how many exposures it is shown.
    """
    used = constraints.used(rails, job.optics[0])
    span, likely = job.training.span, chances(job.masks, job.training.nested).to(used)
    dim = (1 - 1 / span) / math.log(span) if span > 1 else 1.0
    later = (likely * used / used[..., -1:]).flip(-1).cumsum(-1).flip(-1)
    often = likely.flip(-1).cumsum(-1).flip(-1)
    return dim * later / often, often


def step_features(
    scenes: TrainingSet, jobs: Sequence[Job], masks: Fixed | Learned, choose: Replicas
) -> Callable[[Sequence["SeedStream"], int], Tensor]:
    """How a step gets the inputs of classifiers: features (B, R, m), and what is told."""
    job = jobs[0]
    if job.training.looks > 1:
        return _chosen(scenes, jobs, masks, choose)
    if job.training.told:
        return _told(scenes, jobs, masks)
    if isinstance(masks, Fixed):
        return _measured(scenes, jobs, masks)
    x = scenes.centred(job.light, products(job, scenes.device))
    scale = job.training.scale
    if job.noise == "ml_gauss":

        def learned(streams: Sequence[SeedStream], step: int) -> Tensor:
            rails = masks.rails_to_measure()
            return _standardise(
                side_by_side(
                    [
                        measure(
                            x.index_select(0, stream.with_mean[step]),
                            rails[..., stream.jobs, :, :],
                            stream.normal(job.masks) * stream.noise.unit,
                            masks.disjoint,
                        )
                        for stream in streams
                    ]
                ),
                scale,
            )

        return learned

    if job.noise == "poisson":

        def learned_from_counts(streams: Sequence[SeedStream], step: int) -> Tensor:
            difference, total = masks()
            parts = []
            for stream in streams:
                seen = x.index_select(0, stream.with_mean[step])
                own = (difference[stream.jobs], total[stream.jobs])
                mean, light = project_pair(seen, *own, both=True)
                counts = stream.noise.counted(mean[:-1] + mean[-1], light[:-1] + light[-1])
                parts.append(counts - mean[-1])
            return _standardise(side_by_side(parts), scale)

        return learned_from_counts

    def learned_under_read_noise(streams: Sequence[SeedStream], step: int) -> Tensor:
        difference, total = masks()
        shown = masks.lit(difference, total)
        parts = []
        for stream in streams:
            mean = project(x.index_select(0, stream.rows[step]), difference[stream.jobs])
            deviation = stream.noise.deviation(mean, shown[stream.jobs])
            parts.append(mean + deviation * stream.normal(job.masks))
        return _standardise(side_by_side(parts), scale)

    return learned_under_read_noise


def _told(
    scenes: TrainingSet, jobs: Sequence[Job], masks: Fixed | Learned
) -> Callable[[Sequence["SeedStream"], int], Tensor]:
    """Features of scenes that each have a budget and a number of masks of their own.

    The fewer masks share the light, the more each has. The gradient knows: a mask pays for the
    light that it takes from those after it.
    """
    job, how = jobs[0], jobs[0].training
    light, _ = job.optics
    x = _centred(scenes, job, masks)
    told = Conditioning(job.photons, how.span, job.masks)
    likely = chances(job.masks, how.nested).to(scenes.device)
    brightened = how.nested > 0 and isinstance(masks, Learned)  # at the end, see `brighten`

    def features(streams: Sequence[SeedStream], step: int) -> Tensor:
        difference, total = masks()
        rails = difference if difference is total else torch.stack([difference, total])
        used = constraints.used(constraints.separate(difference, total), light)
        whole = used[..., -1:]
        used = used if brightened else used / whole
        parts, ratios, counts = [], [], []
        for stream in streams:
            budget, shown = stream.expose(how.span, likely)
            ratio = budget / stream.part(used)[:, shown[:, 0, 0] - 1].T.unsqueeze(-1)
            parts.append(
                measure(
                    x.index_select(0, stream.with_mean[step]),
                    rails[..., stream.jobs, :, :] if len(difference) > 1 else rails,
                    stream.normal(job.masks) * stream.noise.unit / ratio.sqrt(),
                    False,
                )
            )
            ratios.append(ratio * stream.part(whole) if brightened else ratio)
            counts.append(shown.expand_as(ratio))
        seen, shown = side_by_side(parts), side_by_side(counts)
        scaled = _standardise(seen, how.scale, first(job.masks, shown))
        return told.inputs(scaled, side_by_side(ratios), shown)

    return features


def _centred(scenes: TrainingSet, job: Job, masks: Fixed | Learned) -> Tensor:
    """`TrainingSet.centred` with the pixels that masks may light; fixed ones see every pixel."""
    seen_by = job.optics[0] if isinstance(masks, Learned) else "two-arm"
    return scenes.centred(seen_by, products(job, scenes.device))


def _chosen(
    scenes: TrainingSet, jobs: Sequence[Job], masks: Fixed | Learned, choose: Replicas
) -> Callable[[Sequence["SeedStream"], int], Tensor]:
    """Features and dwells (K · B, R, 2 m) after each of K looks, with masks of equal dwells."""
    job = jobs[0]
    x = _centred(scenes, job, masks)
    gain = FeatureNoise(scenes, jobs).gain

    def features(streams: Sequence[SeedStream], step: int) -> Tensor:
        rails, _ = masks()
        parts = []
        for stream in streams:
            product = project(x.index_select(0, stream.with_mean[step]), stream.part(rails))
            parts.append(product.expand(-1, stream.jobs.stop - stream.jobs.start, -1))
        products_of_all = side_by_side(parts)
        centred, centre = products_of_all[:-1], products_of_all[-1]
        light = centred + centre
        power = centred.square().mean(dim=0) + centre / gain
        if job.training.scale == "common":
            power = power.mean(dim=-1, keepdim=True).expand_as(power)
        spread = torch.where(power > 0, power, 1.0).sqrt()

        def read(dwell: Tensor) -> tuple[Tensor, Tensor]:
            rates = job.masks * dwell * light
            drawn = []
            for stream in streams:
                own = rates[:, stream.jobs]
                if job.noise == "poisson":
                    drawn.append(stream.noise.counted(own, own))
                else:
                    deviation = stream.noise.deviation(own, own)
                    drawn.append(own + deviation * stream.normal(job.masks))
            return side_by_side(drawn), dwell

        every = expose(choose, read, job.training.looks, centre.expand_as(light), spread)
        return torch.cat([seen.inputs(centre, spread) for seen in every])

    return features


def _measured(
    scenes: TrainingSet, jobs: Sequence[Job], masks: Fixed
) -> Callable[[Sequence["SeedStream"], int], Tensor]:
    difference, total = masks()
    shown = lit(difference, total)
    photonic = jobs[0].noise in ("ml_gauss", "poisson")
    pairs = [project_pair(x, difference, total, photonic) for x in scenes.full.split(CHUNK)]
    means = torch.cat([mean for mean, _ in pairs])
    centre, spread, _ = statistics(scenes, jobs, masks, means)
    single = difference is total or not photonic
    lights = means if single else torch.cat([light for _, light in pairs])
    del pairs
    noise = FeatureNoise(scenes, jobs)
    if noise.kind == "poisson":

        def counted(streams: Sequence[SeedStream], step: int) -> Tensor:
            counts = [
                stream.noise.counted(stream.of(means, step), stream.of(lights, step))
                for stream in streams
            ]
            return (side_by_side(counts) - centre) / spread

        return counted
    if noise.kind == "ml_gauss":
        roots = root(lights)
        gain = noise.unit / spread
    else:
        roots = None
        gain = noise.variance(centre, shown).sqrt() / spread

    def measured(streams: Sequence[SeedStream], step: int) -> Tensor:
        parts = []
        for stream in streams:
            draws = stream.normal(means.shape[-1])
            if roots is not None:
                draws = draws * stream.of(roots, step)
            scaled = (stream.of(means, step) - stream.part(centre)) / stream.part(spread)
            parts.append(torch.addcmul(scaled, draws, stream.part(gain)))
        return side_by_side(parts)

    return measured


def _standardise(features: Tensor, scale: str, shown: Tensor | None = None) -> Tensor:
    """Scale centred features (B, R, m) with the spread of their batch, of those that are shown."""
    if shown is not None:
        over = (0,) if scale == "each" else (0, 2)
        power = (features.square() * shown).sum(dim=over, keepdim=True)
        return features / (power / shown.sum(dim=over, keepdim=True).clamp(min=1)).sqrt()
    if scale == "each":
        columns = functional.batch_norm(features.flatten(1), None, None, training=True, eps=1e-20)
        return columns.view_as(features)
    size = torch.linalg.vector_norm(features, dim=(0, 2)) / (features[:, 0].numel() ** 0.5)
    return features / size[:, None]
