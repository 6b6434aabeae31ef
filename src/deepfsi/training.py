"""Learn masks and classifier together, one design or several that share a shape.

One step, for B scenes, R replicas and m masks: gather scenes, multiply them with all masks at once,
draw noise, standardise, classify, descend. The scenes stay on the device, nothing is read back
within an epoch, and the products of designs that do not learn are taken once before the first.

Replicas that train together share their seed: the order of scenes, the initial weights, the noise
and the dropout are the same draws for all, so that a difference between two budgets is not blurred
by chance, and up to rounding a design does not depend on which others it was trained with.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from importlib.metadata import version
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from torch import Tensor
from torch.nn import functional

from deepfsi import coding, constraints
from deepfsi.artifact import Design
from deepfsi.classifiers import Mlp
from deepfsi.constraints import Light, Rails
from deepfsi.datasets import Dataset
from deepfsi.errors import InputError
from deepfsi.noise import follow, poisson, root, variance
from deepfsi.photons import BUDGETS, mean_light
from deepfsi.scanner import lit, measure, project, project_pair

Precision = Literal["auto", "float32", "bfloat16"]
Progress = Callable[[float], None]
"""Called with the share of the work that is done, 0 to 1."""

REVISION = 2
"""Raised whenever a change makes the same job end in another design: old records then expire."""

GRAIN = 2**15
"""Elements below which torch itself does not share an operation among threads."""

BFLOAT16_COUNTS = 2.0**14
"""Largest share of the budget a readout may have for bfloat16 products in training, Φ / readouts.

Rounding to 8 bits is wrong by at most 2⁻⁹ of the count, √2¹⁴ · 2⁻⁹ = 1/4 of its photon noise.
"""


Rate = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Training(BaseModel):
    """How a design is trained; all that do so together share one."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    epochs: int = Field(40, ge=1)
    batch: int | None = Field(None, ge=2, description="a hundredth of the scenes, 32 to 500")
    lr: Rate = Field(1e-2, description="peak of the one-cycle schedule")
    mask_lr: Rate = Field(1e-1, description="the same for masks, relative to their rms")
    hidden: tuple[Annotated[int, Field(ge=1)], ...] = (40, 128)
    dropout: float = Field(0.0, ge=0, lt=1)
    scale: Literal["each", "common"] = Field("common", description="spread of features")
    decay: float = Field(
        0.0, ge=0, allow_inf_nan=False, description="decoupled weight decay of the classifier"
    )
    start: str = Field("pca", description="design that learned masks start from")
    precision: Precision = "auto"


TUNED: dict[str, dict[str, Any]] = {
    "impulse": {"lr": 5e-3},
    "truncated-hadamard": {"lr": 5e-3},
    "raster": {"lr": 5e-3, "scale": "each"},
    "hadamard": {"lr": 5e-3, "scale": "each"},
}
"""Where a design does better with other settings than the defaults of `Training`.

Chosen on the last 10 000 training images of MNIST at 1e3, 1e4 and 1e5 photons, each design from
the same grid: lr 2e-3, 5e-3, 1e-2; scale each, common; dropout 0, 0.1 (for those of a thousand
readouts at one setting at most). Designs not named here, but for learned ones and PCA, are untuned.
"""


def training_for(design: str, **settings: Any) -> Training:
    """How a design is trained: the defaults, what suits the design, then `settings`."""
    return Training(**{**TUNED.get(design, {}), **settings})


class Job(BaseModel):
    """One design to be trained: what it is, and the light and noise it is trained under."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    design: str = "deepfsi"
    masks: int = Field(ge=1)
    photons: float = Field(ge=BUDGETS[0], le=BUDGETS[1])
    noise: Literal["ml_gauss", "poisson", "gaussian", "none"] = "ml_gauss"
    sigma: float = Field(1.0, gt=0, allow_inf_nan=False)
    light: Light = "column"
    rails: Rails = "dual"
    seed: int = Field(0, ge=0, lt=2**32)
    training: Training = Training()

    @property
    def code(self) -> coding.Code:
        """What is known of the named design."""
        return coding.DESIGNS[self.design]

    @property
    def optics(self) -> tuple[Light, Rails]:
        """Constraint and rails in force: designs with one rail by definition keep it.

        Impulse imaging has a detector for each pixel, which is `column` whatever else is compared.
        """
        light: Light = "column" if self.design == "impulse" else self.light
        return light, "single" if self.code.single_rail else self.rails

    def companions(self, device: torch.device) -> tuple[Any, ...]:
        """What jobs must have in common to be trained together: all but budget and sigma."""
        apart = {"photons", "sigma"}
        return (self.model_dump_json(exclude=apart), products(self.masks_from(), device))

    def masks_from(self) -> "Job":
        """The job that makes the masks: for the control group DeepFSI under gaussian noise."""
        if self.design != "control":
            return self
        return self.model_copy(update={"design": "deepfsi", "noise": "gaussian"})


class Scenes:
    """A data set on a device, with what several trainings on it share.

    Parameters
    ----------
    data : Dataset
    device : str
        "auto" (a GPU if there is one), "cpu" or "cuda".
    """

    def __init__(self, data: Dataset, device: str = "auto") -> None:
        self.data = data
        self.device = find_device(device)
        self.light = mean_light(data.x_train)
        self.labels = torch.from_numpy(data.y_train).to(self.device)
        self.full = torch.from_numpy(data.x_train).to(self.device)
        self._matrices: dict[tuple[str, int, int], np.ndarray] = {}
        self._centred: dict[tuple[torch.dtype, bool], Tensor] = {}

    @cached_property
    def varying(self) -> Tensor:
        """Which pixels (N,) differ anywhere in the training set; the first if none does."""
        varying = (self.full != self.full[0]).any(dim=0)
        varying[0] |= not varying.any()
        return varying

    def pixels(self, job: Job) -> Tensor:
        """Which pixels (N,) learned masks may light.

        The light of one that never varies is noise and no information, so it stays dark, except
        on two arms, where what one does not get the other does.
        """
        return torch.ones_like(self.varying) if job.light == "two-arm" else self.varying

    def centred(self, job: Job) -> Tensor:
        """Those pixels of the training scenes, less their mean, and the mean as the last row.

        The products of the last row with the masks, added to those of a scene, give the scene's
        own; centred, little is lost in bfloat16. Exactly 0 where a pixel never varies, so that it
        moves no mask through rounding.
        """
        kind, pixels = products(job, self.device), self.pixels(job)
        key = (kind, bool(pixels.all()))
        if key not in self._centred:
            mean = torch.where(self.varying, self.full.mean(dim=0), self.full[0])
            centred = torch.cat([self.full - mean, mean.unsqueeze(0)])
            self._centred[key] = centred[:, pixels].to(kind)
        return self._centred[key]

    def matrix(self, name: str, masks: int, seed: int) -> np.ndarray:
        """Sensing matrix of a fixed design; principal components are computed once for all m."""
        coding.check_count(name, masks, self.data)
        whole = self.data.pixels if name == "pca" else masks
        key = (name, whole, seed if name == "random" else 0)
        if key not in self._matrices:
            self._matrices[key] = coding.sensing_matrix(name, whole, self.data, seed)
        return self._matrices[key][:masks]


def find_device(name: str) -> torch.device:
    """Device of that name, or `InputError` if it is not one or is not here."""
    if name not in ("auto", "cpu", "cuda"):
        raise InputError(f"unknown device {name!r}: choose auto, cpu or cuda")
    if name == "cuda" and not torch.cuda.is_available():
        raise InputError("device cuda is not here: use --device cpu or auto")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


def products(job: Job, device: torch.device) -> torch.dtype:
    """Type of the products of learned masks: bfloat16 where that stays under the readout noise.

    See `BFLOAT16_COUNTS`. Read noise of σ counts stands in for √count under gaussian noise.
    """
    if job.training.precision != "auto":
        return getattr(torch, job.training.precision)
    fast = (
        torch.cuda.is_bf16_supported(including_emulation=False)
        if device.type == "cuda"
        else torch.cpu.get_capabilities().get("avx512_bf16", False)
    )
    readouts = job.masks * (2 if job.rails == "dual" else 1)
    counts = job.photons / readouts
    limit = {
        "ml_gauss": BFLOAT16_COUNTS,
        "poisson": BFLOAT16_COUNTS,
        "gaussian": job.sigma * BFLOAT16_COUNTS**0.5,
    }
    return torch.bfloat16 if fast and counts <= limit.get(job.noise, 0) else torch.float32


def learn(
    data: Dataset,
    *,
    photons: float,
    masks: int,
    matrix: np.ndarray | None = None,
    device: str = "auto",
    progress: Progress | None = None,
    **settings: Any,
) -> Design:
    """Train one design on all training scenes of a data set.

    Parameters
    ----------
    data : Dataset
    photons : float
        Budget Φ: expected photons on the coding device, in the mean over training scenes.
    masks : int
        m.
    matrix : array, shape (m, N), optional
        Your own sensing matrix, for ``design="custom"``.
    device : {"auto", "cpu", "cuda"}
    progress : callable, optional
        Called with the share of the work that is done.
    **settings
        Further fields of `Job` (`design`, `noise`, `sigma`, `light`, `rails`, `seed`) and of
        `Training` (`epochs`, `batch`, `lr`, `mask_lr`, `hidden`, `dropout`, `scale`, `decay`,
        `start`, `precision`).

    Returns
    -------
    Design

    Raises
    ------
    InputError
        For any setting that is not allowed.
    """
    inner = {key: settings.pop(key) for key in list(settings) if key in Training.model_fields}
    with reworded():
        how = training_for(settings.get("design", "deepfsi"), **inner)
        job = Job(photons=photons, masks=masks, training=how, **settings)
    return train(Scenes(data, device), [job], matrix=matrix, progress=progress)[0]


def train(
    scenes: Scenes,
    jobs: Sequence[Job],
    matrix: np.ndarray | None = None,
    progress: Progress | None = None,
) -> list[Design]:
    """Train designs side by side that differ in their budget (or sigma) only.

    Parameters
    ----------
    scenes : Scenes
    jobs : sequence of Job
        R jobs that agree in `Job.companions`.
    matrix : array, shape (m, N), optional
        Sensing matrix of "custom" designs.
    progress : callable, optional

    Returns
    -------
    list of Design
        In the order of `jobs`.
    """
    began = time.perf_counter()
    report = progress or (lambda share: None)
    for job in jobs:
        check_job(job, scenes.data, matrix)
    first = jobs[0]
    if any(job.companions(scenes.device) != first.companions(scenes.device) for job in jobs):
        raise ValueError("jobs that train together may differ in photons and sigma only")

    masks: constraints.Fixed | constraints.Learned
    if first.design == "control":
        optimised = train(
            scenes,
            [job.masks_from() for job in jobs],
            progress=lambda share: report(share / 2),
        )
        masks = constraints.Fixed(torch.stack([design.rails for design in optimised]))
        with _shared(scenes, jobs):
            classifiers = _optimise(scenes, jobs, masks, lambda share: report(0.5 + share / 2))
    else:
        masks = _masks(scenes, jobs, matrix).to(scenes.device)
        with _shared(scenes, jobs):
            classifiers = _optimise(scenes, jobs, masks, report)
        if isinstance(masks, constraints.Learned):
            masks = _whole(masks, scenes.pixels(first))

    with torch.no_grad():
        learned = [*masks(), *(part for net in classifiers for part in net.parameters())]
        if not all(bool(torch.isfinite(part).all()) for part in learned):
            raise InputError(f"training of {first.design} diverged: lower lr and mask_lr")
        difference, total = masks()
        means, lights = _measure(scenes, masks)
        centre, spread, light = _statistics(scenes, jobs, (difference, total), means, lights)
    constraint, _ = first.optics
    every = constraints.separate(difference, total)
    seconds = time.perf_counter() - began
    return [
        Design(
            name=job.design,
            rails=constraints.check(every[r % len(every)].clone(), constraint),
            classifier=classifiers[r],
            centre=centre[r] / scenes.light,
            spread=spread[r] / scenes.light,
            shares=light[r] / scenes.light,
            mean_light=scenes.light,
            light=constraint,
            image_shape=scenes.data.image_shape,
            classes=scenes.data.classes,
            info={
                "job": job.model_dump(mode="json"),
                "data": {"name": scenes.data.name, "hash": scenes.data.hash},
                "preprocessing": scenes.data.preprocessing,
                "deepfsi": version("deepfsi"),
                "torch": torch.__version__,
                "device": scenes.device.type,
                "seconds": seconds / len(jobs),
            },
        )
        for r, job in enumerate(jobs)
    ]


def check_job(job: Job, data: Dataset, matrix: np.ndarray | None = None) -> None:
    """Raise `InputError` for whatever a job asks that cannot be had on this data."""
    coding.check_design(job.design)
    constraints.check_light(*job.optics)
    start = coding.DESIGNS[coding.check_design(job.training.start)]
    if start.learned or job.training.start in ("control", "custom"):
        raise InputError(f"masks cannot start from {job.training.start}: name a fixed design")
    if job.design == "hadamard" and job.rails == "single":
        raise InputError("hadamard is signed: use dual rails, or the s-matrix")
    if (matrix is not None) != (job.design == "custom"):
        raise InputError("a matrix goes with the design `custom`, and only with it")
    if matrix is None:
        coding.check_count(job.design, job.masks, data)
        return
    matrix = np.asarray(matrix)
    if matrix.shape != (job.masks, data.pixels):
        raise InputError(
            f"a matrix of shape {matrix.shape} does not fit: give ({job.masks}, {data.pixels})"
        )
    if matrix.dtype.kind not in "biuf" or not np.abs(matrix, dtype=float).max() < 1e30:
        raise InputError("the matrix holds something else than finite real numbers")
    if not matrix.any():
        raise InputError("the matrix is zero everywhere: give at least one lit entry")


def _masks(
    scenes: Scenes, jobs: Sequence[Job], matrix: np.ndarray | None
) -> constraints.Fixed | constraints.Learned:
    job = jobs[0]
    light, rails = job.optics
    name = job.training.start if job.code.learned else job.design
    if matrix is not None:
        own = torch.from_numpy(np.asarray(matrix, dtype=np.float32))
        if rails == "single":
            own_rails = own.unsqueeze(0)
        else:
            own_rails = constraints.arms(own) if light == "two-arm" else constraints.split(own)
        return constraints.Fixed(constraints.check(own_rails, light).unsqueeze(0))
    if rails == "dual" or job.code.single_rail:
        signed = torch.from_numpy(scenes.matrix(name, job.masks, job.seed)).float()
    else:
        signed = _frames(scenes, name, job.masks, job.seed)
    if job.code.learned:
        start = signed[:, scenes.pixels(job).cpu()]
        return constraints.Learned(start.repeat(len(jobs), 1, 1), light, rails)
    if job.design == "raster":
        return constraints.Fixed(signed[None, None])
    return constraints.Fixed(constraints.fit(signed, light, rails).unsqueeze(0))


def _whole(masks: constraints.Learned, pixels: Tensor) -> constraints.Fixed:
    """What was learned on some pixels, as masks of all: dark elsewhere."""
    with torch.no_grad():
        rails = constraints.separate(*masks())
    whole = rails.new_zeros(*rails.shape[:-1], len(pixels))
    whole[..., pixels] = rails
    return constraints.Fixed(whole)


def _frames(scenes: Scenes, name: str, count: int, seed: int) -> Tensor:
    """The first `count` lit rails of a design, mask by mask; the masks are as many as needed."""
    least, most = coding.count_allowed(name, scenes.data)
    for masks in range(min(max(-(-count // 2), least), most), most + 1):
        signed = torch.from_numpy(scenes.matrix(name, masks, seed)).float()
        lit_frames = constraints.frames(constraints.split(signed))
        if len(lit_frames) >= count:
            return lit_frames[:count]
    raise InputError(f"{count} frames are not allowed for {name}: give at most {len(lit_frames)}")


def _optimise(
    scenes: Scenes,
    jobs: Sequence[Job],
    masks: constraints.Fixed | constraints.Learned,
    report: Progress,
) -> list[Mlp]:
    """Train the classifiers, and the masks where they learn; masks are changed in place."""
    job, how, device = jobs[0], jobs[0].training, scenes.device
    generator = torch.Generator(device).manual_seed(job.seed)
    classifiers = [
        Mlp(
            job.masks,
            len(scenes.data.classes),
            how.hidden,
            how.dropout,
            torch.Generator(device).manual_seed(job.seed),
        )
        for _ in jobs
    ]
    weights = [parameter for classifier in classifiers for parameter in classifier.parameters()]
    learns = isinstance(masks, constraints.Learned)
    groups: list[dict[str, Any]] = [{"params": weights, "lr": how.lr, "weight_decay": how.decay}]
    if learns:
        groups.append({"params": list(masks.parameters()), "lr": how.mask_lr, "weight_decay": 0.0})
        x = scenes.centred(job)
    else:
        shown = masks()
        means, lights = _measure(scenes, masks)
        centre, spread = _statistics(scenes, jobs, shown, means, lights)[:2]

    noise = _Noise(scenes, jobs)
    count = len(scenes.labels)
    batch = _batch(scenes, how)
    steps = count // batch
    optimiser = torch.optim.AdamW(groups, fused=True)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, [group["lr"] for group in groups], total_steps=how.epochs * steps
    )
    report(0.0)
    for epoch in range(how.epochs):
        order = torch.randperm(count, generator=generator, device=device)
        order = order[: steps * batch].view(steps, batch)
        labels_of = scenes.labels[order]
        with_mean = functional.pad(order, (0, 1), value=count)
        for step, rows in enumerate(order):
            epsilon = torch.randn(batch, 1, job.masks, generator=generator, device=device)
            if isinstance(masks, constraints.Learned) and job.noise == "ml_gauss":
                features = measure(x.index_select(0, with_mean[step]), masks, epsilon * noise.unit)
            elif learns and job.noise == "poisson":
                difference, total = masks()
                chosen = x.index_select(0, with_mean[step])
                pair = project_pair(chosen, difference, total, both=True)
                mean, light = (part[:-1] + part[-1] for part in pair)
                features = noise.counted(mean, light) - pair[0][-1]
            elif learns:
                shown = masks()
                mean = project(x.index_select(0, rows), shown[0])
                features = mean + noise.scaled(epsilon, mean, shown)
            else:
                mean, light = means.index_select(0, rows), lights.index_select(0, rows)
                if job.noise == "poisson":
                    features = noise.counted(mean, light)
                else:
                    features = mean + noise.scaled(epsilon, light, shown)
            scaled = _standardise(features, how.scale) if learns else (features - centre) / spread
            losses = [
                functional.cross_entropy(classifier(features), labels_of[step])
                for classifier, features in zip(classifiers, scaled.unbind(1), strict=True)
            ]
            torch.autograd.backward(losses)
            optimiser.step()
            optimiser.zero_grad(set_to_none=True)
            schedule.step()
        report((epoch + 1) / how.epochs)
    for classifier in classifiers:
        classifier.generator = None
        classifier.eval()
    return classifiers


def _batch(scenes: Scenes, how: Training) -> int:
    count = len(scenes.labels)
    return min(how.batch or min(max(count // 100, 32), 500), count)


@contextmanager
def _shared(scenes: Scenes, jobs: Sequence[Job]) -> Iterator[None]:
    """Use one thread where a step is too small for several: they would wait for one another."""
    how, threads = jobs[0].training, torch.get_num_threads()
    units = _batch(scenes, how) * len(jobs) * max(jobs[0].masks, *how.hidden, 1)
    torch.set_num_threads(threads if units >= GRAIN else 1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


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

    def scaled(self, epsilon: Tensor, light: Tensor, masks: tuple[Tensor, Tensor]) -> Tensor:
        """Normal draws (B, 1, m) brought to the noise of features that see `light` = x S."""
        if self.kind == "ml_gauss":
            return root(light) * epsilon * self.unit
        return root(self.variance(light, masks)) * epsilon

    def variance(self, light: Tensor, masks: tuple[Tensor, Tensor]) -> Tensor:
        """Variance (..., R, m) where the rails together see `light` = x S, (..., R, m)."""
        if self.kind in ("ml_gauss", "poisson"):
            return light / self.gain
        counts = variance(light, lit(*masks), self.kind, self.sigma)
        return counts / self.gain.square()


def _standardise(features: Tensor, scale: str) -> Tensor:
    """Scale centred features (B, R, m) with the spread of their batch."""
    if scale == "each":
        columns = functional.batch_norm(features.flatten(1), None, None, training=True, eps=1e-20)
        return columns.view_as(features)
    size = torch.linalg.vector_norm(features, dim=(0, 2)) / (features[:, 0].numel() ** 0.5)
    return features / size[:, None]


def _measure(scenes: Scenes, masks: constraints.Fixed | constraints.Learned) -> tuple[Tensor, ...]:
    """Noiseless x D and x S of all training scenes, each (n, R, m)."""
    difference, total = masks()
    chunks = [project_pair(x, difference, total, both=True) for x in scenes.full.split(4096)]
    means = torch.cat([mean for mean, _ in chunks])
    if difference is total:
        return means, means
    return means, torch.cat([light for _, light in chunks])


def _statistics(
    scenes: Scenes,
    jobs: Sequence[Job],
    masks: tuple[Tensor, Tensor],
    means: Tensor,
    lights: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Mean and spread of the features over the training set and its noise, and mean x S: (R, m)."""
    light = lights.mean(dim=0)
    power = means.var(dim=0, correction=0) + _Noise(scenes, jobs).variance(light, masks)
    if jobs[0].training.scale == "common":
        power = power.mean(dim=-1, keepdim=True).expand_as(power)
    spread = torch.where(power > 0, power, 1.0).sqrt()
    return means.mean(dim=0).expand_as(spread), spread, light.expand_as(spread)


@contextmanager
def reworded() -> Iterator[None]:
    """Turn pydantic's errors into one `InputError` that names every bad field."""
    try:
        yield
    except ValidationError as error:
        faults = [
            (f"{'.'.join(map(str, fault['loc']))} = {fault['input']!r}: " if fault["loc"] else "")
            + f"{fault['msg'][0].lower()}{fault['msg'][1:]}".removeprefix("value error, ")
            for fault in error.errors()
        ]
        raise InputError("; ".join(faults)) from None
