"""A finished design: masks, classifier and provenance, in one file that holds no code."""

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from pydantic import BaseModel
from torch import Tensor, nn

from deepfsi.datasets import Dataset
from deepfsi.design.adaptive import AdaptiveDwells, Exposure
from deepfsi.design.artifact_file import (
    build_mlp,
    damaged,
    kind_of,
    pack,
    read_design,
    sound_schedule,
)
from deepfsi.design.classifiers import Mlp
from deepfsi.design.conditioning import Conditioning
from deepfsi.errors import InputError
from deepfsi.files import write_atomically
from deepfsi.optics import constraints
from deepfsi.optics.budget import check_budget
from deepfsi.optics.constraints import Light
from deepfsi.optics.scanner import Scanner, subtract

LATE = 0.05
"""By how much a look may be longer than asked, relative, for frames in whole microseconds."""


@dataclass
class Design:
    """Masks and the classifier that reads them.

    Attributes
    ----------
    name : str
        Which design, a key of `codes.DESIGNS`.
    rails : tensor, shape (2 or 1, m, N)
        M⁺ and M⁻, or the one rail; shares of each pixel's photons.
    classifier : nn.Module
        Standardised features (..., m) to logits (..., C).
    mean, std : tensor, shape (m,)
        Mean and standard deviation of the features y / Φ, fixed at the end of training.
    shares : tensor, shape (m,)
        Share of the budget that each mask's rails count together, in the training mean.
    summed_reflectance : float
        s, the training scenes' mean summed reflectance; λ = Φ x / s.
    light : str
        Light constraint that the rails obey.
    image_shape : tuple of int
    classes : tuple of str
    told : Conditioning, optional
        What the classifier is told besides features, if it is.
    used : float
        Share of the whole sequence's light that masks would take within it, for its first ones.
    schedule : AdaptiveDwells, optional
        What chooses dwells while the exposure runs, if they are not fixed. `rails`, `mean` and
        `std` are then those of equal dwells, 1 / m.
    info : dict
        Provenance: how it was trained, on which data, with which versions. JSON types only.
    """

    name: str
    rails: Tensor
    classifier: nn.Module
    mean: Tensor
    std: Tensor
    shares: Tensor
    summed_reflectance: float
    light: Light
    image_shape: tuple[int, ...]
    classes: tuple[str, ...]
    told: Conditioning | None = None
    used: float = 1.0
    schedule: AdaptiveDwells | None = None
    info: dict[str, Any] = field(default_factory=dict)

    @property
    def matrix(self) -> np.ndarray:
        """Sensing matrix M (m, N), float32: the share of each pixel's photons, signed by rail."""
        return constraints.combine(self.rails)[0].cpu().numpy()

    @property
    def masks(self) -> int:
        """m, number of masks."""
        return self.rails.shape[1]

    @property
    def pixels(self) -> int:
        """N, number of pixels."""
        return self.rails.shape[2]

    def as_patches(self, scenes: Tensor) -> Tensor:
        """Scenes (..., N) as the masks see them: as they are."""
        return scenes

    def scanner(self, noise: str = "poisson", sigma: float = 1.0) -> Scanner:
        """The optical front end, with a noise of your choice."""
        return Scanner.from_rails(self.rails, noise, sigma)  # type: ignore[arg-type]

    def adaptive_logits(self, seen: Exposure) -> Tensor:
        """Logits (..., C) of exposures whose dwells a schedule chose."""
        return self.classifier(seen.inputs(self.mean, self.std))

    def logits(self, features: Tensor, photons: Tensor | float) -> Tensor:
        """Logits (..., C) of features y⁺ − y⁻ (..., m) in counts, at a budget of `photons`."""
        scaled = (features / photons - self.mean) / self.std
        if self.told:
            ratio = torch.as_tensor(photons).to(scaled) / (self.used * self.told.photons)
            scaled = self.told.inputs(scaled, ratio, ratio.new_tensor(self.masks))
        return self.classifier(scaled)

    def expose(
        self, scanner: Scanner, rates: Tensor, generator: torch.Generator, photons: float
    ) -> Iterator[Exposure]:
        """Exposures after each look, with dwells that a schedule chooses and counts of a scanner.

        Parameters
        ----------
        scanner : Scanner
            Of this design.
        rates : tensor, shape (..., 1, m)
            Expected counts at equal dwells, for a budget of one photon.
        generator : torch.Generator
        photons : float
            Budget Φ.
        """
        assert self.schedule is not None

        def read(dwell: Tensor) -> tuple[Tensor, Tensor]:
            shown = rates * (photons * self.masks * dwell.unsqueeze(-2))
            return subtract(scanner.read(shown, generator)) / photons, dwell

        mean = self.mean.expand(*rates.shape[:-2], -1)
        return self.schedule(read, mean, self.std)

    def answer(
        self, scanner: Scanner, rates: Tensor, generator: torch.Generator, photons: float
    ) -> Tensor:
        """Logits (..., C) of exposures whose counts a scanner draws, with dwells fixed or chosen.

        Parameters as for `expose`; rates are of every rail, (..., rails, m).
        """
        if self.schedule is None:
            return self.logits(subtract(scanner.read(rates * photons, generator)), photons)
        *_, seen = self.expose(scanner, rates, generator, photons)
        return self.adaptive_logits(seen)

    def classify_live(
        self,
        read: Callable[[np.ndarray], Any],
        photons: float,
        until: Callable[[int, np.ndarray], tuple[np.ndarray, bool]] | None = None,
    ) -> np.ndarray:
        """Class probabilities (C,) of an exposure whose dwells are chosen while it runs.

        Parameters
        ----------
        read : callable
            Called once for each look: shows each mask, ``rails[0] * masks`` in 0 .. 1, for the
            given shares (m,) of the exposure time, floats that sum to 1 / K, and returns the counts
            (m,) of this look. Where a device cannot show these, as frames have a shortest time, a
            pair: counts, and the shares shown.
        photons : float
            Budget Φ of the whole exposure, or an estimate of it.
        until : callable, optional
            Told the looks so far and the probabilities (C,) after them; returns probabilities, and
            whether the exposure ends there. `stopping.StoppingRule.decide` is one.

        Raises
        ------
        InputError
            If the design has fixed dwells, or counts or photons are not as `classify` takes them.
        """
        if self.schedule is None:
            raise InputError(
                "the dwells of this design are fixed: show all masks and use `classify`, or learn "
                "a design with --looks"
            )
        budget, counted = check_budget(photons), np.zeros(self.masks)

        def show(dwell: Tensor) -> tuple[Tensor, Tensor]:
            nonlocal counted
            asked = dwell.cpu().numpy()
            seen = read(asked.copy())
            pair = seen if isinstance(seen, tuple) else (seen, asked)
            try:
                counts, shown = (np.asarray(part, dtype=float) for part in pair)
            except (TypeError, ValueError):
                counts, shown = np.empty(0), asked
            if not counts.shape == shown.shape == (self.masks,):
                raise InputError(
                    f"a look does not fit this design: return ({self.masks},) counts, or a pair of "
                    "counts and shares shown"
                )
            if not np.isfinite(counts).all():
                raise InputError("a look holds NaN or infinity: return finite counts")
            if not 0 <= shown.sum() <= asked.sum() * (1 + LATE):
                raise InputError(
                    f"a look that took {shown.sum():.4g} of the exposure was to take "
                    f"{asked.sum():.4g}: show each mask for at most the shares asked"
                )
            counted = counted + counts
            return torch.from_numpy(counts / budget).to(dwell), torch.from_numpy(shown).to(dwell)

        with torch.no_grad():
            for look, seen in enumerate(self.schedule(show, self.mean, self.std), start=1):
                if until is None and look < self.schedule.looks:
                    continue
                chances, enough = self.classify(counted, budget, seen.dwell.cpu().numpy()), False
                if until is not None:
                    chances, enough = until(look, chances)
                if enough:
                    break
        return chances

    def classify(self, counts: Any, photons: Any, dwell: Any = None) -> np.ndarray:
        """Class probabilities of one or many exposures.

        Parameters
        ----------
        counts : array, shape (..., 2, m) for dual-rail designs, (..., m) for single-rail ones
            Counts of each readout, first the positive rails, then the negative ones. A dark rail
            reads 0.
        photons : float or array, shape (...)
            Budget Φ of each exposure, or an estimate of it (an all-ON frame gives one).
        dwell : array, shape (..., m), optional
            Share of the exposure that each mask had: goes with designs that have a `schedule`,
            whose counts are those of all looks together.

        Returns
        -------
        array, shape (..., C)
            Probabilities that sum to 1.

        Raises
        ------
        InputError
            If shapes do not match the design, counts are not finite or the budget is not above 0.
        """
        if (dwell is None) != (self.schedule is None):
            raise InputError(
                "dwells go with a design that chooses them, and only with it: "
                + ("give dwell, or use `classify_live`" if dwell is None else "leave dwell out")
            )
        try:
            read = torch.tensor(np.asarray(counts, dtype=np.float32))
            budget = torch.tensor(np.asarray(photons, dtype=np.float32))
            shown = None if dwell is None else torch.tensor(np.asarray(dwell, dtype=np.float32))
        except (TypeError, ValueError):
            raise InputError("counts, photons and dwell must be arrays of numbers") from None
        dual = len(self.rails) == 2
        wanted = (2, self.masks) if dual else (self.masks,)
        if tuple(read.shape[-len(wanted) :]) != wanted:
            raise InputError(
                f"counts of shape {tuple(read.shape)} do not fit this design: give (..., "
                f"{', '.join(map(str, wanted))})"
            )
        if not bool(torch.isfinite(read).all()):
            raise InputError("counts hold NaN or infinity: give finite counts")
        if shown is not None and (
            shown.shape != read.shape or not bool((torch.isfinite(shown) & (shown >= 0)).all())
        ):
            raise InputError(
                f"dwells of shape {tuple(shown.shape)} do not fit counts of shape "
                f"{tuple(read.shape)}: give a share of 0 or more for each count"
            )
        if not bool((torch.isfinite(budget) & (budget > 0)).all()):
            raise InputError("photons must be a finite number above 0 for every exposure")
        device = self.rails.device
        features = subtract(read) if dual else read
        try:
            budget = budget.expand(features.shape[:-1]).unsqueeze(-1)
        except RuntimeError:
            raise InputError(
                f"photons of shape {tuple(budget.shape)} do not fit counts of shape "
                f"{tuple(read.shape)}: give one number, or one for each exposure"
            ) from None
        with torch.no_grad():
            features, budget = features.to(device), budget.to(device)
            if shown is None:
                logits = self.logits(features, budget)
            else:
                logits = self.adaptive_logits(Exposure(features / budget, shown.to(device)))
        return logits.softmax(dim=-1).cpu().numpy()

    def check_fixed(self) -> None:
        """Raise `InputError` if a schedule chooses dwells, for what shows or reads fixed ones."""
        if self.schedule is not None:
            raise InputError(
                "this design chooses dwells while the exposure runs, which a fixed sequence of "
                "patterns or one graph cannot: use Design.classify_live in a program of yours"
            )

    def readouts(self, rails: np.ndarray) -> np.ndarray:
        """Counts (..., rails, m) of every rail, in the shape that `classify` takes."""
        return rails if len(self.rails) == 2 else rails[..., 0, :]

    def to(self, device: str | torch.device) -> Self:
        """Move to a device; returns self."""
        self.rails = self.rails.to(device)
        self.mean, self.std = self.mean.to(device), self.std.to(device)
        self.shares = self.shares.to(device)
        self.classifier = self.classifier.to(device)
        if self.schedule is not None:
            self.schedule = self.schedule.to(device)
        return self

    def quantised(self, levels: int) -> "Design":
        """The design as a device of that many grey levels shows it, dark included (paper: 769).

        Masks are multiples of 1 / (levels − 1) of each frame's peak. Classifier and statistics stay
        as they are; `TrainingSettings.levels` trains for such a device.
        """
        rails = constraints.quantise(self.rails, self.light, levels - 1)
        return replace(self, rails=rails)

    def first(self, masks: int) -> "Design":
        """The first masks alone, with the light that the constraint gives to so many.

        On one device their frames share the whole exposure. An exposure of all masks that stops
        after these has taken `used` of its budget, and is one of this design at that budget.

        Raises
        ------
        InputError
            If the design was not trained for so few.
        """
        fewest = self.info.get("job", {}).get("training", {}).get("nested", 0) or self.masks
        if not fewest <= masks <= self.masks:
            raise InputError(
                f"the first {masks} masks of this design do not do by themselves: give "
                f"{fewest} to {self.masks}"
                + ("" if fewest < self.masks else ", or learn nested ones with --nested")
            )
        used = constraints.used(self.rails, self.light)
        share = float(used[masks - 1] / used[-1])
        return replace(
            self,
            rails=self.rails[:, :masks] / share,
            mean=self.mean[:masks] / share,
            std=self.std[:masks] / share,
            shares=self.shares[:masks] / share,
            used=self.used * share,
        )

    def as_shown(self, rails: np.ndarray, image_shape: tuple[int, ...], dimmed: float) -> "Design":
        """The design as patterns on a device realise it.

        The classifier stays as it is. Where one device gives a design less light, its features are
        as much smaller, and so are the statistics that scale them.

        Parameters
        ----------
        rails : array, shape (2 or 1, m, N)
            What the patterns realise.
        image_shape : tuple of int
            Cells of a pattern.
        dimmed : float
            Realised matrix over designed one, up to 1.

        Raises
        ------
        InputError
            If the patterns are of a design of another shape, or dwells are not fixed.
        """
        self.check_fixed()
        if rails.shape != tuple(self.rails.shape) or image_shape != self.image_shape:
            raise InputError(
                f"patterns of {rails.shape[1]} masks of {image_shape} cells and "
                f"{len(rails)} rails are not of this design, with {self.masks} masks of "
                f"{self.image_shape} and {len(self.rails)} rails: export it with `deepfsi dmd`"
            )
        return replace(
            self,
            rails=torch.from_numpy(rails).to(self.rails),
            light="free-dwell" if self.light == "column" else self.light,
            mean=self.mean * dimmed,
            std=self.std * dimmed,
            shares=self.shares * dimmed,
            used=self.used / dimmed,
        )

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write one safetensors file, all or nothing.

        Raises
        ------
        InputError
            As `to_bytes`.
        """
        return write_atomically(path, self.to_bytes())

    def to_bytes(self) -> bytes:
        """Content of the design file.

        Raises
        ------
        InputError
            If the classifier is not an `Mlp`: a module of your own cannot be rebuilt from a file.
        """
        if not isinstance(self.classifier, Mlp):
            raise InputError(
                f"a design with a {type(self.classifier).__name__} classifier cannot be saved: "
                "only Mlp can; save its state_dict() yourself"
            )
        network = {
            "kind": "mlp",
            "hidden": list(self.classifier.hidden),
            "dropout": self.classifier.dropout,
        }
        if self.schedule is not None:
            chooser = self.schedule.network
            how = {"looks": self.schedule.looks, "hidden": list(chooser.hidden)}
            return pack(self, 3, network, schedule=how)
        if self.told:
            return pack(self, 2, network, told=asdict(self.told), used=self.used)
        return pack(self, 1, network)

    @classmethod
    def load(cls, path: str | os.PathLike[str], device: str | torch.device = "cpu") -> "Design":
        """Read a design file.

        Raises
        ------
        InputError
            If the file is missing, damaged, truncated, not a design, or of a newer schema.
        """
        header, tensors = read_design(path)
        if kind_of(header) == "vit":
            raise InputError(f"{path} is a design of image patches: load it with PatchDesign.load")
        try:
            network = header["classifier"]
            told = Conditioning(**header["told"]) if "told" in header else None
            masks, how = tensors["rails"].shape[1], header.get("schedule")
            inputs = 2 * masks if how else told.masks + 2 if told else masks
            sizes = inputs, len(header["classes"]), network["hidden"], network["dropout"]
            schedule = None
            if how:
                chooser = build_mlp(tensors, "schedule.", 2 * masks + 1, masks, how["hidden"])
                schedule = AdaptiveDwells(chooser, how["looks"])
            design = cls(
                name=header["name"],
                rails=torch.from_numpy(tensors["rails"]),
                classifier=build_mlp(tensors, "classifier.", *sizes),
                mean=torch.from_numpy(tensors["mean"]),
                std=torch.from_numpy(tensors["std"]),
                shares=torch.from_numpy(tensors["shares"]),
                summed_reflectance=header["summed_reflectance"],
                light=header["light"],
                image_shape=tuple(header["image_shape"]),
                classes=tuple(header["classes"]),
                told=told,
                used=header.get("used", 1.0),
                schedule=schedule,
                info=header["info"],
            )
            sound = (
                network["kind"] == "mlp"
                and isinstance(design.name, str)
                and isinstance(design.info, dict)
                and isinstance(design.info.get("job", {}), dict)
                and all(isinstance(name, str) for name in design.classes)
                and all(isinstance(side, int) and side > 0 for side in design.image_shape)
                and design.rails.ndim == 3
                and len(design.rails) in (1, 2)
                and {design.mean.shape, design.std.shape, design.shares.shape} == {(design.masks,)}
                and np.prod(design.image_shape) == design.pixels
                and all(bool(torch.isfinite(torch.from_numpy(t)).all()) for t in tensors.values())
                and design.summed_reflectance > 0
                and math.isfinite(design.summed_reflectance)
                and bool((design.std > 0).all())
                and (told is None or (design.masks <= told.masks and 0 < told.photons < math.inf))
                and (told is None or (1 <= told.span < math.inf and 0 < design.used < math.inf))
                and (schedule is None or sound_schedule(schedule, design))
            )
            constraints.check_light(design.light, "dual" if len(design.rails) == 2 else "single")
            constraints.check(design.rails, design.light)
        except (KeyError, TypeError, ValueError, RuntimeError, IndexError) as error:
            raise damaged(path) from error
        if not sound:
            raise damaged(path)
        return design.to(device)


def provenance(
    job: BaseModel, data: Dataset, device: torch.device, seconds: float
) -> dict[str, Any]:
    """How a design was trained: `Design.info`."""
    return {
        "job": job.model_dump(mode="json"),
        "data": {"name": data.name, "hash": data.hash},
        "preprocessing": data.preprocessing,
        "deepfsi": version("deepfsi"),
        "torch": torch.__version__,
        "device": device.type,
        "seconds": seconds,
    }
