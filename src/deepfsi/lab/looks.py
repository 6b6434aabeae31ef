"""Cameras, rails and looks of a design, of masks that do not change or that it makes itself."""

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

from deepfsi.base.errors import InputError
from deepfsi.base.files import read_regular
from deepfsi.base.numeric.arrays import LARGEST_TENSORS
from deepfsi.base.plugins import require_extras
from deepfsi.camera.camera import Camera
from deepfsi.designfile.design_file import DesignFile
from deepfsi.designfile.header import AdaptiveHeader
from deepfsi.hardware.live.looks import FixedMaskLooks, LookChooser
from deepfsi.hardware.patterns.folder import Patterns, read_patterns
from deepfsi.hardware.patterns.manifest import DesignRails
from deepfsi.hardware.virtual.camera import CAMERAS, VirtualCamera


def camera_of(source: Path, settings: Mapping[str, Any] = MappingProxyType({})) -> Camera:
    """Camera of a design, with other settings; the preset `dmd` where none is known."""
    folders = (source, source / "patterns") if source.is_dir() else ()
    files = (folder / Patterns.DESIGN for folder in folders)
    file = next((file for file in files if file.is_file()), source)
    camera = None
    if file.is_file():
        with suppress(InputError):  # whoever opens the design says what is wrong with it
            camera = DesignFile.read(file, ()).camera
    return Camera.of_run(camera, **settings)


def virtual_camera(
    name: str | None, source: Path, settings: Mapping[str, Any] = MappingProxyType({})
) -> VirtualCamera:
    """Virtual camera of a run of a design."""
    if name is not None:
        return VirtualCamera.load(name)
    camera = camera_of(source, {"camera": settings.get("camera")})
    described = camera.exposure is not None or camera.clicks is not None or camera.fluctuation > 0
    return VirtualCamera.of(camera_of(source, settings)) if described else CAMERAS["pmt"]


def design_rails(file: str | os.PathLike[str]) -> DesignRails:
    """Rails of a design file, as `export_patterns` takes them; only adaptive masks need torch."""
    path = Path(file)
    if isinstance(DesignFile.read(path, ()).header, AdaptiveHeader):
        with require_extras():
            from deepfsi.lab.adaptive_looks import adaptive_rails
        return adaptive_rails(path)
    return DesignRails.of(
        DesignFile.read(path), read_regular(path, LARGEST_TENSORS, "give a design file")
    )


def open_looks(folder: Path) -> LookChooser:
    """Looks of a folder of patterns; only adaptive masks need torch."""
    patterns = read_patterns(folder)
    looks = patterns.manifest.looks
    if looks is None or not looks.adaptive:
        return FixedMaskLooks.read(folder, patterns)
    with require_extras():
        from deepfsi.lab.adaptive_looks import AdaptiveLooks
    return AdaptiveLooks.read(folder, patterns.manifest)
