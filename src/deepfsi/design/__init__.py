"""Finished designs: masks and network in one object, its file, and its graph."""

from deepfsi.design.design import Design, load_design
from deepfsi.design.judgement import RunCounts, judge
from deepfsi.design.onnx import to_onnx
from deepfsi.design.readouts import READOUT_PHOTONS, classify_readouts

__all__ = [
    "READOUT_PHOTONS",
    "Design",
    "RunCounts",
    "classify_readouts",
    "judge",
    "load_design",
    "to_onnx",
]
