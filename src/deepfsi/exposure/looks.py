"""Exposures of several looks: the counts so far choose how long each mask is shown next.

One device shows the same masks in every look, each for its own share of the time (`free-dwell`).
In the first look these *dwells* are the same for all scenes; a small network then chooses those of
each further look from the counts so far. Masks whose result is already known get hardly
any time. Counts n of a look are Poisson counts given those before it, and its dwells d depend on
these alone, so that the likelihood of a mask's rate r is a constant times r^Σn · e^(−rΣd): the sums
over the looks are sufficient statistics of the scene, and both networks read these sums.

The classifier is trained to answer after every look, so that an exposure may end early.
"""

from collections.abc import Callable, Iterator
from dataclasses import KW_ONLY, dataclass, replace
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from deepfsi.base.errors import InputError
from deepfsi.camera.camera import Camera
from deepfsi.camera.light import share_out
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.designfile.distribution import FrameLight
from deepfsi.exposure.kind import (
    UNTRAINED,
    Counting,
    Dwells,
    MaskExposure,
    Observation,
    Show,
    Stops,
    TrainedMasks,
    Use,
)
from deepfsi.exposure.training import ExposureTraining, JobGroup, deviation
from deepfsi.exposure.training_set import network_dtype
from deepfsi.jobs.exposures import LARGEST_SCORE, ExposureEntry, Looks, LooksEntry
from deepfsi.networks.classifiers import Mlp, Replicas, restore_network
from deepfsi.physics.laws import light_law, through
from deepfsi.physics.masks import FixedMasks, LearnedMasks
from deepfsi.physics.scanner import Scanner, project
from deepfsi.physics.training_noise import Draws, SeedStream

Choose = Callable[[Tensor], Tensor]
"""From inputs (..., k + q + 1) to the scores (..., q) of dwells."""


ON_WEIGHT = 0.2
"""Time of the all-ON frames of a scene over the exposure, where their readouts are calibrated."""


@dataclass(frozen=True, eq=False)
class LooksExposure(MaskExposure):
    """Exposure of several looks, whose dwells a network chooses from the counts so far.

    The masks' rails, and the statistics of their features, are those of equal dwells, 1 / q.
    """

    dwells: Dwells
    network: Mlp  # from k + q + 1 inputs to q outputs
    looks: int  # K
    shortest: float = 0.0  # shortest dwell of a frame that is shown, a share of the whole exposure
    _: KW_ONLY
    optics: TrainedMasks = UNTRAINED
    cap: float = 1.0
    until: float = 1.0  # probability of a class above which an exposure ends
    kind = "adaptive"
    chooses: ClassVar[bool] = True
    refusals: ClassVar[dict[Use, str]] = {
        "comparison": "this design chooses dwells while the exposure runs, and its counts are "
        "tested with the all-ON frames of their scene: run it with `deepfsi camera live`, or give "
        "`deepfsi.classify_run` a live run",
        "ideal observer": "the dwells of this design follow the counts: give one of fixed dwells, "
        "learned with 1 look",
    }

    def entry(self) -> LooksEntry:
        """Entry of the design file's header."""
        return LooksEntry(
            looks=self.looks,
            hidden=self.network.hidden,
            shortest=self.shortest,
            cap=self.cap,
            until=self.until,
        )

    @classmethod
    def restored(
        cls, entry: ExposureEntry, weights: dict[str, Tensor], optics: TrainedMasks
    ) -> "LooksExposure":
        """The exposure with its network; parameters as for `MaskExposure.restored`."""
        assert isinstance(entry, LooksEntry)
        dwells = Dwells.of(optics.rails.masks, optics.light, optics.rails.kind)
        inputs = len(optics.mean) + dwells.count + 1
        sizes = {"inputs": inputs, "classes": dwells.count, "hidden": entry.hidden}
        network = restore_network(Mlp, weights, **sizes)
        made = cls(
            dwells,
            network,
            entry.looks,
            entry.shortest,
            optics=optics,
            cap=entry.cap,
            until=entry.until,
        )
        made.check_masks()
        return made

    def to(self, device: str | torch.device) -> "LooksExposure":
        """The kind on a device."""
        return replace(super().to(device), network=self.network.to(device))

    def check_masks(self) -> None:
        """Raise `ValueError` unless the masks can be exposed so."""
        light = self.optics.light
        equal = light_law(light).has_equal_dwells(self.optics.rails.stacked)
        if not (equal and LIGHT_LAWS[light].looks):
            raise ValueError("dwells are chosen for frames of one device that all have the same")

    def input_count(self, features: int) -> int:
        """Number of the classifier's inputs: features and dwells."""
        return features + self.dwells.count

    def front_end(self, camera: Camera | None) -> Scanner:
        """The scanner with the noise of a camera."""
        scanner = super().front_end(camera)
        if faults := Looks(looks=self.looks).test_faults([scanner.noise.name]):
            raise InputError(faults[0])
        return scanner

    def observe(
        self, front: Scanner, rates: Tensor, photons: float, generator: torch.Generator
    ) -> Iterator[Observation]:
        """Exposures after each look."""

        def show(dwell: Tensor) -> tuple[Tensor, Tensor]:
            share = self.dwells.scaled(torch.ones_like(rates), dwell)
            return self.read(front, rates * share * photons, generator, photons, share=share), dwell

        mean = self.optics.mean.expand(*rates.shape[:-2], -1)
        return self.expose_live(show, mean, self.optics.std)

    def expected(self, rates: Tensor, seen: Observation) -> Tensor:
        """Photons of an exposure that are expected."""
        assert seen.dwell is not None
        return self.dwells.scaled(rates, seen.dwell)

    def next_dwell(self, choose: Choose, inputs: Tensor, left: Tensor) -> Tensor:
        """Dwells (..., q) of the next look, of inputs and the share (..., 1) that is left."""
        scores = choose(torch.cat([inputs, left], dim=-1))
        return (LARGEST_SCORE * torch.tanh(scores / LARGEST_SCORE)).softmax(dim=-1) / self.looks

    def expose_live(
        self, show: Show, mean: Tensor, std: Tensor, choose: Choose | None = None
    ) -> Iterator[Observation]:
        """Exposures after each look: one loop for training, tests and a camera, for one or many."""
        # mean, std (..., k); in training `choose` is the networks of several designs
        features = torch.zeros_like(mean)
        total = mean.new_zeros(*mean.shape[:-1], self.dwells.count)
        seen = Observation(features, total)
        for look in range(self.looks):
            left = torch.full_like(total[..., :1], 1 - look / self.looks)
            dwell = self.next_dwell(choose or self.network, seen.inputs(mean, std), left)
            if self.shortest:
                dwell = through(dwell, share_out(dwell.detach(), self.shortest))
            counts, shown = show(dwell)
            features = features + counts
            total = total + shown
            seen = Observation(features, total)
            yield seen

    def usual_readouts(
        self, rates: Tensor, lit: Tensor, light: FrameLight | None = None
    ) -> tuple[Tensor, Counting | None]:
        """Readouts of all rails and of all mirrors ON."""

        def expose(photons: float, rng: np.random.Generator) -> list[tuple[np.ndarray, np.ndarray]]:
            every = torch.zeros_like(rates)
            ones = torch.ones_like(rates)
            bright = lit.double().cpu().numpy()[:, None]
            level = light.levels(bright.shape, rng) if light else 1.0
            on = rng.poisson(ON_WEIGHT * photons * bright * level), np.full(bright.shape, ON_WEIGHT)

            def show(dwell: Tensor) -> tuple[Tensor, Tensor]:
                expected = (self.dwells.scaled(rates, dwell) * photons).double().cpu().numpy()
                drawn = light.counts(expected, rng) if light else rng.poisson(expected)
                counts = torch.from_numpy(drawn).to(rates)
                every.add_(counts)
                return self.detection.features(counts) / photons, dwell

            out = []
            mean = self.optics.mean.expand(len(rates), -1)
            for seen in self.expose_live(show, mean, self.optics.std):
                assert seen.dwell is not None
                held = every, self.dwells.scaled(ones, seen.dwell)
                pair = (part.double().flatten(1).cpu().numpy() for part in held)
                out.append(tuple(np.hstack(each) for each in zip(pair, on, strict=True)))
            return out  # type: ignore[return-value]

        whole = torch.cat([rates.flatten(1), lit[:, None]], dim=1)[:, None]
        return whole, expose

    @property
    def dwell_words(self) -> str:
        """Words on `mask_dwells`, those of the first look."""
        share = f"{1 / self.looks:.0%}"
        return f"share of the exposure in the first of {self.looks} looks, {share} of it each"

    def mask_dwells(self) -> Tensor | None:
        """Share (m,) of the exposure that each mask is shown in the first look."""
        mean = self.optics.mean

        def show(dwell: Tensor) -> tuple[Tensor, Tensor]:
            return torch.zeros_like(mean), dwell

        first = next(self.expose_live(show, mean, self.optics.std)).dwell
        assert first is not None, "dwells are chosen"
        return first.unflatten(-1, (self.count, -1)).sum(dim=-1)

    @property
    def stops(self) -> Stops:
        """Numbers of looks after which an exposure may stop, and the share taken then."""
        after = range(1, self.looks + 1)
        return Stops(tuple(after), self.cap * (np.array(after) / self.looks))

    @property
    def count_stops(self) -> int:
        """K, an answer after each look."""
        return self.looks

    def stop_place(self, seen: Observation) -> Tensor:
        """Place (..., 1) of an exposure among its looks, from 0, by the time it took."""
        assert seen.dwell is not None
        return seen.dwell.sum(dim=-1, keepdim=True) * self.looks - 1

    def stopping_at(self, threshold: float) -> "LooksExposure":
        """The kind as it is: a device decides when an exposure stops, unless light is shared."""
        return replace(self, until=threshold) if self.cap > 1 else self

    def check_dwell(self, given: bool) -> None:
        """Raise `InputError` if dwells are not given."""
        if not given:
            raise InputError(
                "dwells go with a design that chooses them, and only with it: give dwell, or use "
                "`classify_live`"
            )


class LooksTraining(ExposureTraining):
    """Masks of equal dwells, and networks that choose dwells from the counts so far."""

    exposures: list[LooksExposure]

    def __init__(self, group: JobGroup) -> None:
        super().__init__(group)
        camera = self.camera
        asked = self.job.exposure
        device = self.scenes.device
        assert isinstance(asked, Looks)
        dwells = Dwells.of(self.job.masks, camera.light, camera.rails)
        inputs = self.input_count + dwells.count + 1
        hidden = self.job.training.hidden
        seeds = [torch.Generator(device).manual_seed(job.seed) for job in self.jobs]
        networks = [Mlp(inputs, dwells.count, hidden, generator=seed) for seed in seeds]
        self.exposures = [
            LooksExposure(
                dwells,
                network,
                asked.looks,
                shortest=camera.shortest_share / asked.cap,
                cap=asked.cap,
            )
            for network in networks
        ]
        self.dwells = dwells
        self.input_count = self.exposures[0].input_count(self.input_count)
        self.choose = Replicas(networks, device.type == "cuda", network_dtype(self.job, device))
        if not self.learns:
            self.masks = self.fixed_masks(self.law.equalise(self.named_rails()))
            return
        # as frames of equal dwells: theirs are chosen later
        law = self.law.of_equal_dwells
        masks = LearnedMasks(self.start(), law.name, camera.rails, self.levels)
        if law.dwells_of_mask(camera.rails):
            masks.dwell.requires_grad_(False)  # equal from the start
        self.masks = masks.to(device)

    def prepare(self) -> None:
        """Take the centred scenes."""
        self.x, self.arranged = self.centred()

    def inputs(self, draws: Draws) -> Tensor:
        """Features and dwells (K · B, R, k + q) after each of K looks."""
        masks = self.arranged()
        rails = masks.stacked
        detection = self.detection
        usual = detection.readouts(masks)
        dwells = self.dwells

        def products_of(stream: SeedStream) -> Tensor:
            x = self.x.index_select(0, stream.with_mean)
            return stream.repeated(project(x, stream.of_jobs(rails), detection.count))

        products = draws.side_by_side(products_of)
        centred = products[:-1]
        middle = products[-1]
        light = centred + middle
        mean = detection.features(middle)
        power = detection.features(centred).square().mean(dim=0)
        std = deviation(power + detection.totals(middle) / self.noise.gain, self.scale)

        def read(dwell: Tensor) -> tuple[Tensor, Tensor]:
            rates = dwells.scaled(light, dwell)
            expected = detection.features(rates)
            sums = detection.totals(rates)

            def counted(stream: SeedStream) -> Tensor:
                jobs = stream.replicas
                readouts = stream.readouts(usual)
                if stream.noise.kind.facts.dark:
                    share = dwells.scaled(torch.ones_like(light[:, jobs]), dwell[:, jobs])
                    readouts = readouts.lasting(share, detection)
                pair = expected[:, jobs], sums[:, jobs]
                return stream.noise.features(*pair, readouts, stream.normal)

            return draws.side_by_side(counted), dwell

        start = mean.expand(len(light), *mean.shape)
        looks = self.exposures[0].expose_live(read, start, std, self.choose)
        return torch.cat([seen.inputs(mean, std) for seen in looks])

    def fix(self) -> None:
        """Masks that have learned get equal dwells at the end only."""
        # The gradient of that would take from lit mirrors what they share
        if self.learns:
            self.masks = FixedMasks(self.law.equalise(self.all_pixels()))
