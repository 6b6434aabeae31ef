"""The record of what a live run showed, `shown.jsonl`: a line for each scene that is finished.

A line is written when its scene is decided, so that a run that is stopped at any moment keeps all
scenes before.
"""

from base64 import b64decode, b64encode
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from deepfsi.base.errors import InputError
from deepfsi.base.files import read_regular
from deepfsi.base.models.strict import StrictModel, WholeNumber
from deepfsi.hardware.light.checks import Fault
from deepfsi.hardware.live.looks import FrameList
from deepfsi.hardware.patterns.manifest import Manifest

LARGEST_LOG = 2**31
"""Bytes of a record at most."""


class LoggedList(StrictModel):
    """A list of frames as it was shown."""

    look: int = Field(ge=-1, le=1023)  # From 0; -1 for those that begin and end a scene
    frames: tuple[int, ...]  # Places among the frames of the manifest
    gate_ns: tuple[int, ...]  # For how long each was counted
    # Markers that each gave, and at the end those of the all-OFF frame that was shown while the
    # next list was chosen
    markers: tuple[int, ...]
    masks: tuple[str, ...] = ()  # Pixels ON of frames that were made for this list, base64 of bits

    @classmethod
    def of(cls, asked: FrameList, markers: np.ndarray) -> Self:
        """A list that was shown, with the markers (F + 1,) of its frames and of the last one."""
        return cls(
            look=asked.look,
            frames=tuple(asked.frames.tolist()),
            gate_ns=tuple(asked.gate_ns.tolist()),
            markers=tuple(markers.tolist()),
            masks=_packed(asked.masks),
        )

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if not len(self.frames) == len(self.gate_ns) == len(self.markers) - 1:
            raise ValueError("frames, gates and markers differ in number")
        if min(self.gate_ns, default=1) < 0 or min(self.markers, default=1) < 1:
            raise ValueError("gates are 0 or more, and each frame gives a marker")
        return self

    def matches(self, asked: FrameList) -> bool:
        """True if these are the frames and their gates."""
        return (
            self.look == asked.look
            and np.array_equal(self.frames, asked.frames)
            and np.array_equal(self.gate_ns, asked.gate_ns)
        )

    def as_shown(self, manifest: Manifest) -> FrameList:
        """The list as it was shown; its masks have the pixels of the patterns."""
        masks = None
        if self.masks:
            pixels = prod(manifest.image_shape)
            size = (pixels + 7) // 8
            try:
                bits = np.frombuffer(b"".join(map(b64decode, self.masks)), np.uint8)
                masks = np.unpackbits(bits.reshape(-1, size), axis=1, count=pixels).astype(bool)
            except ValueError:
                raise InputError(
                    f"masks in {FrameLog.NAME} are not of {pixels} pixels: the file was changed"
                ) from None
        return FrameList(self.look, np.array(self.frames), np.array(self.gate_ns), masks)


def _packed(masks: np.ndarray | None) -> tuple[str, ...]:
    """Masks (F, N) of bool, or none, each as the base64 of its bits."""
    if masks is None:
        return ()
    return tuple(b64encode(bits.tobytes()).decode() for bits in np.packbits(masks, axis=1))


class LoggedScene(StrictModel):
    """A scene as it was shown, and what was decided."""

    scene: WholeNumber  # From 0
    first_marker: WholeNumber  # Markers before those of this scene
    lists: tuple[LoggedList, ...]  # In their order
    chances: tuple[float, ...]  # Probabilities of the classes; none if there was no light
    faults: tuple[Fault, ...] = ()  # Of the scene
    light_s: float = Field(ge=0)  # Exposure used, seconds
    clock_s: float = Field(ge=0)  # From the scene's first command to its decision, seconds

    @property
    def line(self) -> bytes:
        """Its line in the record."""
        return f"{self.model_dump_json()}\n".encode()

    @property
    def first_markers(self) -> list[np.ndarray]:
        """Number of the marker that each frame begins with, list by list."""
        before = self.first_marker
        out = []
        for shown in self.lists:
            markers = np.array(shown.markers, np.int64)
            out.append((before + np.cumsum(markers) - markers)[:-1])
            before += int(markers.sum())
        return out


@dataclass(frozen=True)
class FrameLog:
    """Finished scenes of a live run, in their order."""

    NAME: ClassVar = "shown.jsonl"
    scenes: tuple[LoggedScene, ...]

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Record of a run, or `InputError` if it has no scenes or they do not follow."""
        # A last line that is not whole is that of a run that was killed, and is left out
        path = folder / cls.NAME
        content = read_regular(path, LARGEST_LOG, "give a run of `camera live`")
        lines = content.split(b"\n")[:-1]
        try:
            scenes = tuple(LoggedScene.model_validate_json(line) for line in lines)
        except ValidationError:
            raise InputError(f"{path} is damaged: run `deepfsi camera live` again") from None
        numbers = [scene.scene for scene in scenes]
        if not numbers:
            raise InputError(f"{path} has no finished scene: run `deepfsi camera live` again")
        if numbers != list(range(len(numbers))):
            raise InputError(f"{path} has scenes that do not follow each other: it was changed")
        return cls(scenes)
