"""Rails of a design, and the frames that show them on a device.

A mask has a frame for each of its rails that is not dark; on two arms one frame serves both.
"""

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, Self

import numpy as np

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.camera.detectors import DetectorMap
from deepfsi.camera.device import Device
from deepfsi.camera.names import LIGHT_LAWS, LightLawName, Readout
from deepfsi.designfile.design_file import DesignFile
from deepfsi.jobs.designs import EVERY_PIXEL
from deepfsi.patterns.manifest import (
    Brightness,
    Frame,
    LookPlan,
    Manifest,
    Rail,
)

SMALLEST_STEP = float(np.finfo(np.float64).tiny)
"""Step between grey levels, as a share of a pixel's photons, below which a rail is dark."""

LEAST_DIMMED = 0.999
"""Share of a design's light that one device must show."""


@dataclass(frozen=True)
class DesignRails:
    """Rails of a design, for a device to show."""

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
                light = header.info.get("detector_light") or {}
                detectors = DetectorMap.model_validate({**design.detectors.model_dump(), **light})
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
        if not np.isfinite(self.rails).all() or self.rails.min() < 0:
            raise InputError(
                "rails must be finite and 0 or more: give shares of each pixel's photons"
            )
        times = self.rails.sum(axis=0)
        # Share of the exposure by which two arms' times may differ between pixels
        if self.two_arm and np.ptp(times, axis=-1).max() * len(times) > 1e-4:
            raise InputError("the two arms of a mask do not sum to one time for all of its pixels")

    @property
    def two_arm(self) -> bool:
        """True if a second detector sees the mirrors that are OFF."""
        return LIGHT_LAWS[self.light].arms == 2

    def picture_s(self, device: Device, exposure_s: float | None) -> float:
        """Mean picture time of a frame, seconds, for an exposure; 1 ms without one."""
        if exposure_s is None:
            return 1e-3
        if self.looks is not None:
            # A live run times the masks itself: this is the time of an all-ON frame, which measures
            # the light of several looks
            return max(0.1 * exposure_s, device.shortest_us * 1e-6)
        frames = int((self.rails.max(axis=-1) > 0).sum())
        # Pictures are of whole microseconds: 1 % more than the gates of an exposure take
        return 1.01 * exposure_s / frames + device.settle_us * 1e-6

    def in_mirrors(self, mirrors: int) -> "_MaskFrames":
        """Frames that show the rails mask by mask, on cells of a number of mirrors."""
        rails, masks, pixels = self.rails.shape
        mask_rails: list[tuple[int, Rail]] = []
        peaks: list[float] = []
        on = np.empty((rails * masks, pixels), dtype=np.uint32)
        for mask in range(masks):
            for rail, peak, level in self._levels(mask, mirrors):
                # a dark rail has no frame
                if peak > mirrors * SMALLEST_STEP:
                    on[len(mask_rails)] = np.rint(level)
                    mask_rails.append((mask, rail))
                    peaks.append(peak)
        return _MaskFrames(mask_rails, np.array(peaks), on[: len(mask_rails)])

    def _levels(self, mask: int, mirrors: int) -> Iterator[tuple[Rail, float, np.ndarray]]:
        """Rail, peak, and mirrors ON before rounding (N,), of each frame of a mask."""
        rails = self.rails[:, mask].astype(np.float64)
        if self.two_arm:
            time = rails.sum(axis=0)
            # pixels that no arm lights divide by 1, not by 0
            yield "both", time.max(), rails[0] / np.where(time > 0, time, 1.0) * mirrors
            return
        names: tuple[Rail, Rail] = ("plus", "minus")
        for rail, values in zip(names, rails, strict=False):
            step = max(values.max() / mirrors, SMALLEST_STEP)
            yield rail, values.max(), values / step

    def manifest(
        self,
        frames: "_MaskFrames",
        *,
        pictures_us: list[int],
        sentinel_us: int,
        **settings: Any,
    ) -> Manifest:
        """Manifest of frames between two pairs of sentinels, without hashes."""
        no_hash = "0" * 64
        ends = (
            Frame(role="on", picture_us=sentinel_us, sha256=no_hash),
            Frame(role="off", picture_us=sentinel_us, sha256=no_hash),
        )
        masks = (
            Frame(role="mask", mask=mask, rail=rail, share=share, picture_us=us, sha256=no_hash)
            for (mask, rail), share, us in zip(
                frames.mask_rails, frames.shares.tolist(), pictures_us, strict=True
            )
        )
        mirrors = np.ascontiguousarray(frames.on, "<u4")
        return Manifest(
            deepfsi=version("deepfsi"),
            image_shape=tuple(map(int, self.image_shape)),
            masks=self.rails.shape[1],
            rails=2 if len(self.rails) == 2 else 1,
            light=self.light,
            dimmed=frames.dimmed,
            summed_reflectance=float(self.summed_reflectance),
            brightness=self.brightness,
            detectors=self.detectors,
            readout=self.readout,
            design_sha256=None if self.file is None else hashlib.sha256(self.file).hexdigest(),
            mirrors_sha256=hashlib.sha256(mirrors.data).hexdigest(),
            frames=(*ends, *masks, *ends),
            **settings,
        )

    def without_device(self) -> Manifest:
        """Manifest of the frames in their usual order, on a device of one mirror a cell.

        It serves counts of a design without a chosen device: a mask's frame lasts for its share of
        the exposure, a sentinel for the mean share.
        """
        # Grey levels of a cell, more than any device has, so that a rail is dark only where it is 0
        frames = self.in_mirrors(2**16)
        if not frames.mask_rails or frames.dimmed < LEAST_DIMMED:
            raise InputError(
                f"one device shows a {self.light} design only dimmed, or not at all: give the "
                "folder of its patterns in place of its file"
            )
        pass_us = 10**9  # long, so that the ratios of whole microseconds are those of the shares
        down, across = self.image_shape if len(self.image_shape) == 2 else (1, *self.image_shape)
        return self.manifest(
            frames,
            pictures_us=[max(1, round(share * pass_us)) for share in frames.shares.tolist()],
            sentinel_us=math.ceil(pass_us * float(frames.shares.mean())),
            device=Device(name="none", columns=across, rows=down, settle_us=0),
            format="npy",
        )


@dataclass(frozen=True)
class _MaskFrames:
    """Frames of masks; dark rails have none."""

    mask_rails: list[tuple[int, Rail]]  # mask and rail of each of f frames
    peaks: np.ndarray  # (f,): of the rails
    on: np.ndarray  # (f, N): mirrors ON in each cell

    @property
    def dimmed(self) -> float:
        """Factor to the peaks with which they sum to at most 1."""
        return min(1.0, 1 / float(self.peaks.sum()))

    @property
    def shares(self) -> np.ndarray:
        """Share of the exposure of each frame, shape (f,)."""
        return np.minimum(self.peaks * self.dimmed, 1.0)
