"""The camera of a design, of its patterns or of a run, and what runs take of it.

No torch: a camera's computer reads the header of a design file.
"""

import os
from collections.abc import Container
from pathlib import Path
from typing import Any

from deepfsi.base import InputError
from deepfsi.camera import LIGHT_LAWS, Camera, DeadTime, Device
from deepfsi.designfile import DesignFile
from deepfsi.hardware.patterns import DesignRails, Patterns
from deepfsi.hardware.virtual import VirtualCamera

SLACK = 1.01
"""Time of pictures over what the gates of an exposure take: pictures are of whole microseconds."""


SENTINEL_SHARE = 0.1
"""Time of an all-ON frame of several looks, as a share of the exposure: it measures their light."""


def camera_of(source: Camera | str | os.PathLike[str], **settings: Any) -> Camera:
    """Camera, or that of a design file, its patterns or a run, with other settings."""
    # `camera` among the settings names another to begin with: a preset or a TOML file. Where none
    # is known it is the preset `dmd`
    given = settings.pop("camera", None)
    if given is None:
        given = source if isinstance(source, Camera) else _known(Path(source))
    found = Camera.load(given)
    if "device" in settings and not LIGHT_LAWS[found.light].one_device:
        found = Camera.load(found, light="free-dwell")  # its masks are shown with less light
    return Camera.load(found, **settings)


def _known(path: Path) -> Camera | None:
    folders = (path, path / "patterns") if path.is_dir() else ()
    files = (folder / Patterns.DESIGN for folder in folders)
    file = next((file for file in files if file.is_file()), path)
    if file.is_dir() or not file.is_file():
        return None
    try:
        design = DesignFile.read(file, ())
    except InputError:
        return None  # whoever opens the design says what is wrong with it
    return design.camera


def clicks_of(source: Path) -> int | None:
    """Gates of a frame of which a design reads clicks; None where it reads photon counts."""
    return camera_of(source).clicks


def exposure_of(camera: Camera) -> float:
    """Time of a whole exposure in seconds, or `InputError` where the camera has none."""
    if camera.exposure is None:
        raise InputError(
            "an exposure needs a time: give {exposure}, such as 10ms, or a camera",
            setting="exposure",
        )
    return camera.exposure


def picture_time(rails: DesignRails, device: Device, camera: Camera) -> float:
    """Mean picture time of a frame in seconds: what the camera's exposure takes, or 1 ms."""
    if camera.exposure is None:
        return 1e-3
    if rails.looks is not None:  # a live run times the masks itself
        return max(SENTINEL_SHARE * camera.exposure, device.shortest_us * 1e-6)
    frames = int((rails.rails.max(axis=-1) > 0).sum())
    return SLACK * camera.exposure / frames + device.settle_us * 1e-6


def flux_of(camera: Camera) -> float:
    """Flux in counts/s, or `InputError` where the camera has none."""
    if camera.flux is None:
        raise InputError(
            "a virtual camera needs its light: give {flux}, such as 1e6, or a camera",
            setting="flux",
        )
    return camera.flux


def dead_time_of(camera: Camera, told: Container[str] = ()) -> DeadTime | None:
    """Dead time to be corrected; None where the camera has none, and its model is not told."""
    if not camera.dead_time:
        if "dead_time_model" in told:
            raise InputError(
                "{dead_time_model} is of a dead time: give {dead_time}, such as 20ns",
                setting=("dead_time_model", "dead_time"),
            )
        return None
    return camera.counter_dead_time


def virtual_of(camera: Camera) -> VirtualCamera:
    """Virtual camera with the dark counts and the dead time of one that a laboratory describes."""
    # Its flux is of counts: the efficiency of the detector is in it
    return VirtualCamera(
        dark=camera.dark,
        dead_time_s=camera.counter_dead_time.seconds,
        paralysable=camera.counter_dead_time.paralysable,
    )
