"""A design as what one micromirror device shows of it, its networks of looks included."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path

from deepfsi.base import SILENT, InputError, Progress, as_input_error, read_regular, require_torch
from deepfsi.base.numeric import LARGEST_TENSORS
from deepfsi.camera import DetectorMap, find_device
from deepfsi.designfile import AdaptiveHeader, DesignFile, check_masks, loop_bytes
from deepfsi.hardware.patterns import Brightness, DesignRails, FrameSettings, Looks, export_patterns
from deepfsi.jobs import EVERY_PIXEL, STATIC


def design_rails(file: str | os.PathLike[str]) -> DesignRails:
    """Rails of a design file, as `export_patterns` takes them."""
    path = Path(file)
    if isinstance(DesignFile.read(path, ()).header, AdaptiveHeader):
        with require_torch():
            from deepfsi.lab.adaptive_looks import adaptive_rails
        return adaptive_rails(path)
    design = DesignFile.read(path)
    header = design.mask_header
    check_masks(header.info, "a device")
    if header.name in EVERY_PIXEL:
        raise InputError("impulse imaging has a detector for each pixel: no one device can show it")
    if header.exposure.kind == "patches":
        raise InputError(
            "this design is of image patches, each with a detector of its own, which frames of "
            "one device cannot show: use Design.classify"
        )
    if header.exposure.kind == "passing":
        raise InputError(STATIC)
    with as_input_error(str(file)):
        brightness, detectors = Brightness.of(header.info), detectors_of(design)
    chooses = header.exposure.kind == "adaptive"
    return DesignRails(
        design.rails,
        header.light,
        header.image_shape,
        header.summed_reflectance,
        read_regular(path, LARGEST_TENSORS, "give a design file"),
        brightness,
        detectors,
        header.readout,
        looks=looks_of(design) if chooses else None,
        loop=loop_bytes(design) if chooses else None,
    )


def looks_of(design: DesignFile) -> Looks:
    """Looks of a design, or `InputError` where it has one, or no networks of the package."""
    return Looks(
        count=design.looks.looks,
        each_rail=design.each_rail,
        first=tuple(design.first_dwell.tolist()),
        shortest=design.looks.shortest,
        loop_sha256=sha256(loop_bytes(design)).hexdigest(),
    )


def detectors_of(design: DesignFile) -> DetectorMap | None:
    """Which detector sees each cell, and the light of each; None where one sees all."""
    if design.detectors is None:
        return None
    light = design.header.info.get("detector_light") or {}
    cells = tuple(design.detectors.tolist())
    return DetectorMap.model_validate({"count": design.detector_count, "cells": cells, **light})


@contextmanager
def patterns_for_now(file: str | os.PathLike[str], report: Progress = SILENT) -> Iterator[Path]:
    """Folder of a design file's patterns for a DLP7000, removed at the end."""
    with tempfile.TemporaryDirectory() as folder:
        patterns = Path(folder) / "patterns"
        settings = FrameSettings(find_device("dlp7000"), 1e-3)
        export_patterns(design_rails(file), settings, patterns, report)
        yield patterns
