"""The descent itself: steps that train R classifiers side by side, and masks where they learn.

One step, for B scenes and m masks: gather scenes, multiply them with all masks at once, draw noise,
standardise, classify, descend. The scenes stay on the device, nothing is read back within an epoch,
and the products of designs that do not learn are taken once before the first.

A seed fixes the order of scenes, the initial weights, the noise and the dropout. Replicas of one
seed take the same draws, so that a difference between two budgets is not blurred by chance, and up
to rounding a design does not depend on which others it was trained with.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from deepfsi import constraints
from deepfsi.classifiers import Mlp, Replicas
from deepfsi.constraints import Fixed, Learned
from deepfsi.jobs import Job, Training, products
from deepfsi.noise import follow, poisson, root, variance
from deepfsi.scanner import lit, measure, project, project_pair
from deepfsi.scenes import Scenes
from deepfsi.schedule import Schedule, expose
from deepfsi.told import Told, chances, first

Progress = Callable[[float], None]
"""Called with the share of the work that is done, 0 to 1."""

MASK_TENSORS = 16
"""Copies of the masks alive in a step: weights, gradients, moments, their stages and products."""

SHOWN_TENSORS = 10
"""Those besides of quantised masks: two rails, their steps, what is shown, and its two sums."""

STEP_TENSORS = 12
"""The same for the features."""

CHUNK = 4096
"""Scenes that are multiplied at once outside the steps."""

EARLY = 0.2
"""Weight of the loss of the answers before the last look, in their mean; the last has 1."""

CHOOSER = 0.2
"""Learning rate of the network that chooses dwells, over that of the classifier."""

GRAIN = 2**15
"""Elements below which torch itself does not share an operation among threads."""


def optimise(
    scenes: Scenes, jobs: Sequence[Job], masks: Fixed | Learned, report: Progress
) -> tuple[list[Mlp], list[Schedule]]:
    """Train the classifiers of jobs, and the masks where they learn; masks are changed in place.

    Parameters
    ----------
    scenes : Scenes
    jobs : sequence of Job
        R jobs that agree in `Job.companions`, those of one seed one after another.
    masks : Fixed or Learned
        Of R replicas, or of one for all.
    report : callable
        Told the share that is done after each epoch.

    Returns
    -------
    classifiers : list of Mlp
    schedules : list of Schedule
        Of jobs of several looks; else none.
    """
    job, how, device = jobs[0], jobs[0].training, scenes.device

    def networks(inputs: int, outputs: int, dropout: float) -> list[Mlp]:
        seeds = [torch.Generator(device).manual_seed(each.seed) for each in jobs]
        return [Mlp(inputs, outputs, how.hidden, dropout, seed) for seed in seeds]

    twice = how.looks > 1  # dwells besides features
    inputs = 2 * job.masks if twice else job.masks + (2 if how.told else 0)
    classifiers = networks(inputs, len(scenes.data.classes), how.dropout)
    choosers = networks(inputs + 1, job.masks, 0.0) if twice else []
    replicas = Replicas(classifiers, stacked=device.type == "cuda")
    choose = Replicas(choosers, stacked=device.type == "cuda")
    groups: list[dict[str, Any]] = [
        {"params": list(network.parameters()), "lr": rate * how.lr, "weight_decay": how.decay}
        for network, rate in ((replicas, 1.0), (choose, CHOOSER))
        if network.networks
    ]
    if isinstance(masks, Learned):
        groups.append({"params": list(masks.parameters()), "lr": how.mask_lr, "weight_decay": 0.0})
    batch = batch_of(how, len(scenes.labels))
    steps = len(scenes.labels) // batch
    streams = [
        _Stream(scenes, jobs, [r for r, _ in members], steps, batch)
        for _, members in groupby(enumerate(jobs), key=lambda place: place[1].seed)
    ]
    features = _features(scenes, jobs, masks, choose)
    optimiser = torch.optim.AdamW(groups, fused=True)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, [group["lr"] for group in groups], total_steps=how.epochs * steps
    )
    with _threads(batch * len(jobs) * max(job.masks, *how.hidden, 1)):
        report(0.0)
        for epoch in range(how.epochs):
            for stream in streams:
                stream.shuffle()
            for step in range(steps):
                logits = replicas(features(streams, step))
                labels = _beside([stream.labels(step) for stream in streams])
                (_loss(logits, labels) / batch).backward()
                optimiser.step()
                optimiser.zero_grad(set_to_none=True)
                schedule.step()
            report((epoch + 1) / how.epochs)
    for trained in (replicas, choose):
        trained.hand_back()
    for network in [*classifiers, *choosers]:
        network.generator = None
        network.eval()
    return classifiers, [Schedule(chooser, how.looks) for chooser in choosers]


def _loss(logits: Tensor, labels: Tensor) -> Tensor:
    """Sum over scenes and replicas (B, R) of the cross entropy of logits (K · B, R, C), K looks."""
    looks = len(logits) // len(labels)
    if looks == 1:
        return functional.cross_entropy(logits.flatten(0, 1), labels.flatten(), reduction="sum")
    truth = labels.repeat(looks, 1).flatten()
    each = functional.cross_entropy(logits.flatten(0, 1), truth, reduction="none")
    *early, last = each.view(looks, -1).sum(dim=1)
    return last + EARLY / len(early) * sum(early)


def batch_of(how: Training, count: int) -> int:
    """Scenes of one step, of `count` in all."""
    return min(how.batch or min(max(count // 100, 32), 500), count)


def statistics(
    scenes: Scenes, jobs: Sequence[Job], masks: Fixed | Learned, means: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Mean and spread of the features over the training set and its noise, and mean x S.

    Parameters
    ----------
    scenes : Scenes
    jobs : sequence of Job
    masks : Fixed or Learned
    means : tensor, shape (n, R or 1, m), optional
        x D of all training scenes, where it is known.

    Returns
    -------
    tuple of tensor
        Each (R, m), for scenes of unit reflectance: to be divided by `Scenes.light`.
    """
    difference, total = masks()
    centre, light = (project(scenes.full.mean(dim=0), rails) for rails in (difference, total))
    power = torch.zeros_like(centre)
    for place, x in enumerate(scenes.full.split(CHUNK)):
        rows = slice(place * CHUNK, place * CHUNK + len(x))
        mean = project(x, difference) if means is None else means[rows]
        power += (mean - centre).square().sum(dim=0)
    noise = _Noise(scenes, jobs).variance(light, lit(difference, total))
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


def footprint(scenes: Scenes, jobs: Sequence[Job]) -> float:
    """Bytes that training jobs together takes at most, the scenes included, by the tensors alive.

    Parameters
    ----------
    scenes : Scenes
    jobs : sequence of Job
        As for `optimise`.
    """
    job, scene = jobs[0], scenes.full[0].numel()
    count, replicas = len(scenes.labels), len(jobs)
    masks, batch = replicas * job.masks, batch_of(job.training, count)
    single = 4.0
    copies = MASK_TENSORS + (SHOWN_TENSORS if job.training.steps else 0)
    learned = copies * masks * scene if job.masks_from().code.learned else 0
    own = replicas if job.design in ("control", "random") else 1
    products_of_all = 0 if job.code.learned else 5 * own * count * job.masks
    step = STEP_TENSORS * batch * (masks + replicas * sum(job.training.hidden))
    step *= job.training.looks
    return single * (3 * scenes.full.numel() + learned + products_of_all + step)


def _features(
    scenes: Scenes, jobs: Sequence[Job], masks: Fixed | Learned, choose: Replicas
) -> Callable[[Sequence["_Stream"], int], Tensor]:
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

        def learned(streams: Sequence[_Stream], step: int) -> Tensor:
            rails = masks.rails_to_measure()
            return _standardise(
                _beside(
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

        def learned_from_counts(streams: Sequence[_Stream], step: int) -> Tensor:
            difference, total = masks()
            parts = []
            for stream in streams:
                seen = x.index_select(0, stream.with_mean[step])
                own = (difference[stream.jobs], total[stream.jobs])
                mean, light = project_pair(seen, *own, both=True)
                counts = stream.noise.counted(mean[:-1] + mean[-1], light[:-1] + light[-1])
                parts.append(counts - mean[-1])
            return _standardise(_beside(parts), scale)

        return learned_from_counts

    def learned_under_read_noise(streams: Sequence[_Stream], step: int) -> Tensor:
        difference, total = masks()
        shown = masks.lit(difference, total)
        parts = []
        for stream in streams:
            mean = project(x.index_select(0, stream.rows[step]), difference[stream.jobs])
            deviation = stream.noise.deviation(mean, shown[stream.jobs])
            parts.append(mean + deviation * stream.normal(job.masks))
        return _standardise(_beside(parts), scale)

    return learned_under_read_noise


def _told(
    scenes: Scenes, jobs: Sequence[Job], masks: Fixed | Learned
) -> Callable[[Sequence["_Stream"], int], Tensor]:
    """Features of scenes that each have a budget and a number of masks of their own.

    The fewer masks share the light, the more each has. The gradient knows: a mask pays for the
    light that it takes from those after it.
    """
    job, how = jobs[0], jobs[0].training
    light, _ = job.optics
    x = _centred(scenes, job, masks)
    told = Told(job.photons, how.span, job.masks)
    likely = chances(job.masks, how.nested).to(scenes.device)
    brightened = how.nested > 0 and isinstance(masks, Learned)  # at the end, see `brighten`

    def features(streams: Sequence[_Stream], step: int) -> Tensor:
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
        seen, shown = _beside(parts), _beside(counts)
        scaled = _standardise(seen, how.scale, first(job.masks, shown))
        return told.inputs(scaled, _beside(ratios), shown)

    return features


def _centred(scenes: Scenes, job: Job, masks: Fixed | Learned) -> Tensor:
    """`Scenes.centred` with the pixels that masks may light; fixed ones see every pixel."""
    seen_by = job.optics[0] if isinstance(masks, Learned) else "two-arm"
    return scenes.centred(seen_by, products(job, scenes.device))


def _chosen(
    scenes: Scenes, jobs: Sequence[Job], masks: Fixed | Learned, choose: Replicas
) -> Callable[[Sequence["_Stream"], int], Tensor]:
    """Features and dwells (K · B, R, 2 m) after each of K looks, with masks of equal dwells."""
    job = jobs[0]
    x = _centred(scenes, job, masks)
    gain = _Noise(scenes, jobs).gain

    def features(streams: Sequence[_Stream], step: int) -> Tensor:
        rails, _ = masks()
        parts = []
        for stream in streams:
            product = project(x.index_select(0, stream.with_mean[step]), stream.part(rails))
            parts.append(product.expand(-1, stream.jobs.stop - stream.jobs.start, -1))
        products_of_all = _beside(parts)
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
            return _beside(drawn), dwell

        every = expose(choose, read, job.training.looks, centre.expand_as(light), spread)
        return torch.cat([seen.inputs(centre, spread) for seen in every])

    return features


def _measured(
    scenes: Scenes, jobs: Sequence[Job], masks: Fixed
) -> Callable[[Sequence["_Stream"], int], Tensor]:
    difference, total = masks()
    shown = lit(difference, total)
    photonic = jobs[0].noise in ("ml_gauss", "poisson")
    pairs = [project_pair(x, difference, total, photonic) for x in scenes.full.split(CHUNK)]
    means = torch.cat([mean for mean, _ in pairs])
    centre, spread, _ = statistics(scenes, jobs, masks, means)
    single = difference is total or not photonic
    lights = means if single else torch.cat([light for _, light in pairs])
    del pairs
    noise = _Noise(scenes, jobs)
    if noise.kind == "poisson":

        def counted(streams: Sequence[_Stream], step: int) -> Tensor:
            counts = [
                stream.noise.counted(stream.of(means, step), stream.of(lights, step))
                for stream in streams
            ]
            return (_beside(counts) - centre) / spread

        return counted
    if noise.kind == "ml_gauss":
        roots = root(lights)
        gain = noise.unit / spread
    else:
        roots = None
        gain = noise.variance(centre, shown).sqrt() / spread

    def measured(streams: Sequence[_Stream], step: int) -> Tensor:
        parts = []
        for stream in streams:
            draws = stream.normal(means.shape[-1])
            if roots is not None:
                draws = draws * stream.of(roots, step)
            scaled = (stream.of(means, step) - stream.part(centre)) / stream.part(spread)
            parts.append(torch.addcmul(scaled, draws, stream.part(gain)))
        return _beside(parts)

    return measured


class _Stream:
    """What the jobs of one seed draw, the same for all of them."""

    rows: Tensor
    with_mean: Tensor

    def __init__(
        self, scenes: Scenes, jobs: Sequence[Job], places: list[int], steps: int, batch: int
    ) -> None:
        self.jobs = slice(places[0], places[-1] + 1)
        self.noise = _Noise(scenes, jobs[self.jobs])
        self.generator = torch.Generator(scenes.device).manual_seed(jobs[places[0]].seed)
        self.scenes, self.steps, self.batch = scenes, steps, batch

    def shuffle(self) -> None:
        """Draw the order of an epoch's scenes."""
        count = len(self.scenes.labels)
        order = torch.randperm(count, generator=self.generator, device=self.scenes.device)
        self.rows = order[: self.steps * self.batch].view(self.steps, self.batch)
        self.with_mean = functional.pad(self.rows, (0, 1), value=count)
        self._labels = self.scenes.labels[self.rows]

    def labels(self, step: int) -> Tensor:
        """Labels (B, R) of a step."""
        return self._labels[step].unsqueeze(1).expand(-1, self.jobs.stop - self.jobs.start)

    def normal(self, masks: int) -> Tensor:
        """Normal draws (B, 1, m)."""
        return torch.randn(
            self.batch, 1, masks, generator=self.generator, device=self.scenes.device
        )

    def expose(self, span: float, likely: Tensor) -> tuple[Tensor, Tensor]:
        """Draw budgets, over the lowest, and numbers of masks, each (B, 1, 1)."""
        how = {"generator": self.generator, "device": self.scenes.device}
        budget = span ** torch.rand(self.batch, 1, 1, **how)  # type: ignore[call-overload]
        shown = 1 + torch.multinomial(likely, self.batch, True, generator=self.generator)
        return budget, shown.view(-1, 1, 1)

    def part(self, every: Tensor) -> Tensor:
        """What of all jobs, (R or 1, m), is of these."""
        return every[self.jobs] if len(every) > 1 else every

    def of(self, every: Tensor, step: int) -> Tensor:
        """A step's part of what is known of all scenes and jobs, (n, R or 1, m)."""
        own = every[:, self.jobs] if every.shape[1] > 1 else every
        return own.index_select(0, self.rows[step])


class _Noise:
    """Noise of the features x D, whose unit is one fully reflecting pixel: Φ / s counts."""

    def __init__(self, scenes: Scenes, jobs: Sequence[Job]) -> None:
        self.kind = jobs[0].noise
        gain = [[job.photons / scenes.light] for job in jobs]
        self.gain = torch.tensor(gain, device=scenes.device)
        self.unit = self.gain.rsqrt()
        self.sigma = torch.tensor([[job.sigma] for job in jobs], device=scenes.device)
        # one for each replica, since what a Poisson draw takes from its generator depends on rates
        self.generators = [
            torch.Generator(scenes.device).manual_seed(job.seed ^ 2**31) for job in jobs
        ]

    def counted(self, mean: Tensor, light: Tensor) -> Tensor:
        """Features (B, R, m) from exact counts of two rails with `mean` = x D and `light` = x S."""
        with torch.no_grad():
            rates = torch.stack([light + mean, light - mean]).mul(self.gain / 2).clamp(min=0)
            drawn = zip(rates.unbind(dim=2), self.generators, strict=True)
            plus, minus = torch.stack([poisson(*each) for each in drawn], dim=2)
        return follow((plus - minus) / self.gain, mean, light)

    def deviation(self, light: Tensor, shown: Tensor) -> Tensor:
        """Standard deviation where the rails together see `light` = x S, (..., R, m)."""
        if self.kind == "ml_gauss":
            return root(light) * self.unit
        return root(self.variance(light, shown))

    def variance(self, light: Tensor, shown: Tensor) -> Tensor:
        """The same, squared; `shown` (R, m) says how many rails are read out."""
        if self.kind in ("ml_gauss", "poisson"):
            return light / self.gain
        return variance(light, shown, self.kind, self.sigma) / self.gain.square()


def _beside(parts: list[Tensor]) -> Tensor:
    """Replicas (B, R_i, …) of several seeds as one (B, R, …)."""
    return torch.cat(parts, dim=1) if len(parts) > 1 else parts[0]


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


@contextmanager
def _threads(units: int) -> Iterator[None]:
    """Use one thread where a step is too small for several: they would wait for one another."""
    threads = torch.get_num_threads()
    torch.set_num_threads(threads if units >= GRAIN else 1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
