"""A design as an ONNX graph: counts and budget in, class probabilities out, no torch needed.

Torch traces the design itself; answers of graph and design are compared before it is returned.
"""

import copy
import io
import json
import warnings
from importlib.metadata import version

import numpy as np
import torch
from torch import Tensor, nn

from deepfsi.base.errors import InputError
from deepfsi.design.design import Design
from deepfsi.exposure.training_set import check_classes
from deepfsi.physics.surroundings import library_defaults

OUTPUT = "probabilities"
"""Name of the output of a graph."""


class _Graph(nn.Module):
    """A design as a module, from counts (batch, ...) and budgets (batch,) to probabilities."""

    def __init__(self, design: Design) -> None:
        super().__init__()
        self.classifier = design.classifier
        self.design = design

    def forward(self, counts: Tensor, photons: Tensor) -> Tensor:
        budget = photons.unsqueeze(-1)
        features = self.design.mask_exposure.features(counts, budget)
        return self.design.answer(features, budget).probabilities


@library_defaults(grad=False)
def to_onnx(design: Design) -> bytes:
    """Write a design as an ONNX graph that does what `Design.classify` does."""
    try:
        import onnx
        import onnxruntime
    except ImportError:
        raise InputError(
            "an ONNX graph is written with the package onnx: pip install onnx onnxruntime"
        ) from None
    check_classes(design.values, "an ONNX graph")
    design.exposure.check("graph")
    graph = _Graph(copy.deepcopy(design).to("cpu")).eval()
    shape = design.counts_shape
    inputs = {"counts": torch.ones(2, *shape), "photons": torch.ones(2)}
    graph(**inputs)  # a classifier that fails says so here
    written = io.BytesIO()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch's other exporter needs a package more
            torch.onnx.export(
                graph,
                tuple(inputs.values()),
                written,  # type: ignore[arg-type]
                dynamo=False,
                input_names=list(inputs),
                output_names=[OUTPUT],
                opset_version=17,
                dynamic_axes={name: {0: "batch"} for name in [*inputs, OUTPUT]},
            )
    except Exception as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"the classifier cannot be exported, torch says: {reason}") from error
    model = onnx.load_from_string(written.getvalue())
    metadata = {
        "schema": 1,  # of inputs, output and metadata
        "name": design.name,
        "image_shape": design.image_shape,
        "classes": design.classes,
    }
    onnx.helper.set_model_props(model, {key: json.dumps(value) for key, value in metadata.items()})
    model.producer_name = "deepfsi"
    model.producer_version = version("deepfsi")
    onnx.checker.check_model(model, full_check=True)
    content = model.SerializeToString(deterministic=True)
    # a trace follows one path through the code: compare its answers, for one exposure and for many
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    generator = torch.Generator().manual_seed(0)
    for batch in (*[1] * 8, 7):
        photons = 10 ** (6 * torch.rand(batch, generator=generator))
        scaled = 1 + torch.randn(batch, *shape, generator=generator)
        light = photons.view(-1, *[1] * len(shape)) * design.exposure.shares.mean().cpu()
        counts = scaled.relu() * light
        expected = graph(counts, photons).numpy()
        [answers] = session.run(None, {"counts": counts.numpy(), "photons": photons.numpy()})
        if answers.shape != expected.shape or np.abs(answers - expected).max() > 1e-3:
            raise InputError(
                "the classifier's ONNX graph does not give what the classifier does: write its "
                "forward without conditions on values or on the size of the batch"
            )
    return content
