"""Where a camera loses light, planned before any run, with a design or without one."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.quantities import plural, time_text
from deepfsi.camera.camera import Camera
from deepfsi.camera.device import find_device
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.designfile.design_file import DesignFile
from deepfsi.designfile.header import AdaptiveHeader
from deepfsi.hardware.live.losses import LightLosses
from deepfsi.hardware.patterns.manifest import DesignRails, LookPlan

USUAL_DEVICE = "dlp7000"
"""Device of a camera that names none."""

USUAL_MASKS = 24
"""Masks where neither a design nor a number is given."""

MASK_S = 1e-3
"""Time of a mask, or of a look, of a camera without an exposure, seconds."""

USUAL_CELLS = (32, 32)
"""Cells of their frames."""


@dataclass(frozen=True)
class PlannedLosses:
    """Losses of light, and what was assumed of the camera and its masks for want of a number."""

    losses: LightLosses
    camera: Camera
    assumed: tuple[str, ...]  # one line each


def plan_losses(
    file: Path | None,
    settings: Mapping[str, Any] = MappingProxyType({}),
    *,
    masks: int | None = None,
    efficiency: float = 1.0,
    decision_s: float = 0.0,
) -> PlannedLosses:
    """Where a camera loses light, with the masks of a design or with ones half of which is ON."""
    assumed: list[str] = []
    design = None if file is None else DesignFile.read(file)
    if design is not None and masks is not None:
        raise InputError(
            "{masks} is the number without a design, and {file} has its own: leave it out",
            setting="masks",
            file=file,
        )
    camera = Camera.of_run(None if design is None else design.camera, **settings)
    if camera.device is None and LIGHT_LAWS[camera.light].one_device:
        camera = Camera.load(camera, device=find_device(USUAL_DEVICE))
        assumed.append(f"device {USUAL_DEVICE}, as the camera names none")
    counted = None
    if design is None or file is None:
        number = USUAL_MASKS if masks is None else masks
        rails = _even_rails(camera, number)
        assumed.append(f"{plural(number, 'mask')} with half of the mirrors ON, as no design says")
    else:
        rails = _timed_rails(file, design, camera)
        _check_optics(file, rails, camera)
        counted = float(design.arrays["shares"].sum())
    if camera.exposure is None:
        steps = rails.rails.shape[1] if rails.looks is None else rails.looks.count
        camera = Camera.load(camera, exposure=steps * MASK_S)
        assumed.append(
            f"exposure {time_text(camera.exposure_s)}, {time_text(MASK_S)} "
            f"{'a mask' if rails.looks is None else 'a look'}, as the camera has none"
        )
    if camera.flux is None and (camera.dead_time or camera.clicks is not None):
        assumed.append("no dead time, as the camera has no flux")
    losses = LightLosses.of(
        rails, camera, counted=counted, efficiency=efficiency, decision_s=decision_s
    )
    if rails.looks is not None and rails.looks.adaptive and not decision_s:
        assumed.append("masks that are chosen in no time")
    return PlannedLosses(losses, camera, tuple(assumed))


def _check_optics(file: Path, rails: DesignRails, camera: Camera) -> None:
    """Raise `InputError` where a camera has other arms or detectors than masks were made for."""
    wanted = (2 if rails.two_arm else 1, rails.detectors.count if rails.detectors else 1)
    arms = LIGHT_LAWS[camera.light].arms
    count = camera.detector_map(rails.image_shape).count
    if LIGHT_LAWS[camera.light].one_device and wanted != (arms, count):
        raise InputError(
            "the masks of {file} are for {own}, and this camera has {other}: leave {camera}, "
            "{light} and {detectors} out, or give another design",
            setting=("camera", "light", "detectors"),
            file=file,
            own=_optics_text(*wanted),
            other=_optics_text(arms, count),
        )


def _optics_text(arms: int, detectors: int) -> str:
    """Arms and detectors in words: 1 arm with 4 detectors."""
    return f"{plural(arms, 'arm')} with {plural(detectors, 'detector')}"


def _even_rails(camera: Camera, masks: int) -> DesignRails:
    """Rails of masks that are shown for equal times, each with half of its mirrors ON."""
    rows, columns = USUAL_CELLS
    checkers = np.indices(USUAL_CELLS).sum(axis=0).ravel() % 2
    count = camera.rail_count
    frames = masks * (1 if LIGHT_LAWS[camera.light].arms == 2 else count)
    rails = np.stack([checkers, 1 - checkers][:count]) / frames
    detectors = camera.detector_map(USUAL_CELLS)
    return DesignRails(
        rails=np.repeat(rails[:, None], masks, axis=1),
        light=camera.light,
        image_shape=USUAL_CELLS,
        summed_reflectance=float(rows * columns),
        detectors=detectors if detectors.count > 1 else None,
        readout=camera.readout,
    )


def _timed_rails(file: Path, design: DesignFile, camera: Camera) -> DesignRails:
    """Rails of a design; of adaptive masks a mask that stands for each, which needs no torch."""
    header = design.header
    if not isinstance(header, AdaptiveHeader):
        return DesignRails.of(design, file.read_bytes())
    # of exposures that share their light, as many looks as the mean has
    looks = max(1, round(header.settings.looks / header.settings.cap))
    half = np.arange(math.prod(header.image_shape)) % 2
    arms = LIGHT_LAWS[camera.light].arms
    stored = design.arrays.get("dictionary")
    frames = 1 if stored is None else len(stored)
    rails = np.stack([half, 1 - half][:arms])[:, None] / frames
    detectors = camera.detector_map(header.image_shape)
    return DesignRails(
        rails=np.repeat(rails, frames, axis=1),
        light=camera.light,
        image_shape=header.image_shape,
        summed_reflectance=1.0,
        detectors=detectors if detectors.count > 1 else None,
        looks=LookPlan(
            count=looks,
            each_rail=False,
            first=(1 / looks,) * frames,
            shortest=0,
            loop_sha256=None,
            dictionary=stored is not None,
        ),
    )
