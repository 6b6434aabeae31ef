"""A design as an ONNX graph: counts and budget in, class probabilities out, no torch needed.

Torch traces the design itself, and the graph is compared with it before it is given.
"""

import copy
import io
import json
import warnings
from importlib.metadata import version
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from deepfsi.base.errors import InputError
from deepfsi.design.design import Design
from deepfsi.design.networks import Mlp
from deepfsi.exposure.training_set import check_classes
from deepfsi.physics.surroundings import library_defaults

OUTPUT = "probabilities"
"""Name of the output of a graph."""

LARGEST_ERROR = 1e-3
"""Largest difference of a probability between a graph and torch."""


class _Module(nn.Module):
    """A design as a module, from counts and budgets to probabilities."""

    def __init__(self, design: Design) -> None:
        super().__init__()
        assert design.classifier is not None
        self.classifier = design.classifier
        self.design = design

    @property
    def inputs(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the inputs by name, without the batch."""
        return {"counts": self.design.counts_shape, "photons": ()}

    def forward(self, counts: Tensor, photons: Tensor) -> Tensor:
        budget = photons.unsqueeze(-1)
        exposure = self.design.mask_exposure
        features = exposure.features(counts) / exposure.scale(budget)
        return self.design.answer(features, budget).chances


@library_defaults()
def to_onnx(design: Design) -> bytes:
    """Write a design as an ONNX graph that does what `Design.classify` does."""
    try:
        import onnx
        import onnxruntime  # noqa: F401
    except ImportError:
        raise InputError(
            "an ONNX graph is written with the package onnx: pip install onnx onnxruntime"
        ) from None
    check_classes(design.values, "an ONNX graph")
    design.exposure.check("graph")
    module = _Module(copy.deepcopy(design).to("cpu")).eval()
    module(*(torch.ones(1, *shape) for shape in module.inputs.values()))
    # every runtime since 2020 has 13; a network of one's own may need more
    model = onnx.load_from_string(_traced(module, 13 if isinstance(design.classifier, Mlp) else 17))
    about = {key: json.dumps(value) for key, value in _metadata(design).items()}
    onnx.helper.set_model_props(model, about)
    model.producer_name = "deepfsi"
    model.producer_version = version("deepfsi")
    onnx.checker.check_model(model, full_check=True)
    content = model.SerializeToString(deterministic=True)
    _compare(content, module)
    return content


def _traced(module: _Module, opset: int) -> bytes:
    """Graph of a module as torch writes it, or `InputError` if torch cannot."""
    written = io.BytesIO()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch's other exporter needs a package more
            torch.onnx.export(
                module, tuple(torch.ones(2, *shape) for shape in module.inputs.values()), written,  # type: ignore[arg-type]
                dynamo=False, input_names=list(module.inputs), output_names=[OUTPUT],
                opset_version=opset,
                dynamic_axes={name: {0: "batch"} for name in [*module.inputs, OUTPUT]},
            )  # fmt: skip
    except Exception as error:
        told = " ".join(str(error).split())[:200]
        raise InputError(f"the classifier cannot be exported, torch says: {told}") from error
    return written.getvalue()


def _compare(content: bytes, module: _Module) -> None:
    """Raise `InputError` unless a graph gives what torch does: a trace follows one path only."""
    import onnxruntime

    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    design = module.design
    generator = torch.Generator().manual_seed(0)
    shape = design.counts_shape
    for batch in (*[1] * 8, 7):
        photons = 10 ** (6 * torch.rand(batch, 1, generator=generator))
        scaled = torch.randn(batch, *shape, generator=generator)
        counts = (design.exposure.shares.mean() * (1 + scaled)).relu() * photons.view(
            -1, *[1] * len(shape)
        )
        budget = photons.squeeze(1)
        with torch.no_grad():
            wanted = module(counts, budget)
        [given] = session.run(None, {"counts": counts.numpy(), "photons": budget.numpy()})
        if given.shape != wanted.shape or np.abs(given - wanted.numpy()).max() > LARGEST_ERROR:
            raise InputError(
                "the classifier's ONNX graph does not give what the classifier does: write its "
                "forward without conditions on values or on the size of the batch"
            )


def _metadata(design: Design) -> dict[str, Any]:
    """Metadata of a design's graph, JSON types only."""
    masks = design.mask_exposure
    return {
        "schema": 1,  # of inputs, output and metadata
        "name": design.name,
        "masks": design.masks,
        "rails": design.rails.count,
        "detectors": masks.detection.count,
        "readout": masks.detection.readout,
        "light": masks.light,
        "summed_reflectance": design.summed_reflectance,
        "image_shape": list(design.image_shape),
        "classes": list(design.classes),
    }
