"""The record of what a live run showed, `shown.jsonl`: a line for each scene that is finished.

A line is written when its scene is decided, so that a run that is stopped at any moment keeps all
scenes before.
"""

from base64 import b64encode
from pathlib import Path

import numpy as np
from pydantic import Field, ValidationError, model_validator

from deepfsi.base import InputError, read_regular
from deepfsi.base.models import StrictModel
from deepfsi.hardware.light import Fault
from deepfsi.hardware.live.looks import FrameList

DARK = -1
"""Number of the pass before the scenes, with these dark, by which their background is measured."""

NAME = "shown.jsonl"
"""File of the record in the folder of a run."""

LARGEST_FILE = 2**31
"""Bytes of a record at most."""


class ShownList(StrictModel):
    """A list of frames as it was shown."""

    look: int = Field(ge=-1, le=1023)  # From 0; -1 for those that begin and end a scene
    frames: tuple[int, ...]  # Places among the frames of the manifest
    gate_ns: tuple[int, ...]  # For how long each was counted
    # Markers that each gave, and at the end those of the all-OFF frame that was shown while the
    # next list was chosen
    markers: tuple[int, ...]
    masks: tuple[str, ...] = ()  # Pixels ON of frames that were made for this list, as `packed`

    @model_validator(mode="after")
    def _whole(self) -> "ShownList":
        if not len(self.frames) == len(self.gate_ns) == len(self.markers) - 1:
            raise ValueError("frames, gates and markers differ in number")
        if min(self.gate_ns, default=1) < 0 or min(self.markers, default=1) < 1:
            raise ValueError("gates are 0 or more, and each frame gives a marker")
        return self

    def matches(self, asked: FrameList) -> bool:
        """True if these are the frames, and their gates."""
        return (
            self.look == asked.look
            and np.array_equal(self.frames, asked.frames)
            and np.array_equal(self.gate_ns, asked.gate_ns)
            and self.masks == packed(asked.masks)
        )


def packed(masks: np.ndarray | None) -> tuple[str, ...]:
    """Masks (F, N) of bool, or none, each as the base64 of its bits."""
    if masks is None:
        return ()
    return tuple(b64encode(bits.tobytes()).decode() for bits in np.packbits(masks, axis=1))


class ShownScene(StrictModel):
    """A scene as it was shown, and what was decided."""

    scene: int = Field(ge=DARK)  # From 0; -1 for the pass before, with the scenes dark
    first_marker: int = Field(ge=0)  # Markers before those of this scene
    lists: tuple[ShownList, ...]  # In their order
    chances: tuple[float, ...]  # Probabilities of the classes; none if there was no light
    faults: tuple[Fault, ...] = ()  # Of the scene
    light_s: float = Field(ge=0)  # Exposure used, seconds
    clock_s: float = Field(ge=0)  # From the scene's first command to its decision, seconds

    @property
    def looks(self) -> int:
        """Looks that were shown."""
        return sum(each.look >= 0 for each in self.lists)

    @property
    def first_markers(self) -> list[np.ndarray]:
        """Number of the marker that each frame begins with, list by list."""
        at, out = self.first_marker, []
        for each in self.lists:
            markers = np.array(each.markers, np.int64)
            out.append((at + np.cumsum(markers) - markers)[:-1])
            at += int(markers.sum())
        return out


def read_shown(folder: Path) -> tuple[ShownScene, ...]:
    """Finished scenes of a run, or `InputError` if there are none or they do not follow."""
    # A last line that is not whole is that of a run that was killed, and is left out
    path = folder / NAME
    content = read_regular(path, LARGEST_FILE, "give a run of `camera live`")
    lines = content.split(b"\n")[:-1]
    try:
        scenes = tuple(ShownScene.model_validate_json(line) for line in lines)
    except ValidationError:
        raise InputError(f"{path} is damaged: run `deepfsi camera live` again") from None
    if not scenes or scenes[-1].scene == DARK:
        raise InputError(f"{path} has no finished scene: run `deepfsi camera live` again")
    if [each.scene for each in scenes] != list(
        range(min(scenes[0].scene, 0), scenes[-1].scene + 1)
    ):
        raise InputError(f"{path} has scenes that do not follow each other: it was changed")
    return scenes
