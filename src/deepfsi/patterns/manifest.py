"""Sequence of frames that a micromirror device shows: which mirrors, in what order, for how long.

A *frame* is one binary pattern. A mask is shown as one frame for each of its rails that is not
dark; on two arms one frame serves both rails. A frame is brought to its own peak: cell j has
`k` of its `K` mirrors ON, k/K of the peak, and the frame's light is counted during a *gate* of

    share · exposure,    share = the frame's peak in the sensing matrix,

within the longer *picture time* for which the device holds it. So one device shows all its light
laws in the same way, at full contrast, and the realised matrix is share · k / K. The shares sum to
at most 1: the budget Φ of an exposure is the flux on the device times the exposure, and does not
depend on the time in which mirrors settle.

Each pass over the masks begins and ends with two *sentinel* frames, all mirrors of the cells ON and
all OFF.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Self, get_args

import numpy as np
from pydantic import Field, model_validator

from deepfsi.base.errors import InputError, check_choice
from deepfsi.base.models import Amount, Count, Share, StrictModel
from deepfsi.base.quantities import time_text
from deepfsi.camera.detectors import DetectorMap
from deepfsi.camera.device import Device
from deepfsi.camera.layout import DmdGrid, DmdLayout, find_grid
from deepfsi.camera.names import LIGHT_LAWS, Readout, SummedReflectance
from deepfsi.patterns.frames import Format

MOST_FRAMES = 2**20
"""Largest number of frames of one pass, sentinels among them."""

SENTINELS = 4
"""Frames of a pass that show no mask."""

Role = Literal["mask", "on", "off"]
"""Content of a frame: a mask, or a sentinel of all mirrors ON or OFF."""

Rail = Literal["plus", "minus", "both"]
"""Rail of a mask that a frame shows; both on two arms."""

_READ_BY: dict[Rail | None, tuple[tuple[int, int], ...]] = {
    "plus": ((0, 0),),
    "minus": ((1, 0),),
    "both": ((0, 0), (1, 1)),
}
"""Rails that a frame tells, each with the arm that sees it."""


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
    def _consistent(self) -> Self:
        of_mask = self.mask is not None, self.rail is not None, self.share > 0
        if of_mask != (self.role == "mask",) * 3:
            raise ValueError("a mask's frame has mask, rail and share, and a sentinel none of them")
        return self

    def __str__(self) -> str:
        if self.role != "mask":
            return f"all {self.role.upper()}"
        return f"mask {self.mask}" + ("" if self.rail == "both" else f", {self.rail}")


class Brightness(StrictModel):
    """Summed reflectance of the training scenes, as a share of its mean."""

    low: Share  # Of the dimmest scene
    high: float = Field(ge=1, allow_inf_nan=False)  # Of the brightest scene
    between: float = Field(ge=1)  # Mean of the brightest class over that of the dimmest
    # Largest standard deviation within a class, as a share of the class's mean
    within: Amount

    @classmethod
    def of(cls, info: dict[str, Any]) -> "Brightness | None":
        """Brightness that the provenance of a design has, or none."""
        stored = info.get("brightness")
        return None if stored is None else cls.model_validate(stored)


class LookPlan(StrictModel):
    """Looks at one mask each, which the design beside it makes or chooses.

    It is loaded before its look, or is one of a dictionary that stays on the device.
    """

    count: int = Field(ge=1, le=1024)  # K
    each_rail: Literal[False] = False  # Of earlier versions
    # Dwell of the mask of the first look, a share of the exposure; of a dictionary that of each
    first: tuple[Share, ...]
    shortest: float = Field(0.0, ge=0, le=0)  # Of earlier versions
    loop_sha256: None = None  # Of earlier versions
    # True if the frames of masks are all that looks may show: one each, by its index
    dictionary: bool = Field(False, exclude_if=lambda chosen: not chosen)


class Manifest(StrictModel):
    """A folder of patterns: device, frames in the order in which they are shown, provenance."""

    schema_version: Literal[1] = 1
    deepfsi: str  # Version of the package that wrote it
    device: Device  # That shows the frames
    # Rows and columns of the masks, or values of a spectrum
    image_shape: tuple[Count, ...] = Field(min_length=1, max_length=2)
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
    detectors: DetectorMap | None = None
    readout: Readout = "difference"  # What the network reads of two rails
    # Where masks are chosen while the exposure runs; the frames' shares are then equal ones
    looks: LookPlan | None = None
    # Choice of the mirrors of a grey cell; earlier versions also drew them at random
    selection: Literal["ordered", "random"] = "ordered"
    seed: int = 0  # Of earlier versions
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
    def _consistent(self) -> Self:
        rails = [(frame.mask, frame.rail) for frame in self.frames if frame.role == "mask"]
        names = ("plus",) if self.rails == 1 else get_args(Rail)
        known = {(mask, rail) for mask, rail in rails if rail in names and (mask or 0) < self.masks}
        check_choice("light law", self.light, LIGHT_LAWS)
        two_arm = LIGHT_LAWS[self.light].arms == 2
        looks = self.looks
        frames = len(rails) if looks and looks.dictionary else self.masks
        cells = self.detectors and self.detectors.cells
        faults = {
            "frames show a rail twice, or one that the masks lack": len(known) < len(rails),
            # 1e-4 more is what rounding may leave
            "shares of the exposure sum to more than 1": sum(self.shares) > 1 + 1e-4,
            f"the rails are not those of {self.light}": self.two_arm != two_arm or not rails,
            "the looks are at other frames than the masks'": (
                looks and not frames == self.masks == len(looks.first)
            ),
            f"more than {MOST_FRAMES} frames and detectors together are given": (
                len(self.frames) * self.detector_count > MOST_FRAMES
            ),
            "other cells have a detector than the masks have": (
                cells and len(cells) != math.prod(self.image_shape)
            ),
        }
        for fault, present in faults.items():
            if present:
                raise ValueError(fault)
        find_grid(self.device, self.image_shape, self.layout)  # the device must hold the cells
        return self

    @cached_property
    def grid(self) -> DmdGrid:
        """Cells of the masks."""
        return find_grid(self.device, self.image_shape, self.layout)

    @cached_property
    def mask_frames(self) -> np.ndarray:
        """Indices of the masks' frames among all, shape (f,)."""
        return np.flatnonzero([frame.role == "mask" for frame in self.frames])

    @cached_property
    def readout_table(self) -> np.ndarray:
        """Rail, mask, index among the masks' frames, and arm of each readout, shape (4, r)."""
        frames = enumerate(self.frames[index] for index in self.mask_frames)
        return np.array(
            [
                (rail, frame.mask, column, arm)
                for column, frame in frames
                for rail, arm in _READ_BY[frame.rail]
            ]
        ).T

    @cached_property
    def shares(self) -> np.ndarray:
        """Share of the exposure of each mask's frame, shape (f,)."""
        return np.array([self.frames[index].share for index in self.mask_frames])

    @cached_property
    def picture_s(self) -> np.ndarray:
        """Picture times of the frames in seconds, shape (F,)."""
        return np.array([frame.picture_us for frame in self.frames]) * 1e-6

    @property
    def pass_s(self) -> float:
        """Duration of a pass over the frames, seconds."""
        return float(self.picture_s.sum())

    @property
    def two_arm(self) -> bool:
        """True if a second detector sees the mirrors that are OFF."""
        return any(frame.rail == "both" for frame in self.frames)

    @property
    def detector_count(self) -> int:
        """D, detectors of an arm."""
        return self.detectors.count if self.detectors else 1

    @property
    def arms(self) -> int:
        """Arms of the device that have detectors."""
        return 2 if self.two_arm else 1

    @property
    def inputs(self) -> int:
        """Number of counter inputs: one for each detector of each arm."""
        return self.arms * self.detector_count

    @property
    def on_inputs(self) -> slice:
        """Inputs of the detectors that see mirrors ON."""
        return slice(self.detector_count)

    @property
    def detector_axis(self) -> tuple[int, ...]:
        """Shape of the detectors' axis of counts: (D,), or () for one detector."""
        return (self.detectors.count,) if self.detectors else ()

    @property
    def readouts(self) -> int:
        """Numbers that an exposure counts, dark rails among them."""
        return self.detector_count * max(len(self.mask_frames), self.rails * self.masks)

    def by_readout(self, frames: np.ndarray) -> np.ndarray:
        """Numbers of readouts (..., rails, m[, D]), from masks' frames (..., f, inputs).

        Dark rails have 0.
        """
        split = frames.reshape(*frames.shape[:-1], -1, self.detector_count)
        shape = (*frames.shape[:-2], self.rails, self.masks, self.detector_count)
        out = np.zeros(shape, frames.dtype)
        rail, mask, column, arm = self.readout_table
        out[..., rail, mask, :] = split[..., column, arm, :]
        return out.reshape(*out.shape[:-1], *self.detector_axis)

    def lengths_by_readout(self, lengths_s: np.ndarray) -> np.ndarray:
        """Length (rails, m) of the gate of each readout, from those of masks' frames (f,)."""
        out = np.zeros((self.rails, self.masks))
        rail, mask, column, _ = self.readout_table
        out[rail, mask] = lengths_s[column]
        return out

    def by_rail(self, inputs: np.ndarray) -> np.ndarray:
        """Numbers (..., rails[, D]) of each rail, from numbers (..., inputs) of inputs."""
        # One arm reads both rails, of two each its own
        split = inputs.reshape(*inputs.shape[:-1], -1, self.detector_count)
        wide: Any = (*inputs.shape[:-1], self.rails, self.detector_count)
        return np.broadcast_to(split, wide).reshape(*wide[:-1], *self.detector_axis)

    @property
    def usual_tolerance_s(self) -> float:
        """Time by which a frame's marker may be off: 10 µs, or a tenth of the shortest frame."""
        return min(0.1 * float(self.picture_s.min()), 1e-5)

    def longest_exposure_s(self, settle_s: float) -> float:
        """Longest exposure, seconds, whose gates fit all frames after the time to settle."""
        room = (self.picture_s[self.mask_frames] - settle_s) / self.shares
        return float(room.min())

    def check_limits(self) -> None:
        """Raise `InputError` unless the device can show all frames."""
        device = self.device
        if device.patterns is not None and len(self.frames) > device.patterns:
            raise InputError(
                f"{len(self.frames)} frames do not fit {device.name}, whose controller holds "
                f"{device.patterns}: use fewer masks (of a scan: a smaller --size; of adaptive "
                "masks: a smaller `dictionary`), or a device that holds more"
            )
        in_order = device.video_us is not None  # a video shows its frames in their order
        loads = self.looks and not self.looks.dictionary
        if (self.looks and in_order) or (loads and device.load_us is None):
            raise InputError(
                f"adaptive masks are shown as the counts ask for them, and {device.name} takes no "
                "frame then: use a device that does, such as dlp7000, or a device file with its "
                "`load_us`"
            )
        for index, frame in enumerate(self.frames):
            if not device.shortest_us <= frame.picture_us <= device.longest_us:
                raise InputError(
                    f"frame {index} ({frame}) lasts {frame.picture_us} µs, and {device.name} shows "
                    f"{device.shortest_us} to {device.longest_us} µs: export again with another "
                    "--exposure"
                )
        times = {frame.picture_us for frame in self.frames}
        if device.video_us and len(times) > 1:
            raise InputError(
                f"frames last {min(times)} to {max(times)} µs, and {device.name} shows all for one "
                "time: export the patterns for it again"
            )


@dataclass(frozen=True)
class GatePlan:
    """Gates of a pass, in seconds after each frame's start."""

    exposure_s: float  # of all masks together
    settle_s: float  # time before the first gate of each frame
    length_s: np.ndarray  # duration of a gate of each mask's frame, (f,): share times exposure
    repeats: int  # R, gates that follow each other in every mask's frame

    @classmethod
    def of(
        cls,
        manifest: Manifest,
        exposure_s: float,
        settle_s: float | None = None,
        repeats: int | None = None,
    ) -> Self:
        """Gates of an exposure."""
        settle = manifest.device.settle_us * 1e-6 if settle_s is None else settle_s
        if not (exposure_s > 0 and settle >= 0):
            raise InputError(
                f"an exposure of {exposure_s!r} s with {settle!r} s to settle is not allowed: give "
                "more than 0, and 0 or more to settle"
            )
        longest = manifest.longest_exposure_s(settle)
        # rounding of the ratio must not cost a repeat
        fit = int(np.floor(longest / exposure_s * (1 + 1e-9)))
        if fit < 1:
            raise InputError(
                f"an exposure of {time_text(exposure_s)} does not fit these frames, whose mirrors "
                f"take {time_text(settle)} to settle: give at most {time_text(max(longest, 0))}, "
                "or export with a longer --exposure"
            )
        if repeats is not None and not 1 <= repeats <= fit:
            raise InputError(f"{repeats} repeats do not fit: give 1 to {fit}")
        return cls(exposure_s, settle, manifest.shares * exposure_s, repeats or fit)

    @property
    def starts_s(self) -> np.ndarray:
        """Starts of the gates, shape (f, R)."""
        return self.settle_s + self.length_s[:, None] * np.arange(self.repeats)
