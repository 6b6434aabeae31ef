"""Right answers to labelled scenes, those that a design was trained on apart from new ones."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from deepfsi.base.numeric.intervals import wilson
from deepfsi.designfile.provenance import NO_MEASURE


@dataclass(frozen=True)
class RightAnswers:
    """Right answers to some scenes."""

    right: int = 0
    answers: int = 0  # of all their exposures
    scenes: int = 0

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the share that is right, over scenes as the trials (Wilson)."""
        return wilson(self.right / self.answers, self.scenes)

    def line(self, what: str) -> str:
        """Right answers to some pictures or exposures, which words name, and their interval."""
        low, high = self.interval
        share = f"{self.right / self.answers:.2f}, 95 % {low:.2f} to {high:.2f}"
        return f"right: {self.right} of {self.answers} {what} ({share})"

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        low, high = self.interval if self.answers else (None, None)
        share = self.right / self.answers if self.answers else None
        return {**vars(self), "share": share, "low": low, "high": high}


@dataclass(frozen=True)
class Score:
    """Right answers to labelled scenes. Those to new ones alone measure the design."""

    new: RightAnswers
    trained_on: RightAnswers
    unknown: RightAnswers  # to scenes of which that is not known

    @classmethod
    def of(cls, scenes: Iterable[tuple[bool | None, int, int]]) -> "Score":
        """Score of scenes: whether trained on, and numbers of right answers and of all."""
        kinds: dict[bool | None, RightAnswers] = dict.fromkeys((False, True, None), RightAnswers())
        for trained, right, answers in scenes:
            if answers:
                before = kinds[trained]
                kinds[trained] = RightAnswers(
                    before.right + right, before.answers + answers, before.scenes + 1
                )
        return cls(kinds[False], kinds[True], kinds[None])

    @property
    def answers(self) -> int:
        """Number of answers to all scenes."""
        return self.new.answers + self.trained_on.answers + self.unknown.answers

    def lines(self, noun: str) -> list[str]:
        """Score in words, new scenes first, with what an answer is to: a picture, an exposure."""
        new = self.new
        trained = self.trained_on
        unknown = self.unknown
        lines = []
        if new.answers:
            also = f"new {noun}s" if trained.answers else f"{noun}s, none of them trained on"
            lines.append(new.line(also))
        if trained.answers and new.answers:
            lines.append(
                f"{trained.answers} of these {new.answers + trained.answers} {noun}s were trained "
                f"on ({trained.right} right); of the other {new.answers}, {new.right} are right"
            )
        elif trained.answers:
            lines.append(
                f"all {trained.answers} {noun}s were trained on ({trained.right} right): "
                f"{NO_MEASURE}"
            )
        if unknown.answers:
            lines.append(
                f"{unknown.line(noun + 's')}; whether the design was trained on them is not known"
            )
        return lines

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {name: each.as_dict() for name, each in vars(self).items()}
