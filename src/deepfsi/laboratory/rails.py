"""A design as what one micromirror device shows of it, its networks of looks included."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from deepfsi.design.artifact import Design
from deepfsi.design.classifiers import Mlp
from deepfsi.design.exposure.looks import LARGEST_SCORE
from deepfsi.design.stopping import looks_of
from deepfsi.devices import find_device
from deepfsi.errors import InputError, as_input_error
from deepfsi.files import read_regular
from deepfsi.hardware.patterns.detectors import Detectors
from deepfsi.hardware.patterns.folder import DesignRails, export_patterns
from deepfsi.hardware.patterns.sequence import Brightness, FrameSettings
from deepfsi.hardware.recording.live_settings import StopRule
from deepfsi.laboratory.live.loop import Layer, Loop, LoopHeader
from deepfsi.optics.codes import EVERY_PIXEL
from deepfsi.progress import SILENT, Report
from deepfsi.tables.tensor_files import LARGEST


def design_rails(file: str | os.PathLike[str]) -> DesignRails:
    """Rails of a design file, as `export_patterns` takes them."""
    path = Path(file)
    made = Design.load(path)
    if made.name in EVERY_PIXEL:
        raise InputError("impulse imaging has a detector for each pixel: no one device can show it")
    made.exposure.check_frames()
    known = made.info.get("brightness")
    with as_input_error(str(file)):
        brightness = None if known is None else Brightness.model_validate(known)
    labels = made.detection.labels
    cells = None if labels is None else tuple(labels.tolist())
    detectors = None
    if cells is not None:
        light = made.info.get("detector_light") or {}
        with as_input_error(str(file)):
            known = {"count": made.detection.count, "cells": cells, **light}
            detectors = Detectors.model_validate(known)
    loop = loop_of(made) if made.exposure.chooses else None
    return DesignRails(
        made.rails.stacked.numpy(),
        made.light,
        made.image_shape,
        made.summed_reflectance,
        read_regular(path, LARGEST, "give a design file"),
        brightness,
        detectors,
        made.detection.readout,
        looks=None if loop is None else loop.looks,
        loop=None if loop is None else loop.to_bytes(),
    )


def loop_of(design: Design) -> Loop:
    """Loop of a design, or `InputError` where it is of one look or its classifier is no `Mlp`."""
    exposure, classifier = looks_of(design), design.classifier
    if not isinstance(classifier, Mlp):
        raise InputError(
            f"a loop with a {type(classifier).__name__} classifier is not possible: learn the "
            "design with the package's own, an Mlp"
        )
    with as_input_error("the design's stopping rule", "make it again with `deepfsi stop`"):
        rule = TypeAdapter(StopRule | None).validate_python(design.info.get("stopping"))
    header = LoopHeader(
        looks=exposure.looks,
        masks=design.masks,
        rails=design.rails.count,
        detectors=design.detection.count,
        each_rail=exposure.dwells.each_rail,
        readout=design.detection.readout,
        classes=design.classes,
        largest_score=LARGEST_SCORE,
        shortest=exposure.shortest,
        rule=rule,
        photons=design.info.get("job", {}).get("photons"),
    )
    mean, std = (each.detach().cpu().float().numpy() for each in (design.mean, design.std))
    known = design.temperatures
    calibration = None if known is None else (known.logs, known.budgets)
    networks = _layers(classifier), _layers(exposure.network)
    return Loop(header, mean, std, *networks, calibration, design.distribution)


def _layers(network: Mlp) -> tuple[Layer, ...]:
    """Weights and biases of a network's layers."""
    return tuple(
        (np.ascontiguousarray(weight.T, np.float32), bias.astype(np.float32))
        for weight, bias in network.arrays
    )


@contextmanager
def patterns_for_now(file: str | os.PathLike[str], report: Report = SILENT) -> Iterator[Path]:
    """Folder of a design file's patterns for a DLP7000, removed at the end."""
    with tempfile.TemporaryDirectory() as folder:
        patterns = Path(folder) / "patterns"
        settings = FrameSettings(find_device("dlp7000"), 1e-3)
        export_patterns(design_rails(file), settings, patterns, report)
        yield patterns
