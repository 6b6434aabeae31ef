"""A design file as what one micromirror device shows of it."""

import os
from dataclasses import replace
from pathlib import Path

from deepfsi.design.artifact import Design
from deepfsi.design.live import loop_of
from deepfsi.errors import InputError, as_input_error
from deepfsi.hardware.patterns.detectors import Detectors
from deepfsi.hardware.patterns.folder import DesignRails
from deepfsi.hardware.patterns.sequence import Brightness


def design_rails(file: str | os.PathLike[str]) -> DesignRails:
    """Rails of a design file, as `export_patterns` takes them."""
    path = Path(file)
    made = Design.load(path)
    if made.name == "impulse":
        raise InputError("impulse imaging has a detector for each pixel: no one device can show it")
    made.exposure.check_frames()
    known = made.info.get("brightness")
    with as_input_error(str(file)):
        brightness = None if known is None else Brightness.model_validate(known)
    labels = made.detection.labels
    cells = None if labels is None else tuple(labels.tolist())
    rails = DesignRails(
        made.rails.stacked.numpy(),
        made.light,
        made.image_shape,
        made.summed_reflectance,
        path.read_bytes(),
        brightness,
        None if cells is None else Detectors(count=made.detection.count, cells=cells),
        made.detection.readout,
    )
    if made.exposure.looks == 1:
        return rails
    loop = loop_of(made)
    return replace(rails, looks=loop.looks, loop=loop.to_bytes())
