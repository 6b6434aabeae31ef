"""A design as what one micromirror device shows of it, its networks of looks included."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from deepfsi.base.arrays import LARGEST_TENSORS
from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.files import read_regular
from deepfsi.base.plugins import torch_needed
from deepfsi.base.progress import SILENT, Report
from deepfsi.camera.detectors import detector_map
from deepfsi.camera.device import find_device
from deepfsi.camera.names import LightLawName, Readout
from deepfsi.camera.stop_rule import StopRule
from deepfsi.design.exposure.transits import STATIC
from deepfsi.design.file_content import (
    Info,
    damaged,
    is_adaptive,
    read_content,
    read_known_masks,
)
from deepfsi.design.readouts import check_masks
from deepfsi.hardware.live.loop import Loop, LoopHeader, loop_from
from deepfsi.hardware.patterns.detectors import Detectors
from deepfsi.hardware.patterns.folder import DesignRails, export_patterns
from deepfsi.hardware.patterns.sequence import Brightness, FrameSettings
from deepfsi.jobs.designs import EVERY_PIXEL
from deepfsi.jobs.entries import LARGEST_SCORE


class _Kind(BaseModel):
    """Kind of an exposure or a classifier, and of several looks their number."""

    kind: str
    looks: int = 1
    shortest: float = 0.0

    @property
    def chooses(self) -> bool:
        """True if the counts so far choose what is shown next."""
        return self.looks > 1


class ShownHeader(BaseModel):
    """Header of a design file, as far as a device's patterns need it."""

    model_config = ConfigDict(frozen=True)

    name: str
    light: LightLawName
    readout: Readout
    summed_reflectance: float
    image_shape: tuple[int, ...]
    classes: tuple[str, ...]
    exposure: _Kind
    classifier: _Kind
    info: Info


@dataclass(frozen=True)
class ShownDesign:
    """A design file as far as patterns need it, read without torch."""

    header: ShownHeader
    tensors: dict[str, np.ndarray]

    @classmethod
    def read(cls, path: Path) -> "ShownDesign":
        """Header and tensors of a design file, or `InputError`."""
        text, tensors = read_known_masks(path)
        try:
            header = ShownHeader.model_validate_json(text)
            rails = tensors["rails"]
            if rails.ndim != 3 or rails.dtype != np.float32:
                raise ValueError(rails.shape)
        except (ValidationError, KeyError, ValueError) as error:
            raise damaged(path, text) from error
        return cls(header, tensors)

    @property
    def detectors(self) -> Detectors | None:
        """Which detector sees each cell; none where one sees all."""
        labels = self.tensors.get("detectors")
        if labels is None:
            return None
        cells = tuple(detector_map(labels, self.header.image_shape).tolist())
        light = self.header.info.get("detector_light") or {}
        known = {"count": max(cells) + 1, "cells": cells, **light}
        return Detectors.model_validate(known) if max(cells) else None

    @property
    def loop(self) -> Loop:
        """Its networks, or `InputError` where it has one look or a classifier of one's own."""
        header, known = self.header, self.detectors
        if not header.exposure.chooses:
            raise InputError("this design has one look: learn one of several `looks`")
        if header.classifier.kind != "mlp":
            raise InputError(
                "a loop with a classifier of your own is not possible: learn the design with the "
                "package's own, an Mlp"
            )
        rails, masks, _ = self.tensors["rails"].shape
        with as_input_error("the design's stopping rule", "make it again with `deepfsi stop`"):
            rule = TypeAdapter(StopRule | None).validate_python(header.info.get("stopping"))
        with as_input_error("the design"):
            made = LoopHeader(
                looks=header.exposure.looks,
                masks=masks,
                rails=2 if rails == 2 else 1,
                detectors=1 if known is None else known.count,
                each_rail=rails == 2 and header.light != "two-arm",
                readout=header.readout,
                classes=header.classes,
                largest_score=LARGEST_SCORE,
                shortest=header.exposure.shortest,
                rule=rule,
                photons=header.info.get("job", {}).get("photons"),
            )
        try:
            return loop_from(made, dict(map(_in_loop, self.tensors.items())))
        except (KeyError, ValueError, IndexError):
            raise InputError(
                "the design's networks do not fit its masks: give a whole design file"
            ) from None


def _in_loop(held: tuple[str, np.ndarray]) -> tuple[str, np.ndarray]:
    """A tensor of a design file by its name in a loop, whose weights are (inputs, outputs)."""
    name, values = held
    for part, own in (("classifier.layers.", "classifier."), ("exposure.layers.", "chooser.")):
        if name.startswith(part):
            turned = np.ascontiguousarray(values.T) if name.endswith(".weight") else values
            return own + name.removeprefix(part), turned
    return held


def design_rails(file: str | os.PathLike[str]) -> DesignRails:
    """Rails of a design file, as `export_patterns` takes them."""
    path = Path(file)
    if is_adaptive(read_content(path, ())[0]):
        with torch_needed():
            from deepfsi.lab.adaptive import adaptive_rails
        return adaptive_rails(path)
    made = ShownDesign.read(path)
    header = made.header
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
        brightness, detectors = Brightness.of(header.info), made.detectors
    loop = made.loop if header.exposure.chooses else None
    return DesignRails(
        made.tensors["rails"],
        header.light,
        header.image_shape,
        header.summed_reflectance,
        read_regular(path, LARGEST_TENSORS, "give a design file"),
        brightness,
        detectors,
        header.readout,
        looks=None if loop is None else loop.looks,
        loop=None if loop is None else loop.to_bytes(),
    )


@contextmanager
def patterns_for_now(file: str | os.PathLike[str], report: Report = SILENT) -> Iterator[Path]:
    """Folder of a design file's patterns for a DLP7000, removed at the end."""
    with tempfile.TemporaryDirectory() as folder:
        patterns = Path(folder) / "patterns"
        settings = FrameSettings(find_device("dlp7000"), 1e-3)
        export_patterns(design_rails(file), settings, patterns, report)
        yield patterns
