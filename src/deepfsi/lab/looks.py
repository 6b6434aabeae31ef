"""Cameras, rails and looks of a design."""

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
from deepfsi.designfile.design_file import AdaptiveHeader, DesignFile
from deepfsi.hardware.live.looks import LookChooser
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
    """Looks of a folder of patterns, or `InputError` if they are of no adaptive masks."""
    manifest = read_patterns(folder).manifest
    if manifest.looks is None:
        raise InputError(
            "{folder} has the patterns of a design whose masks are known before: learn one of "
            "{design:adaptive} masks, or record it with `deepfsi camera simulate` or `prepare`",
            setting="design",
            folder=folder,
        )
    with require_extras():
        from deepfsi.lab.adaptive_looks import AdaptiveLooks
    return AdaptiveLooks.read(folder, manifest)
