"""The file `loop.safetensors` in a folder of patterns: the networks of several looks, alone.

A live run reads the design that lies beside the patterns. Versions that had no reader of it without
torch read this file, which is written for them; folders without a design have nothing else.
"""

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field
from safetensors.numpy import save

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.models.strict import Count, Positive, StrictModel
from deepfsi.base.numeric.arrays import DamagedError, read_tensors
from deepfsi.camera.names import Readout
from deepfsi.camera.stop_rule import StopRule
from deepfsi.designfile.design_file import DAMAGED, DesignFile
from deepfsi.designfile.header import MaskHeader, MlpEntry
from deepfsi.jobs.exposures import LARGEST_SCORE, LooksEntry

LOOP_KEY = "deepfsi-loop"
"""Key of the header in the file's metadata."""

NETWORKS = {"classifier": "classifier.layers", "chooser": "exposure.layers"}
"""Networks of a loop by their names in a design file."""


class _LoopHeader(StrictModel):
    """Header of a loop's file: all but the numbers of its networks."""

    schema_version: Literal[2] = 2
    looks: int = Field(ge=2, le=64)  # K, each 1 / K of the exposure
    masks: Count  # m, 2 or 1, and D
    rails: Literal[1, 2]
    detectors: Count
    each_rail: bool  # whether the two rails of a mask are frames with dwells of their own
    readout: Readout  # what is read of two rails
    classes: tuple[str, ...] = Field(min_length=1)
    largest_score: float = Field(gt=0)  # bound of the scores whose softmax dwells are
    # Shortest dwell that the design was learned for, a share of the exposure
    shortest: float = Field(ge=0, lt=1)
    rule: StopRule | None = None  # of the design, where it has one
    # Budget that the design was trained at, counts of an exposure; none where that is not known
    photons: Positive | None = None


def loop_bytes(design: DesignFile) -> bytes:
    """Content of the loop's file of a design of several looks, or `InputError` if it has one."""
    header = design.mask_header
    entry = design.looks
    networks = {"classifier": design.classifier, "chooser": design.chooser}
    _ = design.first_dwell  # which is a number
    with as_input_error("the design"):
        about = _LoopHeader(
            looks=entry.looks,
            masks=design.masks,
            rails=2 if design.rail_count == 2 else 1,
            detectors=design.detector_count,
            each_rail=design.each_rail,
            readout=header.readout,
            classes=header.classes,
            largest_score=LARGEST_SCORE,
            shortest=entry.shortest,
            rule=design.stop_rule,
            photons=design.photons,
        )
    arrays = {name: design.arrays[name] for name in ("mean", "std")}
    for name, layers in networks.items():
        for place, (weight, bias) in enumerate(layers):
            arrays |= {f"{name}.{place}.weight": weight, f"{name}.{place}.bias": bias}
    for fitted in ("distribution", "scenes", "temperatures"):
        values = design.arrays_of(fitted)
        arrays |= {f"{fitted}.{name}": array for name, array in values.items()}
    whole = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    return save(whole, metadata={LOOP_KEY: about.model_dump_json()})


def read_loop(path: Path, rails: np.ndarray, **facts: Any) -> DesignFile:
    """Design of a loop's file, as its networks need it, beside patterns of rails (2 or 1, m, N)."""
    again = "export the patterns again"
    try:
        text, tensors = read_tensors(path, LOOP_KEY, again)
    except DamagedError:
        raise InputError(f"{path} is not a whole loop of a design: {again}") from None
    with as_input_error(str(path), again, text, schema=2):
        loop = _LoopHeader.model_validate_json(text)
    detectors = facts.pop("detectors", None)
    arrays = {"rails": np.asarray(rails, np.float32)}
    if detectors is not None:
        arrays["detectors"] = detectors
    for name, array in tensors.items():
        network, _, rest = name.partition(".")
        turned = np.ascontiguousarray(array.T) if rest.endswith(".weight") else array
        arrays[f"{NETWORKS[network]}.{rest}" if network in NETWORKS else name] = turned
    try:
        arrays["shares"] = np.zeros_like(arrays["mean"])  # which no look needs
        header = MaskHeader(
            name="deepfsi",
            readout=loop.readout,
            classes=loop.classes,
            exposure=LooksEntry(
                looks=loop.looks, hidden=_hidden(arrays, "exposure"), shortest=loop.shortest
            ),
            classifier=MlpEntry(kind="mlp", hidden=_hidden(arrays, "classifier"), dropout=0.0),
            info={"job": {"photons": loop.photons}} if loop.photons else {},
            **facts,
        )
        if loop.rule is not None:
            header.info["stopping"] = loop.rule.model_dump()
        made = DesignFile(header, arrays, path)
        made.check()
        sizes = (made.masks, made.rail_count, made.detector_count, made.each_rail, LARGEST_SCORE)
        if sizes != (loop.masks, loop.rails, loop.detectors, loop.each_rail, loop.largest_score):
            raise ValueError("the loop is of other patterns")
        _ = made.classifier, made.first_dwell  # which raise an error where they do not fit
    except DAMAGED:
        raise InputError(f"{path} has networks that do not fit its masks: {again}") from None
    return made


def _hidden(arrays: dict[str, np.ndarray], network: str) -> tuple[int, ...]:
    """Widths of the hidden layers of a network."""
    start = f"{network}.layers."
    count = sum(name.startswith(start) and name.endswith(".bias") for name in arrays)
    return tuple(len(arrays[f"{start}{place}.bias"]) for place in range(count - 1))
