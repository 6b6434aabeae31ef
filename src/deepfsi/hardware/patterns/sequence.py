"""Sequence of frames that a micromirror device shows: which mirrors, in what order, for how long.

A *frame* is one binary pattern. A mask is shown as one frame for each of its rails that is not
dark; on two arms one frame serves both rails. A frame is brought to its own peak: cell j has
`k` of its `K` mirrors ON, k/K of the peak, and the frame's light is counted during a *gate* of

    share · exposure,    share = the frame's peak in the sensing matrix,

within the longer *picture time* for which the device holds it. So every light law that one
device can realise is shown in the same way, at full contrast, and the realised matrix is
share · k / K. The shares sum to at most 1: the budget Φ of an exposure is the flux on the device
times the exposure, whatever time mirrors take to settle.

Each pass over the masks begins and ends with two *sentinel* frames, all mirrors of the cells ON and
all OFF.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import Field, model_validator

from deepfsi.base import InputError, check_choice, time_text
from deepfsi.base.models import StrictModel
from deepfsi.camera import (
    LIGHT_LAWS,
    LONGEST_PICTURE_S,
    USUAL_LAYOUT,
    Device,
    DmdGrid,
    DmdLayout,
    LightLawName,
    Readout,
    SeveralDetectors,
    SummedReflectance,
    find_grid,
)
from deepfsi.hardware.patterns.looks import Looks

MOST_FRAMES = 2**20
"""Frames of one pass at most, sentinels among them."""

SHARES_SLACK = 1e-4
"""Sum of the frames' shares of the exposure beyond 1 that rounding may leave."""

Role = Literal["mask", "on", "off"]
"""Content of a frame: a mask, or a sentinel of all mirrors ON or OFF."""

Rail = Literal["plus", "minus", "both"]
"""Rail of a mask that a frame shows; both on two arms."""

_READ_BY: dict[Rail | None, tuple[tuple[int, int], ...]] = {
    "plus": ((0, 0),),
    "minus": ((1, 0),),
    "both": ((0, 0), (1, 1)),
}
"""Rails for which a frame is read, and the arm that sees them."""

Selection = Literal["ordered", "random"]
"""Choice of the mirrors of a grey cell."""

Format = Literal["npy", "raw", "png", "bmp", "planes"]
"""Files of the frames."""


@dataclass(frozen=True)
class FrameSettings:
    """Settings of an export: device, mean picture time, choice of mirrors, files and layout."""

    device: Device
    dwell_s: float
    selection: Selection = "ordered"
    seed: int = 0
    format: Format = "npy"
    layout: DmdLayout = USUAL_LAYOUT

    def __post_init__(self) -> None:
        if not (math.isfinite(self.dwell_s) and 0 < self.dwell_s <= LONGEST_PICTURE_S):
            raise InputError(
                f"dwell {self.dwell_s!r} is not allowed: give seconds above 0, up to "
                f"{LONGEST_PICTURE_S:g}"
            )
        check_choice("selection", self.selection, get_args(Selection))
        if self.seed < 0:
            raise InputError(f"seed {self.seed} is not allowed: give 0 or more")
        check_choice("format", self.format, get_args(Format))
        if self.format == "planes" and not self.device.packed:
            raise InputError(
                f"{self.device.name} takes no pictures of 24 bit-planes: use format "
                "npy, raw, png or bmp"
            )

    @property
    def raised(self) -> bool:
        """True where the dwell is below the device's shortest picture time, which then holds."""
        return self.dwell_s * 1e6 < self.device.shortest_us * (1 - 1e-9)

    @property
    def sentinel_us(self) -> int:
        """Picture time of a sentinel, µs."""
        return max(self.device.shortest_us, _whole(self.dwell_s * 1e6))

    def times_us(
        self, shares: np.ndarray, light: LightLawName, sentinels: int
    ) -> tuple[list[int], int]:
        """Picture times of the masks' frames and of a sentinel, µs: one for all in a video."""
        pictures, sentinel = self.picture_us(shares, light), self.sentinel_us
        if self.device.video_us:
            total = len(shares) + sentinels
            together = self.device.packed_frames(total)
            one = max(*pictures, sentinel, -(-self.device.video_us // together))
            if one > self.device.longest_us:
                raise InputError(
                    f"{total} frames, {together} in each picture of the video, would last {one} µs "
                    f"each, and {self.device.name} shows {self.device.longest_us} at most: give a "
                    f"shorter --exposure, or masks that make with {sentinels} sentinels a multiple "
                    "of more frames"
                )
            return [one] * len(pictures), one
        return pictures, sentinel

    def picture_us(self, shares: np.ndarray, light: LightLawName) -> list[int]:
        """Picture times of the masks' frames, µs, from their shares of the exposure (f,)."""
        # Under `equal-dwell` all are the mean one. Otherwise what a picture lasts beyond the time
        # to settle is in proportion to its share of the exposure. Times are rounded up to whole
        # microseconds and to the device's shortest
        device, mean = self.device, max(self.dwell_s * 1e6, self.device.shortest_us)
        rest = mean - device.settle_us
        if rest <= 0:
            raise InputError(
                f"pictures of {mean:g} µs leave no time after the {device.settle_us:g} µs in which "
                "mirrors "
                "settle: give a longer --exposure"
            )
        if LIGHT_LAWS[light].equal_times:
            return [_whole(mean)] * len(shares)
        wanted = device.settle_us + rest * len(shares) * shares / shares.sum()
        if wanted.max() > device.longest_us:
            raise InputError(
                f"with pictures of {time_text(self.dwell_s)} in the mean the longest picture takes "
                f"{time_text(wanted.max() / 1e6)}, and {device.name} allows "
                f"{time_text(device.longest_us / 1e6)}: give a shorter --exposure"
            )
        return [max(device.shortest_us, _whole(us)) for us in wanted.tolist()]


def _whole(us: float) -> int:
    """Number rounded up, but for what floating point adds."""
    return math.ceil(round(us, 6))


class Frame(StrictModel):
    """One pattern."""

    role: Role  # A mask, or a sentinel with all mirrors ON or OFF
    mask: int | None = Field(None, ge=0)  # Row of the sensing matrix
    rail: Rail | None = None  # "both" on two arms: the other arm sees the mirrors that are OFF
    # Share of the exposure for which it is counted: its peak in the realised matrix. 0 for
    # sentinels
    share: float = Field(0.0, ge=0, le=1, allow_inf_nan=False)
    picture_us: int = Field(ge=1, le=10**10)  # Time for which the device holds it, µs
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")  # Of its packed bits

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


class Brightness(StrictModel):
    """Summed reflectance of the training scenes, as a share of its mean."""

    low: float = Field(ge=0, le=1, allow_inf_nan=False)  # Of the dimmest scene
    high: float = Field(ge=1, allow_inf_nan=False)  # Of the brightest scene
    between: float = Field(ge=1)  # Mean of the brightest class over that of the dimmest
    # Largest standard deviation within a class, as a share of the class's mean
    within: float = Field(ge=0, allow_inf_nan=False)

    @classmethod
    def of(cls, info: dict[str, Any]) -> "Brightness | None":
        """Brightness that the provenance of a design has, or none."""
        known = info.get("brightness")
        return None if known is None else cls.model_validate(known)


class Manifest(StrictModel):
    """A folder of patterns: device, frames in the order in which they are shown, provenance."""

    schema_version: Literal[1] = 1
    deepfsi: str  # Version of the package that wrote it
    device: Device  # That shows the frames
    # Rows and columns of the masks, or values of a spectrum
    image_shape: tuple[Annotated[int, Field(ge=1)], ...] = Field(min_length=1, max_length=2)
    masks: int = Field(ge=1, le=MOST_FRAMES)  # number of masks, m
    rails: Literal[1, 2]  # 2 for signed masks, or 1
    light: str  # Light law of the design
    # Realised matrix over designed one. Below 1 where one device cannot realise the design
    # (`column`): each exposure then gives this share of its counts
    dimmed: float = Field(gt=0, le=1)
    # s, the training scenes' mean summed reflectance
    summed_reflectance: SummedReflectance
    brightness: Brightness | None = None  # By how much scenes differ from it, where that is known
    # Which see which cells; None where one sees all that an arm sends
    detectors: SeveralDetectors | None = None
    readout: Readout = "difference"  # What the network reads of two rails
    # Where dwells are chosen while the exposure runs; the frames' shares are then equal ones
    looks: Looks | None = None
    selection: Selection  # Choice of the mirrors of a grey cell
    seed: int = 0  # Of the random selection
    # How the cells lie on the device; of folders that do not say so they fill it
    layout: DmdLayout = DmdLayout(stretch=True)
    format: Format  # Files of the frames
    design_sha256: str | None = None  # Of the design file beside it
    mirrors_sha256: str  # Of the numbers in mirrors.npy
    # In the order in which they are shown
    frames: tuple[Frame, ...] = Field(min_length=1, max_length=MOST_FRAMES)
    # Of all else in the manifest's file, so that a change of it is found; taken as it is without
    sha256: str | None = None

    @model_validator(mode="after")
    def _consistent(self) -> "Manifest":
        rails = [(frame.mask, frame.rail) for frame in self.frames if frame.role == "mask"]
        if len(set(rails)) < len(rails):
            raise ValueError("a rail of a mask is shown twice")
        if any(mask is not None and mask >= self.masks for mask, _ in rails):
            raise ValueError("a frame shows a mask that does not exist")
        if {rail for _, rail in rails} - ({"plus"} if self.rails == 1 else set(get_args(Rail))):
            raise ValueError("a frame shows a rail that does not exist")
        if sum(frame.share for frame in self.frames) > 1 + SHARES_SLACK:
            raise ValueError("the frames' shares of the exposure sum to more than 1")
        check_choice("light law", self.light, LIGHT_LAWS)
        if self.two_arm != (LIGHT_LAWS[self.light].arms == 2) or not rails:
            raise ValueError(f"the rails are not those of {self.light}")
        if self.looks and self.looks.dwells(self.masks) != len(self.looks.first):
            raise ValueError("the first look has a dwell for other frames than the masks'")
        if len(self.frames) * self.detector_count > MOST_FRAMES:
            raise ValueError(
                f"{len(self.frames)} frames of {self.detector_count} detectors are given, and at "
                f"most {MOST_FRAMES} together are allowed"
            )
        cells = self.detectors and self.detectors.cells
        if cells and len(cells) != math.prod(self.image_shape):
            raise ValueError(f"{len(cells)} cells have a detector, and the masks have others")
        find_grid(self.device, self.image_shape, self.layout)  # the device must hold the cells
        return self

    @cached_property
    def grid(self) -> DmdGrid:
        """Cells of the masks."""
        return find_grid(self.device, self.image_shape, self.layout)

    @property
    def used(self) -> float:
        """Share of the device's mirrors that are of a cell, and of its light where that is even."""
        grid, device = self.grid, self.device
        return grid.down * grid.across * grid.mirrors / (device.columns * device.rows)

    @cached_property
    def shown(self) -> np.ndarray:
        """Places of the masks' frames among all, shape (f,)."""
        return np.flatnonzero([frame.role == "mask" for frame in self.frames])

    @cached_property
    def read(self) -> np.ndarray:
        """Rail, mask, place among the masks' frames, and arm of each readout, shape (4, r)."""
        shown = enumerate(self.frames[place] for place in self.shown)
        return np.array(
            [
                (rail, frame.mask, column, arm)
                for column, frame in shown
                for rail, arm in _READ_BY[frame.rail]
            ]
        ).T

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

    def by_readout(self, frames: np.ndarray) -> np.ndarray:
        """Numbers of readouts (..., rails, m[, D]) from those of masks' frames (..., f, inputs)."""
        # 0 for a rail that is dark
        split = frames.reshape(*frames.shape[:-1], -1, self.detector_count)
        shape = (*frames.shape[:-2], self.rails, self.masks, self.detector_count)
        out = np.zeros(shape, frames.dtype)
        rail, mask, column, arm = self.read
        out[..., rail, mask, :] = split[..., column, arm, :]
        return out.reshape(*out.shape[:-1], *self.several)

    def lengths_by_readout(self, lengths_s: np.ndarray) -> np.ndarray:
        """For how long each readout is counted (rails, m), from the gates of masks' frames (f,)."""
        out = np.zeros((self.rails, self.masks))
        rail, mask, column, _ = self.read
        out[rail, mask] = lengths_s[column]
        return out

    def by_rail(self, inputs: np.ndarray) -> np.ndarray:
        """Numbers (..., rails[, D]) of the inputs that read each rail, from those of all inputs."""
        # One arm reads both rails, of two each its own
        split = inputs.reshape(*inputs.shape[:-1], -1, self.detector_count)
        wide: Any = (*inputs.shape[:-1], self.rails, self.detector_count)
        return np.broadcast_to(split, wide).reshape(*wide[:-1], *self.several)

    def dark_inputs(self, on: np.ndarray, off: np.ndarray) -> np.ndarray:
        """Values (inputs,) of frames in which inputs see no mirror: all OFF, or ON of arm two."""
        return np.append(off[: self.detector_count], on[self.detector_count :])


@dataclass(frozen=True)
class Patterns:
    """Manifest and mirror counts of a folder of patterns."""

    manifest: Manifest
    # (f, N): Mirrors ON in each cell of each mask's frame, in the order of `Manifest.shown`
    on: np.ndarray

    @property
    def fractions(self) -> np.ndarray:
        """Share of each cell's mirrors that are ON, k / K, float64 (f, N)."""
        return self.on / self.manifest.grid.mirrors

    @property
    def rails(self) -> np.ndarray:
        """Realised rails, float64 (rails, m, N): share of each pixel's photons."""
        manifest, lit = self.manifest, np.stack([self.fractions, 1 - self.fractions])
        rail, mask, column, arm = manifest.read
        out = np.zeros((manifest.rails, manifest.masks, self.on.shape[1]))
        out[rail, mask] = manifest.shares[column, None] * lit[arm, column]
        return out

    @property
    def realised(self) -> tuple[np.ndarray, tuple[int, ...], float]:
        """Rails, image shape and dimming, as `Design.as_shown` takes them."""
        return self.rails, self.manifest.image_shape, self.manifest.dimmed
