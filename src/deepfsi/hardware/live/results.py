"""Answers of a live run: the class of each scene, as the run and its replay give it."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from deepfsi.base.errors import InputError, Message
from deepfsi.base.quantities import Table, plural
from deepfsi.designfile.provenance import Score, was_trained_on
from deepfsi.designfile.view_test import ViewResult
from deepfsi.hardware.counting.acquisition import Scene
from deepfsi.hardware.light.checks import SPOILING, Fault
from deepfsi.hardware.live.looks import LookChooser
from deepfsi.hardware.live.observer import Decision


@dataclass(frozen=True)
class LiveScene:
    """Class of a scene of a live run, from its looks."""

    name: str
    label: str | None  # class that it is known to be of
    predicted: str | None
    probability: float | None
    looks: int
    photons: float | None  # budget of a whole exposure
    light_s: float  # exposure that was used, seconds
    clock_s: float  # from the first command to the class, seconds
    faults: tuple[Fault, ...] = ()  # of its light, its budget and its counts
    trained_on: bool | None = None  # True if the design was

    @classmethod
    def of(
        cls, scene: Scene, decision: Decision | None, looks: LookChooser, *, clock_s: float
    ) -> Self:
        """Class of a scene after its last decision; none is of a scene without light."""
        [trained] = was_trained_on(looks.training_scenes, [scene.hash])
        best = None
        if decision and not any(fault.kind in SPOILING for fault in decision.faults):
            best = int(decision.chances.argmax())
        return cls(
            name=scene.name,
            label=scene.label,
            predicted=None if best is None else looks.classes[best],
            probability=None if decision is None or best is None else float(decision.chances[best]),
            looks=decision.look + 1 if decision else 0,
            photons=decision.photons if decision else None,
            light_s=decision.light_s if decision else 0.0,
            clock_s=clock_s,
            faults=decision.faults if decision else (),
            trained_on=trained,
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        names = {"name": "scene", "predicted": "class"}
        content = {names.get(name, name): value for name, value in vars(self).items()}
        content["faults"] = [str(fault) for fault in self.faults]
        return content

    def lines(self, exposure_s: float) -> list[str]:
        """Say the answer and each fault, of a whole exposure of so many seconds."""
        if not self.looks:
            return [f"{self.name}: no light"]
        faults = [Message("  {fault}", fault=fault.words()) for fault in self.faults]
        if self.predicted is None:
            return [f"{self.name}: no class", *faults]
        return [
            f"{self.name}: {self.predicted}, confidence {self.probability:.3f}, "
            f"{plural(self.looks, 'look')}, light {self.light_s * 1e3:.4g} ms "
            f"({self.light_s / exposure_s:.0%}), clock {self.clock_s * 1e3:.4g} ms",
            *faults,
        ]


@dataclass(frozen=True)
class LiveAnswers:
    """Classes of the scenes of a live run, as it was made or decided again from its counts."""

    exposure_s: float  # time of all looks, seconds
    scenes: tuple[LiveScene, ...]
    view: ViewResult | None = None

    @classmethod
    def of(
        cls, exposure_s: float, scenes: Iterable[LiveScene], decisions: Iterable[Decision | None]
    ) -> Self:
        """Answers of a run with its last decisions, the latest of which tells of the view."""
        views = [decision.view for decision in decisions if decision and decision.view]
        return cls(exposure_s, tuple(scenes), views[-1] if views else None)

    def check_classes(self, folder: Path) -> None:
        """Raise `InputError` if no scene of a run has light, or none has a class."""
        if not any(scene.looks for scene in self.scenes):
            raise InputError(
                "no scene of {folder} has light: no all-ON frame is brighter than the all-OFF "
                "ones; check the lamp, the inputs and the counter's trigger levels, or export with "
                "a longer {exposure}",
                setting="exposure",
                folder=folder,
            )
        if all(scene.predicted is None for scene in self.scenes):
            first = next(fault for scene in self.scenes for fault in scene.faults)
            raise InputError(
                "no scene of {folder} has a class: {fault}", folder=folder, fault=first.words()
            )

    def _score_lines(self) -> Iterator[str]:
        """Say how many scenes have no class, how many are right, and how the camera saw them."""
        none = sum(scene.predicted is None for scene in self.scenes)
        if none:
            yield f"no class: {none} of {len(self.scenes)} scenes"
        yield from self.score.lines("scene")
        if self.view is not None and self.view.remark:
            yield self.view.remark

    def run_lines(self) -> Iterator[str]:
        """Say how a run went that was just made, with the light and the time that it took."""
        yield from self._score_lines()
        count = len(self.scenes)
        light_s = sum(scene.light_s for scene in self.scenes) / count
        clock_s = sum(scene.clock_s for scene in self.scenes) / count
        yield (
            f"light used {light_s / self.exposure_s:.1%} of the exposures, clock time "
            f"{clock_s * 1e3:.4g} ms a scene"
        )

    def lines(self) -> Iterator[str | Table]:
        """Say the classes of a run that was replayed."""
        heads = ("scene", "class", "confidence", "looks", "light", "labelled", "remarks")
        rows = [
            (
                scene.name,
                scene.predicted or "none",
                "" if scene.probability is None else f"{scene.probability:.3f}",
                str(scene.looks),
                f"{scene.light_s / self.exposure_s:.0%}",
                scene.label or "",
                ", ".join(sorted({fault.kind for fault in scene.faults})),
            )
            for scene in self.scenes
        ]
        yield Table("a live run, replayed from its counts", heads, rows)
        names = [scene.name for scene in self.scenes]
        for scene in self.scenes:
            for fault in scene.faults:
                yield fault.words(names)
        yield from self._score_lines()

    @property
    def score(self) -> Score:
        """Right answers to the labelled scenes, of those that have a class."""
        return Score.of(
            (scene.trained_on, scene.predicted == scene.label, 1)
            for scene in self.scenes
            if scene.predicted is not None and scene.label is not None
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {
            "live": True,
            "score": self.score.as_dict(),
            "view": None if self.view is None else self.view.as_dict(),
            "scenes": [scene.as_dict() for scene in self.scenes],
        }
