"""A design as an ONNX graph: counts and budget in, class probabilities out, no torch needed."""

import io
import json
import warnings
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from deepfsi.design.artifact import Design
from deepfsi.design.classifiers import Mlp
from deepfsi.design.own import OwnClassifier
from deepfsi.errors import InputError

SCHEMA = 1
"""Number of the schema of the graph's inputs, output and metadata."""

OPSET, IR = 13, 7
"""Old enough for every runtime since 2020, and all that the graph needs."""

TRACED_OPSET = 17
"""Of a graph that torch traces."""

TRACED_ERROR = 1e-3
"""Largest difference of a probability between such a graph and torch."""

Shape = tuple[int, ...]


def to_onnx(design: Design) -> bytes:
    """Write a design as an ONNX graph that does what `Design.classify` does.

    Parameters
    ----------
    design : Design
        With an `Mlp`, or a module of one's own, which torch traces.

    Returns
    -------
    bytes
        Content of an ``.onnx`` file. Its inputs are float32 ``counts``, (batch, 2, m) for dual-rail
        designs and (batch, m) for single-rail ones, with D numbers each of D detectors, and
        ``photons``, (batch,), each finite and the budgets above 0, which the graph does not check;
        its output ``probabilities``, (batch, C). Metadata: each value as JSON.

    Raises
    ------
    InputError
        If the package onnx is not there, or the classifier cannot be exported.
    """
    graph = _Graph()
    if not isinstance(design.classifier, Mlp | OwnClassifier):
        raise InputError(
            f"a {type(design.classifier).__name__} classifier cannot be exported: only Mlp and "
            "OwnClassifier can"
        )
    design.exposure.check_frames()
    if design.exposure.looks > 1:
        raise InputError(
            "this design chooses dwells while the exposure runs, which one graph cannot: use "
            "Design.classify_live, or `deepfsi dmd export`"
        )
    if isinstance(design.classifier, OwnClassifier):
        return _traced(design, graph.onnx)
    _write(design, design.classifier, graph)
    return graph.finish(
        {"counts": design.counts_shape, "photons": ()},
        {"probabilities": (len(design.classes),)},
        _metadata(design),
    )


def _write(design: Design, classifier: Mlp, graph: "_Graph") -> None:
    """Write the nodes of a design from its inputs to its output."""
    features = "counts"
    if len(design.rails) == 2 and design.detection.readout == "both":
        order = [0, 2, 1, 3][: 1 + len(design.counts_shape)]
        features = graph.add("Transpose", "counts", to="by_mask", perm=order)
    elif len(design.rails) == 2:
        for place, rail in enumerate(("plus", "minus")):
            graph.add("Gather", "counts", graph.index(f"{rail}_at", place), to=rail, axis=1)
        features = graph.add("Sub", "plus", "minus", to="differences")
    features = graph.add("Flatten", features, to="features", axis=1)
    budget = graph.add("Unsqueeze", "photons", graph.index("columns", [1]), to="budget")
    shares = graph.add("Div", features, budget, to="shares")
    centred = graph.add("Sub", shares, graph.constant("mean", design.mean.cpu()), to="centred")
    hidden = graph.add("Div", centred, graph.constant("std", design.std.cpu()), to="scaled")
    layers = [
        [parameter.detach().cpu().numpy() for parameter in layer.parameters()]
        for layer in classifier.layers
    ]
    *layers[0], level = design.exposure.fold(design.masks, *layers[0])
    if level is not None:
        ratio = graph.add("Div", budget, graph.constant("unit", level.unit), to="ratio")
        log = graph.add("Log", ratio, to="log")
        above = graph.add("Sub", log, graph.constant("middle", level.middle), to="above")
        column = graph.add("Div", above, graph.constant("half", level.half), to="level")
        hidden = graph.add("Concat", hidden, column, to="conditioned", axis=1)
    for place, (weight, bias) in enumerate(layers):
        pair = graph.constant(f"weight_{place}", weight.T), graph.constant(f"bias_{place}", bias)
        hidden = graph.add("Gemm", hidden, *pair, to=f"linear_{place}")
        if place < len(layers) - 1:
            hidden = graph.add("Relu", hidden, to=f"hidden_{place}")
    graph.add("Softmax", hidden, to="probabilities", axis=1)


class _Graph:
    """ONNX graph in the making, of nodes and constants with names."""

    def __init__(self) -> None:
        try:
            import onnx
        except ImportError:
            raise InputError(
                "an ONNX graph is written with the package onnx: pip install 'deepfsi[onnx]'"
            ) from None
        self.onnx = onnx
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, name: str, value: Any, dtype: type = np.float32) -> str:
        """Add numbers, parameters as for `numpy.asarray`; returns their name."""
        array: Any = np.asarray(value, dtype=dtype)
        self.constants.append(self.onnx.numpy_helper.from_array(array, name))
        return name

    def index(self, name: str, value: Any) -> str:
        """Add whole numbers; returns their name."""
        return self.constant(name, value, np.int64)

    def add(self, operation: str, *inputs: str, to: str, **settings: Any) -> str:
        """Add a node; returns the name of its output, `to`."""
        self.nodes.append(self.onnx.helper.make_node(operation, inputs, [to], **settings))
        return to

    def finish(
        self, inputs: Mapping[str, Shape], outputs: Mapping[str, Shape], about: Mapping[str, Any]
    ) -> bytes:
        """Content of the ``.onnx`` file; parameters as of a graph, shapes without its batch."""
        helper = self.onnx.helper

        def values(shapes: Mapping[str, Shape]) -> list[Any]:
            kind = self.onnx.TensorProto.FLOAT
            return [
                helper.make_tensor_value_info(name, kind, ["batch", *shape])
                for name, shape in shapes.items()
            ]

        graph = helper.make_graph(
            self.nodes, "deepfsi", values(inputs), values(outputs), self.constants
        )
        model = helper.make_model(
            graph,
            ir_version=IR,
            opset_imports=[helper.make_opsetid("", OPSET)],
            producer_name="deepfsi",
            producer_version=version("deepfsi"),
        )
        helper.set_model_props(model, {key: json.dumps(value) for key, value in about.items()})
        self.onnx.checker.check_model(model, full_check=True)
        return model.SerializeToString(deterministic=True)


class _Whole(nn.Module):
    """A design as a module, from counts and budgets to probabilities."""

    def __init__(self, design: Design) -> None:
        super().__init__()
        self.classifier, self.design = design.classifier, design

    def forward(self, counts: Tensor, photons: Tensor) -> Tensor:
        features = self.design.features_of(counts)
        return self.design.logits(features, photons.unsqueeze(-1)).softmax(dim=-1)


def _traced(design: Design, onnx: Any) -> bytes:
    """Graph of a design with a module of one's own, compared with torch before it is given."""
    whole = _Whole(design.to("cpu")).eval()
    whole.classifier(torch.zeros(1, design.exposure.input_count(design.features)))
    shape = design.counts_shape
    names = ["counts", "photons", "probabilities"]
    written = io.BytesIO()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch's other exporter needs a package more
            torch.onnx.export(
                whole, (torch.ones(2, *shape), torch.ones(2)), written, dynamo=False,  # type: ignore[arg-type]
                input_names=names[:2], output_names=names[2:], opset_version=TRACED_OPSET,
                dynamic_axes={name: {0: "batch"} for name in names},
            )  # fmt: skip
    except Exception as error:
        told = " ".join(str(error).split())[:200]
        raise InputError(
            f"the classifier {design.classifier.title} cannot be exported, torch says: {told}"
        ) from error
    model = onnx.load_from_string(written.getvalue())
    onnx.helper.set_model_props(
        model, {key: json.dumps(value) for key, value in _metadata(design).items()}
    )
    model.producer_name, model.producer_version = "deepfsi", version("deepfsi")
    onnx.checker.check_model(model, full_check=True)
    content = model.SerializeToString(deterministic=True)
    _compare(content, whole)
    return content


def _compare(content: bytes, whole: _Whole) -> None:
    """Raise `InputError` unless a graph gives what torch does: a trace follows one path only."""
    import onnxruntime

    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    design, generator = whole.design, torch.Generator().manual_seed(0)
    shape = design.counts_shape
    for batch in (*[1] * 8, 7):
        photons = 10 ** (6 * torch.rand(batch, 1, generator=generator))
        scaled = torch.randn(batch, *shape, generator=generator)
        counts = (design.shares.mean() * (1 + scaled)).relu() * photons.view(-1, *[1] * len(shape))
        photons = photons.squeeze(1)
        given = {"counts": counts.numpy(), "photons": photons.numpy()}
        with torch.no_grad():
            wanted = whole(counts, photons).numpy()
        [found] = session.run(None, given)
        if found.shape != wanted.shape or np.abs(found - wanted).max() > TRACED_ERROR:
            raise InputError(
                "the classifier's ONNX graph does not give what the classifier does: write its "
                "forward without conditions on values or on the size of the batch"
            )


def _metadata(design: Design) -> dict[str, Any]:
    """Metadata of a design's graph, JSON types only."""
    return {
        "schema": SCHEMA,
        "name": design.name,
        "masks": design.masks,
        "rails": len(design.rails),
        "detectors": design.detection.count,
        "readout": design.detection.readout,
        "light": design.light,
        "summed_reflectance": design.summed_reflectance,
        "image_shape": list(design.image_shape),
        "classes": list(design.classes),
    }
