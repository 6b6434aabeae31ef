"""A design as what one micromirror device shows of it, its networks of looks included."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from deepfsi.design.artifact import Design
from deepfsi.design.classifiers import Mlp
from deepfsi.design.exposure.looks import LARGEST_SCORE
from deepfsi.design.stopping import looks_of
from deepfsi.devices import find_device
from deepfsi.errors import InputError, as_input_error
from deepfsi.hardware.patterns.detectors import Detectors
from deepfsi.hardware.patterns.folder import DesignRails, export_patterns
from deepfsi.hardware.patterns.sequence import Brightness, FrameSettings
from deepfsi.hardware.recording.live_settings import StopRule
from deepfsi.laboratory.live.loop import Layer, Loop, LoopHeader
from deepfsi.optics.codes import DESIGNS
from deepfsi.progress import SILENT, Report


def design_rails(file: str | os.PathLike[str]) -> DesignRails:
    """Rails of a design file, as `export_patterns` takes them."""
    path = Path(file)
    made = Design.load(path)
    if DESIGNS[made.name].every_pixel:
        raise InputError("impulse imaging has a detector for each pixel: no one device can show it")
    made.exposure.check_frames()
    known = made.info.get("brightness")
    with as_input_error(str(file)):
        brightness = None if known is None else Brightness.model_validate(known)
    labels = made.detection.labels
    cells = None if labels is None else tuple(labels.tolist())
    loop = loop_of(made) if made.exposure.chooses else None
    return DesignRails(
        made.rails.stacked.numpy(),
        made.light,
        made.image_shape,
        made.summed_reflectance,
        path.read_bytes(),
        brightness,
        None if cells is None else Detectors(count=made.detection.count, cells=cells),
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
    rule = design.info.get("stopping")
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
        rule=None if rule is None else StopRule.model_validate(rule),
    )
    mean, std = (each.detach().cpu().float().numpy() for each in (design.mean, design.std))
    return Loop(header, mean, std, _layers(classifier), _layers(exposure.network))


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
