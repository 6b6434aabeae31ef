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

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from typing import Any, Literal, Self, get_args

import numpy as np
from pydantic import Field, model_validator

from deepfsi.base.errors import InputError, as_input_error, check_choice
from deepfsi.base.models.strict import Amount, Count, Share, StrictModel
from deepfsi.camera.detectors import DetectorMap, SeveralDetectors
from deepfsi.camera.device import DEVICE_SOURCES, DEVICES, Device
from deepfsi.camera.layout import DmdGrid, DmdLayout, find_grid
from deepfsi.camera.names import LIGHT_LAWS, LightLawName, Readout, SummedReflectance
from deepfsi.designfile.design_file import DesignFile
from deepfsi.hardware.patterns.frames import Format, Selection, make_frame
from deepfsi.jobs.designs import EVERY_PIXEL

MOST_FRAMES = 2**20
"""Frames of one pass at most, sentinels among them."""

SENTINELS = 4
"""Frames of a pass that show no mask."""

DESIGN_NAME = "design.safetensors"
"""File beside a manifest: the design."""

SMALLEST_STEP = float(np.finfo(np.float64).tiny)
"""Step between grey levels, as a share of a pixel's photons, below which a rail is dark."""

FINEST_PASS_US = 10**9
"""Time of the masks' frames of a pass without a device, µs: long, so that their ratios stay."""

LEAST_DIMMED = 0.999
"""Share of a design's light that one device must show."""

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

    @property
    def loads(self) -> bool:
        """True where the mask of each look is loaded before it."""
        return not self.dictionary


@dataclass(frozen=True)
class DesignRails:
    """Rails of a design that are to be shown."""

    rails: np.ndarray  # share of each pixel's photons, (2 or 1, m, N)
    light: LightLawName
    image_shape: tuple[int, ...]  # rows and columns of the masks, or values of a spectrum
    summed_reflectance: float  # mean of the training scenes
    file: bytes | None = None  # the design's file, which the folder then holds
    brightness: Brightness | None = None  # by how much scenes differ from the mean
    detectors: DetectorMap | None = None  # which see which cells, where there are several
    readout: Readout = "difference"  # what the network reads of two rails
    looks: LookPlan | None = None  # looks, where masks are chosen while the exposure runs

    @classmethod
    def of(cls, design: DesignFile, file: bytes) -> Self:
        """Rails of a design file that was read, and its content."""
        header = design.mask_header
        if header.name in EVERY_PIXEL:
            raise InputError(
                "impulse imaging has a detector for each pixel: no one device can show it"
            )
        if header.exposure.no_frames:
            raise InputError(header.exposure.no_frames)
        detectors = None
        with as_input_error(str(design.path)):
            brightness = Brightness.of(header.info)
            if design.detectors is not None:
                detectors = DetectorMap.model_validate(
                    {
                        "count": design.detector_count,
                        "cells": tuple(design.detectors.tolist()),
                        **(header.info.get("detector_light") or {}),
                    }
                )
        return cls(
            rails=design.rails,
            light=header.light,
            image_shape=header.image_shape,
            summed_reflectance=header.summed_reflectance,
            file=file,
            brightness=brightness,
            detectors=detectors,
            readout=header.readout,
        )

    def __post_init__(self) -> None:
        rails = self.rails
        pixels = math.prod(self.image_shape) or rails.shape[-1]  # `find_grid` refuses none
        check_choice("light law", self.light, get_args(LightLawName))
        if rails.shape != (self.rail_count, *rails.shape[1:2], pixels) or not rails.size:
            raise InputError(
                f"rails of shape {rails.shape} are not allowed: give (2 or 1, masks, {pixels})"
            )
        if self.two_arm and self.rail_count != 2:
            raise InputError("two-arm with a single rail is not allowed: give both arms' rails")
        if not np.isfinite(rails).all() or rails.min() < 0:
            raise InputError(
                "rails must be finite and 0 or more: give shares of each pixel's photons"
            )
        times = rails.sum(axis=0)
        # Share of the exposure by which two arms' times may differ between pixels
        if self.two_arm and np.ptp(times, axis=-1).max() * len(times) > 1e-4:
            raise InputError("the two arms of a mask do not sum to one time for all of its pixels")
        if not (math.isfinite(self.summed_reflectance) and self.summed_reflectance > 0):
            raise InputError(
                f"summed reflectance {self.summed_reflectance!r} is not allowed: give a number "
                "above 0"
            )

    @property
    def two_arm(self) -> bool:
        """True where a second detector sees the mirrors that are OFF."""
        return LIGHT_LAWS[self.light].arms == 2

    @property
    def rail_count(self) -> Literal[1, 2]:
        """Number of rails: 2 of signed masks, or 1."""
        return 2 if len(self.rails) == 2 else 1

    def picture_s(self, device: Device, exposure_s: float | None) -> float:
        """Mean picture time of a frame, seconds: what an exposure takes, or 1 ms without one."""
        if exposure_s is None:
            # Mean picture time of a frame where no exposure is given, seconds
            return 1e-3
        if self.looks is not None:  # a live run times the masks itself
            # Time of an all-ON frame of several looks, as a share of the exposure: it measures
            # their light
            return max(0.1 * exposure_s, device.shortest_us * 1e-6)
        frames = int((self.rails.max(axis=-1) > 0).sum())
        # Time of pictures over what the gates of an exposure take: pictures are of whole
        # microseconds
        return 1.01 * exposure_s / frames + device.settle_us * 1e-6

    def first_dwells(self, frames: "MaskFrames") -> np.ndarray:
        """Shares of the exposure (f,) for which a fixed sequence, or a first look, shows frames."""
        if self.looks is None:
            return frames.shares
        return np.array(self.looks.first)[[mask for mask, _ in frames.mask_rails]]


@dataclass(frozen=True)
class MaskFrames:
    """Frames that show the rails of masks, mask by mask, dark rails left out."""

    mask_rails: list[tuple[int, Rail]]  # mask and rail of each of f frames
    peaks: np.ndarray
    on: np.ndarray

    @classmethod
    def of(cls, design: DesignRails, mirrors: int) -> Self:
        """Frames of a design, on cells of so many mirrors."""
        rails, masks, pixels = design.rails.shape
        mask_rails: list[tuple[int, Rail]] = []
        peaks: list[float] = []
        on = np.empty((rails * masks, pixels), dtype=np.uint32)
        for mask in range(masks):
            for rail, peak, level in _levels(design.rails[:, mask], design.light, mirrors):
                if peak > mirrors * SMALLEST_STEP:
                    on[len(mask_rails)] = np.rint(level)
                    mask_rails.append((mask, rail))
                    peaks.append(peak)
        return cls(mask_rails, np.array(peaks), on[: len(mask_rails)])

    @property
    def dimmed(self) -> float:
        """Factor to the peaks with which they sum to at most 1."""
        return min(1.0, 1 / float(self.peaks.sum()))

    @property
    def shares(self) -> np.ndarray:
        """Share of the exposure of each frame, shape (f,)."""
        return np.minimum(self.peaks * self.dimmed, 1.0)


def _levels(
    mask: np.ndarray, light: LightLawName, mirrors: int
) -> Iterator[tuple[Rail, float, np.ndarray]]:
    """Rail, peak, and mirrors ON before rounding (N,), of each frame of a mask (2 or 1, N)."""
    parts = mask.astype(np.float64)
    if LIGHT_LAWS[light].arms == 2:
        time = parts.sum(axis=0)
        yield "both", time.max(), parts[0] / np.where(time > 0, time, 1.0) * mirrors
        return
    names: tuple[Rail, Rail] = ("plus", "minus")
    for rail, part in zip(names, parts, strict=False):
        step = max(part.max() / mirrors, SMALLEST_STEP)
        yield rail, part.max(), part / step


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
    detectors: SeveralDetectors | None = None
    readout: Readout = "difference"  # What the network reads of two rails
    # Where masks are chosen while the exposure runs; the frames' shares are then equal ones
    looks: LookPlan | None = None
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
    def _consistent(self) -> Self:
        rails = [(frame.mask, frame.rail) for frame in self.frames if frame.role == "mask"]
        if len(set(rails)) < len(rails):
            raise ValueError("a rail of a mask is shown twice")
        if any(mask is not None and mask >= self.masks for mask, _ in rails):
            raise ValueError("a frame shows a mask that does not exist")
        if {rail for _, rail in rails} - ({"plus"} if self.rails == 1 else set(get_args(Rail))):
            raise ValueError("a frame shows a rail that does not exist")
        # Sum of the frames' shares of the exposure beyond 1 that rounding may leave
        if sum(frame.share for frame in self.frames) > 1 + 1e-4:
            raise ValueError("the frames' shares of the exposure sum to more than 1")
        check_choice("light law", self.light, LIGHT_LAWS)
        if self.two_arm != (LIGHT_LAWS[self.light].arms == 2) or not rails:
            raise ValueError(f"the rails are not those of {self.light}")
        if self.looks and self.masks != len(self.looks.first):
            raise ValueError("the first look has a dwell for other frames than the masks'")
        if self.looks and self.looks.dictionary and len(rails) != self.masks:
            raise ValueError("the masks of a dictionary have a frame each")
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
        grid = self.grid
        device = self.device
        return grid.down * grid.across * grid.mirrors / (device.columns * device.rows)

    @cached_property
    def shown(self) -> np.ndarray:
        """Indices of the masks' frames among all, shape (f,)."""
        return np.flatnonzero([frame.role == "mask" for frame in self.frames])

    @cached_property
    def read(self) -> np.ndarray:
        """Rail, mask, index among the masks' frames, and arm of each readout, shape (4, r)."""
        frames = enumerate(self.frames[index] for index in self.shown)
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
        return np.array([self.frames[index].share for index in self.shown])

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
    def arms(self) -> int:
        """Arms of the device that have detectors."""
        return 2 if self.two_arm else 1

    @property
    def inputs(self) -> int:
        """Inputs of a counter that are needed, one for each detector of each arm."""
        return self.arms * self.detector_count

    @property
    def arm(self) -> slice:
        """Inputs of the detectors that see mirrors ON."""
        return slice(self.detector_count)

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

    @property
    def companions(self) -> dict[str, str]:
        """Files beside the manifest that say what was shown, by their hashes."""
        return {} if self.design_sha256 is None else {DESIGN_NAME: self.design_sha256}

    @property
    def usual_tolerance_s(self) -> float:
        """By how much a frame's marker may be off unless another tolerance is given, seconds."""
        # By how much a frame's marker may be off: 10 µs, or a tenth of the shortest frame
        return min(0.1 * float(self.picture_s.min()), 1e-5)

    def longest_exposure_s(self, settle_s: float) -> float:
        """Longest exposure, seconds, whose gates fit all frames after the time to settle."""
        room = (self.picture_s[self.shown] - settle_s) / self.shares
        return float(room.min())

    def lit_frame(self, mask: np.ndarray) -> np.ndarray:
        """Packed frame of a mask, bool (N,), whose cells have all mirrors ON or none."""
        return make_frame(mask, self.device, self.grid)

    def check_limits(self) -> None:
        """Raise `InputError` unless the device can show all of the frames."""
        device = self.device
        check_stored(device, len(self.frames), self.looks)
        if self.looks and self.looks.dictionary and device.video_us is not None:
            raise InputError(
                f"masks of a dictionary are shown by their index, and {device.name} shows the "
                "frames of a video in their order: use a device that stores frames, such as dlp7000"
            )
        if self.looks and self.looks.loads and device.load_us is None:
            able = ", ".join(other.name for other in DEVICES.values() if other.load_us)
            raise InputError(
                f"adaptive masks are loaded while the run goes on, and {device.name} takes no "
                f"frame then: use {able}, or a device file with its `load_us`"
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

    @property
    def departures(self) -> list[str]:
        """Limits of the device that are wider than those of its documents, one line each."""
        device = self.device
        documented = DEVICES.get(device.name)
        if documented is None or device.shortest_us >= documented.shortest_us:
            return []
        source = DEVICE_SOURCES[device.name]["shortest_us"]
        return [
            f"shortest picture {device.shortest_us} µs, and {device.name} needs "
            f"{documented.shortest_us} ({source}): export without --shortest unless you know why"
        ]

    @classmethod
    def of(
        cls,
        design: DesignRails,
        counted: MaskFrames,
        *,
        pictures_us: list[int],
        sentinel_us: int,
        hashes: list[str],
        **settings: Any,
    ) -> Self:
        """Frames of a design in their order, with a pair of sentinels before and after."""
        ends = (
            Frame(role="on", picture_us=sentinel_us, sha256=hashes[0]),
            Frame(role="off", picture_us=sentinel_us, sha256=hashes[1]),
        )
        masks = (
            Frame(role="mask", mask=mask, rail=rail, share=share, picture_us=us, sha256=digest)
            for (mask, rail), share, us, digest in zip(
                counted.mask_rails, counted.shares.tolist(), pictures_us, hashes[2:-2], strict=True
            )
        )
        return cls(
            deepfsi=version("deepfsi"),
            image_shape=tuple(map(int, design.image_shape)),
            masks=design.rails.shape[1],
            rails=design.rail_count,
            light=design.light,
            dimmed=counted.dimmed,
            summed_reflectance=float(design.summed_reflectance),
            brightness=design.brightness,
            detectors=design.detectors,
            readout=design.readout,
            looks=design.looks,
            design_sha256=None if design.file is None else hashlib.sha256(design.file).hexdigest(),
            mirrors_sha256=hash_mirrors(counted.on),
            frames=(*ends, *masks, *ends),
            **settings,
        )

    @classmethod
    def from_design(cls, design: DesignRails) -> Self:
        """Frames of a design in their usual order, on a device of one mirror a cell.

        For counts of a design for which no device was chosen: a mask's frame lasts for its share of
        the exposure, a sentinel for the mean of them.
        """
        # Grey levels of a cell, more than any device has, so that a rail is dark only where it is
        # zero
        counted = MaskFrames.of(design, 2**16)
        if not counted.mask_rails or counted.dimmed < LEAST_DIMMED:
            raise InputError(
                f"one device shows a {design.light} design only dimmed, or not at all: give the "
                "folder of its patterns in place of its file"
            )
        shape = design.image_shape
        down, across = shape if len(shape) == 2 else (1, *shape)
        pictures = [max(1, round(share * FINEST_PASS_US)) for share in counted.shares.tolist()]
        return cls.of(
            replace(design, looks=None),
            counted,
            pictures_us=pictures,
            sentinel_us=math.ceil(FINEST_PASS_US * float(counted.shares.mean())),
            hashes=["0" * 64] * (len(pictures) + SENTINELS),
            device=Device(name="none", columns=across, rows=down, settle_us=0),
            selection="ordered",
            format="npy",
        )


def check_stored(device: Device, frames: int, looks: LookPlan | None = None) -> None:
    """Raise `InputError` if a controller does not hold as many frames, of such looks."""
    if device.patterns is None or frames <= device.patterns:
        return
    larger = [
        f"{other.name} ({other.patterns or 'as many as fit its memory'})"
        for other in DEVICES.values()
        if not other.video_us and (other.patterns is None or other.patterns >= frames)
    ]
    if looks is not None and looks.dictionary:
        advice = f"learn the design with `dictionary` of {device.patterns - SENTINELS} at most"
    else:
        advice = "use fewer masks (of a scan: a smaller --size)"
    raise InputError(
        f"{frames} frames do not fit {device.name}, whose controller holds {device.patterns}: "
        f"{advice}, or use a device that holds them, such as {', '.join(larger[:3])}"
    )


def hash_mirrors(on: np.ndarray) -> str:
    """Hash of mirror counts (f, N), as a manifest holds it."""
    return hashlib.sha256(np.ascontiguousarray(on, "<u4").data).hexdigest()
