"""Exposures with adaptive masks: their looks, their misfit, and their training, which has no steps.

Exposures may share light: each ends when the probability of a class exceeds a threshold. The budget
is then the mean of all, and the largest exposure takes `cap` budgets.

Thresholds and misfits are measured with training scenes. Each is left out of the prior, which would
recognise it sooner and better than a new scene; centres of clusters stay, as each stands for many.
"""

from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pkgutil import resolve_name
from typing import ClassVar, NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor

from deepfsi.adaptive.dictionary import DictionaryPosterior, MaskDictionary
from deepfsi.adaptive.posterior import (
    LEAST_WEIGHT,
    LIKELIHOODS_AT_ONCE,
    MOST_EXPOSURES,
    AdaptivePosterior,
    Look,
    LookOptics,
    ScenePrior,
    confidence_of,
)
from deepfsi.base.arrays import check_memory
from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.registry import installed
from deepfsi.camera.camera import Camera
from deepfsi.datasets.dataset import Dataset
from deepfsi.designfile.design_file import MASKS_ARE_MADE, AdaptiveHeader
from deepfsi.designfile.misfit import FEWEST_LEFT_OUT, MISFIT_BUDGETS, UsualMisfit
from deepfsi.designfile.view_test import SceneReadouts
from deepfsi.exposure.kind import Answer, CountedLight, ExposureKind, Exposures, Network, Use
from deepfsi.jobs.exposures import AdaptiveMasks
from deepfsi.jobs.job import Job
from deepfsi.physics.detection import Detection

State = TypeVar("State", bound=AdaptivePosterior)


def prior_of(data: Dataset, settings: AdaptiveMasks) -> ScenePrior:
    """Prior of the training scenes of a data set, or `InputError` if it does not fit the memory."""
    scenes = len(data.x_train)
    needed = 4 * (scenes * (3 * data.pixels + settings.components) + 6 * LIKELIHOODS_AT_ONCE)
    needed += 16 * data.pixels**2  # covariance and its eigenvectors, float64
    check_memory(needed, "the prior of these scenes", "give fewer scenes")
    return ScenePrior(
        np.asarray(data.x_train),
        data.y_train,
        len(data.classes),
        components=settings.components,
        spread=settings.spread,
        clusters=settings.clusters,
    )


SHARING_SCENES = 1024
"""Training scenes by which the threshold of a mean light is found, at most.

The light of an exposure varies by some 0.6 of its mean, so that the mean is known to 4 % (95 %).
"""


@torch.no_grad()
def measure(
    exposure: "AdaptiveExposure",
    optics: Sequence[LookOptics],
    left_out: "LeftOutScenes",
    generator: torch.Generator,
    report: Progress = SILENT,
    misfit: bool = True,
) -> tuple[Tensor, Tensor, Tensor]:
    """Expose S scenes that the prior lacks, to their last look, at B budgets.

    Returns log odds (B, K, S, C) of the classes after each look, counts (B, K, S) of the look
    without dark counts, and its misfit (B, K, S), 0 without `misfit`.
    """
    settings = exposure.settings
    shape = len(optics), settings.looks, len(left_out.scenes)
    odds = torch.zeros(*shape, exposure.prior.classes)
    counted, misfits = torch.zeros(2, *shape, dtype=torch.double)
    for row, at_budget in enumerate(optics):
        posterior = partial(exposure.posterior, optics=at_budget)
        size = exposure.prior.exposed_at_once
        for rows, scenes, state in left_out.states(posterior, size, report):
            for look, share in enumerate(settings.shares):
                masks, counts, light = state.look_at(scenes, share, generator)
                if misfit:
                    misfits[row, look, rows] = state.misfit(masks, counts, share).double()
                state.update(masks, counts, share)
                counted[row, look, rows] = light.double().sum(dim=1)
                odds[row, look, rows] = state.odds
    return odds, counted, misfits


def _looks(
    state: AdaptivePosterior, x: Tensor, shares: Sequence[float], generator: torch.Generator
) -> Iterator[Look]:
    """Looks at scenes (b, N) one after another; the state takes in each before it is yielded."""
    for share in shares:
        look = state.look_at(x, share, generator)
        state.update(look.masks, look.counts, share)
        yield look


def sharing_threshold(used: np.ndarray, confidence: np.ndarray, light: float) -> float:
    """Highest probability at which exposures may end, so that their mean light fits a share.

    Shapes: share `used` (K,) of the budget after each look; `confidence` (E, K), the probability of
    the likeliest class then.
    """

    def mean_light(threshold: float) -> float:
        return float(used[_last_looks(confidence, threshold)].mean())

    # the light rises with the threshold; no job has so few looks that the first alone takes more
    tried: list[float] = np.unique(np.append(confidence[:, :-1], [0.0, 1.0])).tolist()
    first = bisect_right(range(len(tried)), light, key=lambda index: mean_light(tried[index]))
    return tried[first - 1]


def _last_looks(confidence: np.ndarray, threshold: float) -> np.ndarray:
    """Look (E,), from 0, at which exposures of confidence (E, K) end: once sure, or the last."""
    enough = confidence > threshold
    enough[:, -1] = True
    return enough.argmax(axis=1)


@dataclass(frozen=True, eq=False)
class AdaptiveExposure(ExposureKind):
    """Exposure that makes each mask from the counts so far."""

    prior: ScenePrior  # the training scenes, in components
    settings: AdaptiveMasks  # looks, and the share of the exposure that each takes
    image_shape: tuple[int, ...]
    shares: Tensor  # (K,), share of the budget that each look counts
    camera: Camera  # camera of the training
    usual_misfit: UsualMisfit | None = None
    dictionary: MaskDictionary | None = None  # each look shows one of its masks

    makes_masks: ClassVar[bool] = True
    comparable: ClassVar[bool] = False
    refusals: ClassVar[dict[Use, str]] = {
        use: f"this design {MASKS_ARE_MADE}" for use in ("masks", "frames", "graph", "comparison")
    } | {
        "ideal observer": "adaptive masks are answered by the posterior of the ideal observer, "
        "after all looks: leave `ideal` out"
    }

    @classmethod
    def restored(
        cls, header: AdaptiveHeader, arrays: Mapping[str, np.ndarray]
    ) -> "AdaptiveExposure":
        """The kind of a design file, or an error where its arrays do not fit the header."""
        with as_input_error("the design's camera", "train it again"):
            camera = Camera.restored(dict(header.info["job"]["camera"]))
        misfit = {
            name.removeprefix("misfit_"): array
            for name, array in arrays.items()
            if name.startswith("misfit_")
        }
        return cls(
            prior=ScenePrior.restored(arrays),
            settings=header.settings,
            image_shape=header.image_shape,
            shares=torch.from_numpy(arrays["shares"]),
            camera=camera,
            usual_misfit=UsualMisfit.restored(misfit, header.settings.looks) if misfit else None,
            dictionary=MaskDictionary.restored(arrays),
        )

    def check(self, use: Use) -> None:
        """Raise `InputError` for a use that the kind refuses."""
        super().check(use)
        if use == "page" and self.dictionary is not None:
            raise InputError(
                "a page makes its masks, and this design chooses among those of a dictionary: give "
                "a design without `dictionary`"
            )

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays of a design file: prior, shares and misfit."""
        arrays = self.prior.arrays | {"shares": self.shares.numpy()}
        if self.dictionary is not None:
            arrays |= self.dictionary.arrays
        if self.usual_misfit is not None:
            arrays |= {f"misfit_{name}": array for name, array in vars(self.usual_misfit).items()}
        return arrays

    @property
    def count(self) -> int:
        """K, number of looks: each shows a mask of its own."""
        return self.settings.looks

    @property
    def summed_reflectance(self) -> float:  # type: ignore[override]
        """That of the scenes of the prior."""
        return self.prior.summed_reflectance

    @property
    def detection(self) -> Detection:  # type: ignore[override]
        """Detectors on parts of the device."""
        return Detection.by(self.camera.detector_map(self.image_shape), self.camera.readout)

    @property
    def title(self) -> str:
        """Number of looks, the most light, and the number of scenes that are known."""
        most = f" of at most {self.settings.cap:g} budgets" if self.settings.cap > 1 else ""
        choice = "" if self.dictionary is None else f" of {len(self.dictionary)} masks"
        return f"{self.count} looks{most}{choice}, {len(self.prior)} scenes known"

    def optics_at(self, photons: float, camera: Camera | None = None) -> LookOptics:
        """Optics of a look at a budget of a whole exposure, of another camera if one is given."""
        return LookOptics.of(camera or self.camera, self.image_shape, photons)

    def posterior(self, exposures: int, optics: LookOptics) -> AdaptivePosterior:
        """Posterior of b exposures before the first look, which also chooses their masks."""
        if self.dictionary is None:
            return AdaptivePosterior(self.prior, exposures, optics)
        share = self.settings.shares[0]
        return DictionaryPosterior(self.dictionary, self.prior, exposures, optics, share=share)

    def exposures(self, scenes: Tensor, camera: Camera, network: Network) -> Exposures:
        """Exposures of scenes (n, N); each stops when one class is certain enough."""

        def expose(photons: float, generator: torch.Generator) -> tuple[Answer, CountedLight]:
            optics = self.optics_at(photons, camera)
            probabilities = []
            counted = 0.0
            used = 0.0
            for x in scenes.split(self.prior.exposed_at_once):
                run = self._run(self.posterior(len(x), optics), x, generator)
                probabilities.append(run.probabilities)
                counted += float(run.counts.sum())
                used += sum(
                    share * int((run.looks > look).sum())
                    for look, share in enumerate(self.settings.shares)
                )
            light = used * photons if self.settings.until < 1 else None
            return answer_of(torch.cat(probabilities)), CountedLight(counted, counted, light)

        return expose

    def tested(
        self, scenes: Tensor, photons: float, camera: Camera, seed: int, all_on: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Probabilities (n, C) of exposures of scenes (n, N), and p-values (n,) of their counts.

        `all_on` (n,) are the counts of all-ON frames.
        """
        model = self.prior.model
        assert self.usual_misfit is not None
        assert model is not None
        generator = torch.Generator().manual_seed(seed)
        optics = self.optics_at(photons, camera)
        runs = [
            self._run(self.posterior(len(x), optics), x, generator, misfit=True)
            for x in scenes.split(self.prior.exposed_at_once)
        ]
        probabilities = torch.cat([run.probabilities for run in runs]).numpy()
        gain = photons / self.summed_reflectance
        rows = SceneReadouts.all_on(all_on, gain, 0.0, scenes.shape[1])
        light = model.light(rows, self.usual_misfit.light[0])
        misfits = torch.cat([run.misfits for run in runs]).numpy()
        looks = torch.cat([run.looks for run in runs]).numpy()
        return probabilities, self.usual_misfit.p_values(misfits, looks, photons, light)

    def _run(
        self, state: AdaptivePosterior, x: Tensor, generator: torch.Generator, misfit: bool = False
    ) -> "_Run":
        """Expose scenes (b, N); misfits stay 0 unless they are asked for."""
        settings = self.settings
        run = _Run(
            probabilities=torch.empty(len(x), state.prior.classes),
            counts=torch.zeros(settings.looks, dtype=torch.double),
            looks=torch.zeros(len(x), dtype=torch.long),
            misfits=torch.zeros(len(x), dtype=torch.double),
        )
        running = torch.arange(len(x))
        for index, share in enumerate(settings.shares):
            look = state.look_at(x[running], share, generator)
            if misfit:
                run.misfits[running] += state.misfit(look.masks, look.counts, share).double()
            state.update(look.masks, look.counts, share)
            run.counts[index] = look.light.double().sum()
            run.looks[running] += 1
            last = index == settings.looks - 1
            # with `until` = 1 none ends early: probabilities are needed once, at the end
            if settings.until < 1 or last:
                run.probabilities[running] = state.probabilities
                going = confidence_of(state.probabilities) <= settings.until
                if not last and not bool(going.all()):
                    state = state.rows_of(going)
                    running = running[going]
            if not len(running):
                break
        return run

    def look_by_look(
        self, scene: Tensor, photons: float, generator: torch.Generator
    ) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """Mask and mean scene (1, N), and probabilities (1, C), after each look at a scene (N,)."""
        state = self.posterior(1, self.optics_at(photons))
        for look in _looks(state, scene[None], self.settings.shares, generator):
            yield look.masks, state.scene, state.probabilities


class _Run(NamedTuple):
    """Exposures of b scenes."""

    probabilities: Tensor  # (b, C)
    counts: Tensor  # (K,), of all scenes at each look
    looks: Tensor  # (b,), until the answer
    misfits: Tensor  # (b,)


def answer_of(probabilities: Tensor) -> Answer:
    """Answer of class probabilities (b, C) of a posterior."""
    # no network gives logits here; these have the same softmax
    return Answer(
        probabilities.clamp(min=LEAST_WEIGHT).log(), probabilities, probabilities.argmax(dim=-1)
    )


class LeftOutScenes(NamedTuple):
    """Training scenes; each is left out of a prior of scenes while it is exposed.

    A prior of clusters keeps its centres.
    """

    scenes: Tensor  # (S, N)
    labels: Tensor  # (S,)
    indices: Tensor | None  # (S,), in the prior; None where it lacks them
    groups: Tensor = torch.zeros(0)  # (n,), group of alike scenes of each scene of the prior

    def states(
        self, make: Callable[[int], State], size: int, report: Progress = SILENT
    ) -> Iterator[tuple[Tensor, Tensor, State]]:
        """Rows, scenes and their posterior, at most `size` at a time; `make` makes it of a size."""
        batches = torch.arange(len(self.scenes)).split(size)
        for done, rows in enumerate(batches, start=1):
            state = make(len(rows))
            if self.indices is not None:  # a scene and all alike are impossible in its exposure
                own = self.groups[self.indices[rows]]
                state.log_weights[own[:, None] == self.groups] = -torch.inf
            yield rows, self.scenes[rows], state
            report(done / len(batches))


class LeftOutAnswers(NamedTuple):
    """Answers to S training scenes, each left out of the prior."""

    budgets: np.ndarray  # (B,)
    odds: Tensor  # (B, K, S, C), log odds of the classes after each look, or at the end (K = 1)
    labels: Tensor  # (S,)
    counted: Tensor | None = None  # (B, K, S), counts of each look without dark ones

    def confidence(self, prior: ScenePrior) -> np.ndarray:
        """Calibrated confidence (S, K) after each look, at the first budget."""
        photons = float(self.budgets[0])
        looks = enumerate(self.odds[0], start=1)
        probabilities = [prior.calibrated(odds, count, photons) for count, odds in looks]
        return confidence_of(torch.stack(probabilities, dim=1)).numpy()

    def ended(self, kind: AdaptiveExposure) -> "LeftOutAnswers":
        """Answers at the end of each exposure of a kind that ends early."""
        sure = self.confidence(kind.prior)
        ends = torch.from_numpy(_last_looks(sure, kind.settings.until))
        odds = self.odds[0, ends, torch.arange(len(ends))]
        return LeftOutAnswers(self.budgets, odds[None, None], self.labels)

    def shared(self, kind: AdaptiveExposure) -> AdaptiveExposure:
        """The kind whose exposures end so that these scenes take one budget in the mean."""
        assert self.counted is not None
        sure = self.confidence(kind.prior)
        threshold = sharing_threshold(np.cumsum(kind.settings.shares), sure, 1.0)
        going = torch.arange(kind.count) <= torch.from_numpy(_last_looks(sure, threshold))[:, None]
        counted = (self.counted[0].T.float().contiguous() * going).mean(dim=0)
        settings = kind.settings.model_copy(update={"until": threshold})
        return replace(kind, settings=settings, shares=counted / float(self.budgets[0]))


class AdaptiveTraining:
    """Adaptive masks of jobs that differ in budget and seed: one prior of scenes, and no steps."""

    kind: ClassVar[type[AdaptiveExposure]] = AdaptiveExposure

    def __init__(self, data: Dataset, settings: AdaptiveMasks) -> None:
        self.data = data
        self.settings = settings
        self.prior = prior_of(data, settings)

    def left_out(self, count: int, generator: torch.Generator) -> LeftOutScenes:
        """Training scenes, drawn at random."""
        order = self.prior.order
        indices = torch.randperm(len(order), generator=generator)[:count]
        rows = order[indices.numpy()]
        return LeftOutScenes(
            torch.from_numpy(self.data.x_train[rows]),
            torch.from_numpy(self.data.y_train[rows]),
            # a centre stands for many scenes, and stays when one of them is exposed
            indices if self.settings.clusters is None else None,
            torch.from_numpy(self.data.alike[order]),
        )

    def longest(self, kind: AdaptiveExposure, job: Job, report: Progress) -> LeftOutAnswers:
        """Answers in exposures of all looks, from which `LeftOutAnswers.shared` sets the light."""
        # another draw than that of `measured`, whose seed is the job's own
        generator = torch.Generator().manual_seed(job.seed ^ 2**31)
        left_out = self.left_out(SHARING_SCENES, generator)
        optics = [kind.optics_at(job.photons, job.optics)]
        odds, counted, _ = measure(kind, optics, left_out, generator, report, misfit=False)
        return LeftOutAnswers(np.array([job.photons]), odds, left_out.labels, counted)

    @torch.no_grad()
    def dictionary(self, job: Job) -> MaskDictionary | None:
        """Masks made for training scenes, each left out of the prior; None if not asked for."""
        count = self.settings.dictionary
        if count is None:
            return None
        # a third draw, apart from those of `measured` and `longest`
        generator = torch.Generator().manual_seed(job.seed ^ 2**30)
        left_out = self.left_out(512, generator)  # training scenes for which masks are made
        optics = LookOptics.of(job.optics, self.data.image_shape, job.photons)
        settings = AdaptiveMasks(looks=min(self.settings.looks, 32))
        masks: list[Tensor] = []
        posterior = partial(AdaptivePosterior, self.prior, optics=optics)
        for _, scenes, state in left_out.states(posterior, MOST_EXPOSURES):
            looks = _looks(state, scenes, settings.shares, generator)
            masks += [look.masks.bool() for look in looks]
        return MaskDictionary.drawn(torch.cat(masks), count, generator)

    def make(self, job: Job, report: Progress) -> tuple[AdaptiveExposure, LeftOutAnswers]:
        """The exposure of a job, not calibrated, and answers to left-out scenes."""
        measured = self.measured(job, self.dictionary(job))
        report(0.5)
        return measured

    def measured(
        self,
        job: Job,
        dictionary: MaskDictionary | None = None,
        left_out: LeftOutScenes | None = None,
    ) -> tuple[AdaptiveExposure, LeftOutAnswers]:
        """The exposure with light and misfit of left-out scenes, and answers to these.

        Default: scenes drawn from the training scenes.
        """
        shape = self.data.image_shape
        unmeasured = torch.zeros(self.settings.looks)
        exposure = AdaptiveExposure(
            self.prior, self.settings, shape, unmeasured, job.camera, dictionary=dictionary
        )
        generator = torch.Generator().manual_seed(job.seed)
        if left_out is None:
            left_out = self.left_out(256, generator)  # they tell misfit and temperatures
        budgets = np.array(MISFIT_BUDGETS) * job.photons
        optics = [LookOptics.of(job.optics, shape, photons) for photons in budgets.tolist()]
        odds, counted, misfits = measure(exposure, optics, left_out, generator)
        at_budget = counted[MISFIT_BUDGETS.index(1.0)].mean(dim=1)
        shares = (at_budget / job.photons).float()
        misfit = None
        if len(left_out.scenes) >= FEWEST_LEFT_OUT:
            light = self.data.x_train.sum(axis=1, dtype=float)
            misfit = UsualMisfit.of(budgets, misfits.cumsum(dim=1).numpy(), light)
        answers = LeftOutAnswers(budgets, odds, left_out.labels)
        return replace(exposure, shares=shares, usual_misfit=misfit), answers


def training_of(clicks: bool) -> type[AdaptiveTraining]:
    """Training of masks before a detector that counts, or that clicks, of a package beside."""
    if not clicks:
        return AdaptiveTraining
    if "click" not in installed().parts["adaptive"]:
        raise InputError(
            "adaptive masks for clicks are in deepfsi_clicks, which is not installed: install "
            "deepfsi again"
        )
    return resolve_name(installed().parts["adaptive"]["click"])
