"""Frames of a design for which no device was chosen: their order, and times as good as any."""

import math
from dataclasses import replace

from deepfsi.base import InputError
from deepfsi.camera import Device
from deepfsi.hardware.patterns.folder import SENTINELS, DesignRails, list_frames
from deepfsi.hardware.patterns.mirrors import count_mirrors
from deepfsi.hardware.patterns.sequence import Manifest

LEVELS = 2**16
"""Grey levels of a cell: more than any device has, so that a rail is dark only where it is zero."""

PASS_US = 10**9
"""Time of the masks' frames of a pass together, µs: long, so that whole ones keep their ratios."""

LEAST_DIMMED = 0.999
"""Share of a design's light that one device must show."""


def nominal_manifest(design: DesignRails) -> Manifest:
    """Manifest of a design's frames in their usual order, on a device of one mirror a cell."""
    # A mask's frame lasts for its share of the exposure, a sentinel for the mean of them
    counted = count_mirrors(design.rails, design.light, LEVELS)
    if not counted.shown or counted.dimmed < LEAST_DIMMED:
        raise InputError(
            f"one device shows a {design.light} design only dimmed, or not at all: give the folder "
            "of its patterns in place of its file"
        )
    down, across = design.image_shape if len(design.image_shape) == 2 else (1, *design.image_shape)
    device = Device(name="none", columns=across, rows=down, settle_us=0)
    pictures = [max(1, round(share * PASS_US)) for share in counted.shares.tolist()]
    sentinel = math.ceil(PASS_US * float(counted.shares.mean()))
    hashes = ["0" * 64] * (len(pictures) + SENTINELS)
    fixed = replace(design, looks=None)
    settings = {"device": device, "selection": "ordered", "format": "npy"}
    return list_frames(fixed, counted, (pictures, sentinel), hashes, **settings)
