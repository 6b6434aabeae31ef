"""Sequence of frames that a micromirror device shows: which mirrors, in what order, for how long.

A *frame* is one binary pattern. A mask is shown as one frame for each of its rails that is not
dark; on two arms one frame serves both rails. A frame is brought to its own peak: cell j has
`k` of its `K` mirrors ON, k/K of the peak, and the frame's light is counted during a *gate* of

    share · exposure,    share = the frame's peak in the sensing matrix,

within the longer *picture time* for which the device holds it. So every light constraint that one
device can realise is shown in the same way, at full contrast, and the realised matrix is
share · k / K. The shares sum to at most 1: the budget Φ of an exposure is the flux on the device
times the exposure, whatever time mirrors take to settle.

Each pass over the masks begins and ends with two *sentinel* frames, all mirrors of the cells ON and
all OFF.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from deepfsi.errors import InputError, check_known, closest
from deepfsi.hardware.patterns.detectors import Detectors
from deepfsi.hardware.patterns.looks import Looks

MOST_FRAMES = 2**20
"""Frames of one pass at most, sentinels among them."""

MOST_MIRRORS = 2**14
"""Mirrors of a device in each direction at most."""

LONGEST_PICTURE_S = 1e3
"""Longest picture time that is exported, seconds."""

SHARES_SLACK = 1e-4
"""Sum of the frames' shares of the exposure beyond 1 that rounding may leave."""

Light = Literal["column", "equal-dwell", "free-dwell", "two-arm"]
"""Light constraint of a design; `optics.constraints` has their laws."""

Role = Literal["mask", "on", "off"]
"""Content of a frame: a mask, or a sentinel of all mirrors ON or OFF."""

Rail = Literal["plus", "minus", "both"]
"""Rail of a mask that a frame shows; both on two arms."""

Readout = Literal["difference", "both"]
"""What the network of a design reads of two rails; `optics.detection` says more."""

Selection = Literal["ordered", "random"]
"""Choice of the mirrors of a grey cell."""

Format = Literal["npy", "raw", "png"]
"""Files of the frames."""


class Device(BaseModel):
    """A micromirror device.

    Attributes
    ----------
    columns, rows : int
        Mirrors across and down.
    shortest_us : int
        Shortest picture time, µs.
    settle_us : float
        Time after the start of a frame in which mirrors still move, µs.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    columns: int = Field(ge=1, le=MOST_MIRRORS)
    rows: int = Field(ge=1, le=MOST_MIRRORS)
    shortest_us: int = Field(44, ge=1)
    settle_us: float = Field(10.0, ge=0, allow_inf_nan=False)

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Rows, and bytes of a row at one bit a mirror: each row begins a new byte."""
        return self.rows, -(-self.columns // 8)

    @property
    def frame_bytes(self) -> int:
        """Bytes of a frame."""
        return math.prod(self.frame_shape)


DEVICES = {"dlp7000": Device(name="dlp7000", columns=1024, rows=768)}
"""Devices by name."""


def find_device(
    name: str, shortest_s: float | None = None, settle_s: float | None = None
) -> Device:
    """Device of a name, or one of COLUMNSxROWS mirrors.

    Parameters
    ----------
    name : str
        One of `DEVICES`, or such as "1920x1080".
    shortest_s, settle_s : float, optional
        Shortest picture time, whole microseconds, and time to settle, in seconds: the named
        device's, or those of any other, unless given.

    Raises
    ------
    InputError
        If there is no such device, or the times are not allowed.
    """
    device = DEVICES.get(name.lower()) or _device_of_size(name)
    if shortest_s is not None:
        shortest = round(shortest_s * 1e6, 6)
        if not (1 <= shortest <= LONGEST_PICTURE_S * 1e6 and shortest.is_integer()):
            raise InputError(
                f"`shortest` {shortest:g} µs is not allowed: give whole microseconds, 1 to "
                f"{LONGEST_PICTURE_S * 1e6:g}"
            )
        device = device.model_copy(update={"shortest_us": int(shortest)})
    if settle_s is not None:
        if not 0 <= settle_s <= LONGEST_PICTURE_S:
            raise InputError(
                f"`settle` {settle_s:g} s is not allowed: give 0 to {LONGEST_PICTURE_S:g}"
            )
        device = device.model_copy(update={"settle_us": round(settle_s * 1e6, 6)})
    return device


def _device_of_size(name: str) -> Device:
    sides = name.lower().split("x")
    if len(sides) == 2 and all(side.isascii() and side.isdecimal() for side in sides):
        columns, rows = map(int, sides)
        if 1 <= columns <= MOST_MIRRORS and 1 <= rows <= MOST_MIRRORS:
            return Device(name=f"{columns}x{rows}", columns=columns, rows=rows)
    raise InputError(
        f"unknown device {name!r}: {closest(name, DEVICES)}; or COLUMNSxROWS, such as 1920x1080"
    )


@dataclass(frozen=True)
class Grid:
    """Cells of a mask on a device: as large as fit, centred; mirrors beyond them are OFF.

    Attributes
    ----------
    down, across : int
        Cells.
    height, width : int
        Mirrors of a cell.
    top, left : int
        Mirrors before the first cell.
    """

    down: int
    across: int
    height: int
    width: int
    top: int
    left: int

    @property
    def mirrors(self) -> int:
        """K, mirrors of a cell."""
        return self.height * self.width

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the mirrors of all cells, to index those of a device."""
        return (
            slice(self.top, self.top + self.down * self.height),
            slice(self.left, self.left + self.across * self.width),
        )


def find_grid(device: Device, image_shape: tuple[int, ...]) -> Grid:
    """Grid of a mask's cells; a mask of one axis (a spectrum) lies across the device.

    Raises `InputError` if the device has fewer mirrors than the mask has cells.
    """
    if len(image_shape) not in (1, 2) or min(image_shape) < 1:
        raise InputError(f"masks of shape {image_shape} cannot be shown: give 1 or 2 axes of cells")
    down, across = image_shape if len(image_shape) == 2 else (1, *image_shape)
    height, width = device.rows // down, device.columns // across
    if not (height and width):
        raise InputError(
            f"{down} x {across} cells do not fit {device.name} with {device.rows} x "
            f"{device.columns} mirrors: use a larger device or fewer pixels"
        )
    top, left = (device.rows - down * height) // 2, (device.columns - across * width) // 2
    return Grid(down, across, height, width, top, left)


@dataclass(frozen=True)
class FrameSettings:
    """Settings of an export: the device, how long it holds frames, their mirrors and their files.

    Parameters
    ----------
    dwell_s : float
        Mean picture time of the masks' frames in seconds, at least the device's shortest.
    selection : {"ordered", "random"}
        Choice of the mirrors of a grey cell.
    seed : int
        Of the random selection.

    Raises
    ------
    InputError
        If one of them is not allowed.
    """

    device: Device
    dwell_s: float
    selection: Selection = "ordered"
    seed: int = 0
    format: Format = "npy"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.dwell_s) and 0 < self.dwell_s <= LONGEST_PICTURE_S):
            raise InputError(
                f"dwell {self.dwell_s!r} is not allowed: give seconds above 0, up to "
                f"{LONGEST_PICTURE_S:g}"
            )
        check_known("selection", self.selection, get_args(Selection))
        if self.seed < 0:
            raise InputError(f"seed {self.seed} is not allowed: give 0 or more")
        check_known("format", self.format, get_args(Format))

    @property
    def raised(self) -> bool:
        """True where the dwell is below the device's shortest picture time, which then holds."""
        return self.dwell_s * 1e6 < self.device.shortest_us * (1 - 1e-9)

    @property
    def sentinel_us(self) -> int:
        """Picture time of a sentinel, µs."""
        return max(self.device.shortest_us, _whole(self.dwell_s * 1e6))

    def picture_us(self, shares: np.ndarray, light: Light) -> list[int]:
        """Picture times of the masks' frames, µs, from their shares of the exposure (f,).

        Under `equal-dwell` all are the mean one. Otherwise what a picture lasts beyond the time to
        settle is in proportion to its share of the exposure. Times are rounded up to whole
        microseconds and to the device's shortest. Raises `InputError` if the dwell leaves no time
        after settling, or a picture would last too long.
        """
        device, mean = self.device, max(self.dwell_s * 1e6, self.device.shortest_us)
        rest = mean - device.settle_us
        if rest <= 0:
            raise InputError(
                f"a dwell of {mean * 1e-6:g} s leaves no time after {device.settle_us:g} µs to "
                "settle: give a longer one"
            )
        if light == "equal-dwell":
            return [_whole(mean)] * len(shares)
        wanted = device.settle_us + rest * len(shares) * shares / shares.sum()
        if wanted.max() > 1e6 * LONGEST_PICTURE_S:
            raise InputError(
                f"with a dwell of {self.dwell_s:g} s the longest picture takes "
                f"{wanted.max() / 1e6:.3g} s, and {LONGEST_PICTURE_S:g} are allowed: give a "
                "shorter one"
            )
        return [max(device.shortest_us, _whole(us)) for us in wanted.tolist()]


def _whole(us: float) -> int:
    """Number rounded up, but for what floating point adds."""
    return math.ceil(round(us, 6))


class Frame(BaseModel):
    """One pattern.

    Attributes
    ----------
    mask : int or None
        Row of the sensing matrix.
    rail : {"plus", "minus", "both"} or None
        "both" on two arms: the other arm sees the mirrors that are OFF.
    share : float
        Share of the exposure for which it is counted: its peak in the realised matrix. 0 for
        sentinels.
    picture_us : int
        Time for which the device holds it, µs.
    sha256 : str
        Of its packed bits.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    role: Role
    mask: int | None = Field(None, ge=0)
    rail: Rail | None = None
    share: float = Field(0.0, ge=0, le=1, allow_inf_nan=False)
    picture_us: int = Field(ge=1, le=10**10)
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")

    @model_validator(mode="after")
    def _whole(self) -> "Frame":
        if (self.role == "mask") != (self.mask is not None and self.rail is not None):
            raise ValueError("a mask's frame names its mask and rail, and a sentinel neither")
        if (self.role == "mask") != (self.share > 0):
            raise ValueError("a mask's frame has a share of the exposure, and a sentinel none")
        return self

    def __str__(self) -> str:
        if self.role != "mask":
            return f"all {self.role.upper()}"
        return f"mask {self.mask}" + ("" if self.rail == "both" else f", {self.rail}")


class Brightness(BaseModel):
    """Summed reflectance of the training scenes, as a share of its mean.

    Attributes
    ----------
    low, high : float
        Of the dimmest and the brightest scene.
    between : float
        Mean of the brightest class over that of the dimmest.
    within : float
        Largest standard deviation within a class, as a share of the class's mean.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    low: float = Field(ge=0, le=1, allow_inf_nan=False)
    high: float = Field(ge=1, allow_inf_nan=False)
    between: float = Field(ge=1)
    within: float = Field(ge=0, allow_inf_nan=False)


class Manifest(BaseModel):
    """A folder of patterns: device, frames in the order in which they are shown, provenance.

    Attributes
    ----------
    masks, rails : int
        m, and 2 for signed masks or 1: the shape of what is counted.
    dimmed : float
        Realised matrix over designed one. Below 1 where one device cannot realise the design
        (`column`): each exposure then gives this share of its counts.
    summed_reflectance : float
        s, the training scenes' mean summed reflectance.
    brightness : Brightness or None
        By how much scenes differ from it, where that is known.
    detectors : Detectors or None
        Which see which cells; None where one sees all that an arm sends.
    looks : Looks or None
        Where dwells are chosen while the exposure runs; the frames' shares are then equal ones.
    seed : int
        Of the random selection.
    mirrors_sha256 : str
        Of the numbers in mirrors.npy.
    sha256 : str or None
        Of all else in the manifest's file, so that a change of it is found; taken as it is
        without.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: Literal[1] = 1
    deepfsi: str
    device: Device
    image_shape: tuple[Annotated[int, Field(ge=1)], ...] = Field(min_length=1, max_length=2)
    masks: int = Field(ge=1, le=MOST_FRAMES)
    rails: Literal[1, 2]
    light: str
    dimmed: float = Field(gt=0, le=1)
    summed_reflectance: float = Field(gt=0, allow_inf_nan=False)
    brightness: Brightness | None = None
    detectors: Detectors | None = None
    readout: Readout = "difference"
    looks: Looks | None = None
    selection: Selection
    seed: int = 0
    format: Format
    design_sha256: str | None = None
    mirrors_sha256: str
    frames: tuple[Frame, ...] = Field(min_length=1, max_length=MOST_FRAMES)
    sha256: str | None = None

    @model_validator(mode="after")
    def _consistent(self) -> "Manifest":
        seen = [(frame.mask, frame.rail) for frame in self.frames if frame.role == "mask"]
        if len(set(seen)) < len(seen):
            raise ValueError("a rail of a mask is shown twice")
        if any(mask is not None and mask >= self.masks for mask, _ in seen):
            raise ValueError("a frame shows a mask that does not exist")
        if {rail for _, rail in seen} - ({"plus"} if self.rails == 1 else set(get_args(Rail))):
            raise ValueError("a frame shows a rail that does not exist")
        if sum(frame.share for frame in self.frames) > 1 + SHARES_SLACK:
            raise ValueError("the frames' shares of the exposure sum to more than 1")
        check_known("light constraint", self.light, get_args(Light))
        if self.two_arm != (self.light == "two-arm") or not seen:
            raise ValueError(f"the rails are not those of {self.light}")
        if self.looks and self.looks.dwells(self.masks) != len(self.looks.first):
            raise ValueError("the first look has a dwell for other frames than the masks'")
        cells = self.detectors and self.detectors.cells
        if cells and len(cells) != math.prod(self.image_shape):
            raise ValueError(f"{len(cells)} cells have a detector, and the masks have others")
        find_grid(self.device, self.image_shape)  # the device must hold the cells
        return self

    @cached_property
    def grid(self) -> Grid:
        """Cells of the masks."""
        return find_grid(self.device, self.image_shape)

    @cached_property
    def shown(self) -> np.ndarray:
        """Places of the masks' frames among all, shape (f,)."""
        return np.flatnonzero([frame.role == "mask" for frame in self.frames])

    @cached_property
    def shares(self) -> np.ndarray:
        """Share of the exposure of each mask's frame, shape (f,)."""
        return np.array([self.frames[place].share for place in self.shown])

    @cached_property
    def picture_s(self) -> np.ndarray:
        """Picture times of all frames in seconds, shape (F,)."""
        return np.array([frame.picture_us for frame in self.frames]) * 1e-6

    @cached_property
    def starts_s(self) -> np.ndarray:
        """Start of each frame after that of its pass, seconds, shape (F,)."""
        return np.concatenate([[0.0], np.cumsum(self.picture_s)[:-1]])

    @property
    def pass_s(self) -> float:
        """Duration of one pass over all frames, seconds."""
        return float(self.picture_s.sum())

    @property
    def two_arm(self) -> bool:
        """True where a second detector sees the mirrors that are OFF."""
        return any(frame.rail == "both" for frame in self.frames)

    @property
    def detector_count(self) -> int:
        """D, detectors of an arm."""
        return self.detectors.count if self.detectors else 1

    @property
    def inputs(self) -> int:
        """Inputs of a counter that are needed, one for each detector of each arm."""
        return (2 if self.two_arm else 1) * self.detector_count

    @property
    def several(self) -> tuple[int, ...]:
        """Shape of what several detectors count of a readout: (D,), or () of one detector."""
        return (self.detectors.count,) if self.detectors else ()

    @property
    def readouts(self) -> int:
        """Numbers that an exposure counts at most, dark rails among them."""
        return self.detector_count * max(len(self.shown), self.rails * self.masks)


@dataclass(frozen=True)
class Patterns:
    """Manifest and mirror counts of a folder of patterns.

    Attributes
    ----------
    on : array, shape (f, N)
        Mirrors ON in each cell of each mask's frame, in the order of `Manifest.shown`.
    """

    manifest: Manifest
    on: np.ndarray

    @property
    def fractions(self) -> np.ndarray:
        """Share of each cell's mirrors that are ON, k / K, float64 (f, N)."""
        return self.on / self.manifest.grid.mirrors

    @property
    def rails(self) -> np.ndarray:
        """Realised rails, float64 (rails, m, N): share of each pixel's photons."""
        manifest = self.manifest
        out = np.zeros((manifest.rails, manifest.masks, self.on.shape[1]))
        for place, share, part in zip(manifest.shown, manifest.shares, self.fractions, strict=True):
            frame = manifest.frames[place]
            if frame.rail in ("plus", "both"):
                out[0, frame.mask] = share * part
            if frame.rail in ("minus", "both"):
                out[1, frame.mask] = share * (1 - part if frame.rail == "both" else part)
        return out

    @property
    def realised(self) -> tuple[np.ndarray, tuple[int, ...], float]:
        """Rails, image shape and dimming, as `Design.as_shown` takes them."""
        return self.rails, self.manifest.image_shape, self.manifest.dimmed
