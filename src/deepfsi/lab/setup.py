"""What a run of a design needs: its camera, rails and looks, and the camera's calibration."""

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
from deepfsi.base.progress import SILENT, Progress
from deepfsi.camera.camera import Camera
from deepfsi.datasets.display import read_display
from deepfsi.designfile.design_file import AdaptiveHeader, DesignFile
from deepfsi.hardware.calibration.fit import calibrate_run
from deepfsi.hardware.calibration.reference import ReferenceFit, find_reference
from deepfsi.hardware.calibration.scans import (
    find_detectors,
    find_gains,
    reconstruct,
    save_detectors,
)
from deepfsi.hardware.counting.acquisition import Calibration, read_run
from deepfsi.hardware.counting.counts import Counts, read_counts
from deepfsi.hardware.live.observer import LookChooser
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
            f"{folder} has the patterns of a design whose masks are known before: learn one of "
            '`design="adaptive"` masks, or record it with `deepfsi camera simulate` or `prepare`'
        )
    with require_extras():
        from deepfsi.lab.adaptive_looks import AdaptiveLooks
    return AdaptiveLooks.read(folder, manifest)


def calibrate(folder: Path, spots: Path, out: Path) -> tuple[Calibration, Path, Path | None]:
    """Fit the camera's view to a counted run of the spots, and write it to a folder."""
    run = read_run(folder)
    display = read_display(spots)
    counts = _photons(folder)
    fitted = calibrate_run(
        dict(zip(display.names, display.x, strict=True)),
        [scene.name for scene in run.acquisition.scenes],
        pictures=reconstruct(folder),
        counts=counts,
        patterns=run.patterns,
    )
    several = run.patterns.manifest.detectors
    labels = find_detectors(counts, run.patterns) if several and several.cells is None else None
    file = fitted.save(out)
    return fitted, file, None if labels is None else save_detectors(labels, out)


def check_view(folder: Path, report: Progress = SILENT) -> ReferenceFit:
    """Place of scenes on the device, from a counted run of the reference target."""
    return find_reference(_photons(folder), read_run(folder).patterns, report)


def gains_of(flat: Path) -> tuple[float, ...]:
    """Relative efficiency of each detector, from a counted run of a uniform white scene."""
    return find_gains(_photons(flat), read_run(flat).patterns)


def _photons(folder: Path) -> Counts:
    """Counts of a run, or `InputError` if they are clicks."""
    return read_counts(folder).check_photons(folder)
