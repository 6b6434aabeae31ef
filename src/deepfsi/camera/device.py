"""Micromirror devices: geometry, and limits of their controllers.

`devices.toml` beside this file holds the devices that have a name.
"""

import math
import re
import tomllib
from importlib.resources import files
from typing import Literal, Self

from pydantic import Field, model_validator

from deepfsi.base.errors import InputError, closest_choice
from deepfsi.base.models import Count, Positive, UserModel

LONGEST_PICTURE_US = 10**9
"""Longest picture time of an export, microseconds."""

BIT_PLANES = 24
"""Bit-planes of a picture of 24 bits a pixel."""

Lattice = Literal["square", "diamond"]
"""Places of mirrors: rows and columns, or turned by 45°, with odd rows half a mirror aside."""

Controller = Literal["any", "alp", "dlpc900", "dlpc350", "dlpc347x"]
"""Controller of a device: what it takes, and how; "any" takes packed frames."""


class Device(UserModel):
    """A micromirror device and its controller."""

    name: str  # by which messages and results name it
    columns: int = Field(ge=1, le=2**14)  # mirrors across, as they are addressed
    rows: int = Field(ge=1, le=2**14)  # mirrors down
    # Shortest picture time, µs
    shortest_us: int = Field(default=44, ge=1, le=LONGEST_PICTURE_US)
    # Longest picture time, µs
    longest_us: int = Field(default=LONGEST_PICTURE_US, ge=1, le=LONGEST_PICTURE_US)
    # Picture times are multiples of it, µs: the refresh of a projector that is a second screen
    step_us: int = Field(default=1, ge=1, le=10**6, exclude_if=lambda step: step == 1)
    # Time after the start of a frame in which mirrors still move, µs
    settle_us: float = Field(default=10.0, ge=0, allow_inf_nan=False)
    # Frames that the controller holds for one sequence; None where as many fit as its memory allows
    patterns: Count | None = None
    # Shortest video frame, µs, of a controller that takes frames as a video's bit-planes and shows
    # all for one time; None of one that stores frames
    video_us: int | None = Field(default=None, ge=1, le=LONGEST_PICTURE_US)
    # Time to bring another frame into the device while a run goes on, µs; None of a controller that
    # cannot
    load_us: int | None = Field(default=None, ge=1, le=LONGEST_PICTURE_US)
    lattice: Lattice = "square"  # places of the mirrors
    pitch_um: Positive | None = None  # side of a mirror with its gap, µm
    # It decides which frame files the device takes; "any" takes packed frames
    controller: Controller = "any"
    # Colours of a 24-bit picture in the order of bit positions, eight of each, lowest bit first
    planes: Literal["BGR", "BRG", "GBR", "GRB", "RBG", "RGB"] = "BGR"

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.shortest_us > self.longest_us:
            raise ValueError("shortest_us is above longest_us")
        if self.columns * self.rows > 2**25:
            raise ValueError("columns and rows make more than 33 million mirrors")
        return self

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Rows, and bytes of a row at one bit a mirror: each row begins a new byte."""
        return self.rows, -(-self.columns // 8)

    @property
    def packed(self) -> bool:
        """True if the controller takes 24 frames as the bit-planes of a picture."""
        return self.controller in ("dlpc900", "dlpc350", "dlpc347x")

    def whole_us(self, least_us: float) -> int:
        """Shortest picture time of the device, µs, of at least `least_us`."""
        # Rounded to 1e-6 µs first: a rounding error must not cost a step
        steps = math.ceil(round(max(least_us, self.shortest_us), 6) / self.step_us)
        return steps * self.step_us

    def packed_frames(self, total: int) -> int:
        """Frames in each 24-bit picture of a sequence."""
        if self.video_us is None:
            return BIT_PLANES
        # all pictures have as many, so that no bit-plane without a frame is shown
        return max(size for size in range(1, BIT_PLANES + 1) if total % size == 0)


_CONTENT = tomllib.loads(files(__package__).joinpath("devices.toml").read_text("utf-8"))

DEVICES = {name: Device(name=name, **fields) for name, fields in _CONTENT.items()}
"""Devices by name."""


def find_device(name: str) -> Device:
    """Device of a name, or one of COLUMNSxROWS mirrors."""
    if name.lower() in DEVICES:
        return DEVICES[name.lower()]
    sides = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", name.lower())
    if sides is None:
        raise InputError(
            f"unknown device {name!r}: {closest_choice(name, DEVICES)}; or COLUMNSxROWS, such as "
            "1920x1080, or a TOML file"
        )
    columns, rows = map(int, sides.groups())
    return Device(name=name.lower(), columns=columns, rows=rows)
