"""A design as an ONNX graph: counts and budget in, class probabilities out, no torch needed."""

import io
import json
import warnings
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from deepfsi.design.artifact import Design
from deepfsi.design.classifiers import Mlp
from deepfsi.design.exposure.looks import LARGEST_SCORE, LooksExposure
from deepfsi.design.own import OwnClassifier
from deepfsi.errors import InputError
from deepfsi.optics.dwells import ROUNDING

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
    """Write a design as an ONNX graph that does what `Design.classify` does."""
    graph = _Graph()
    if not isinstance(design.classifier, Mlp | OwnClassifier):
        raise InputError(
            f"a {type(design.classifier).__name__} classifier cannot be exported: only Mlp and "
            "OwnClassifier can"
        )
    design.exposure.check_frames()
    inputs: dict[str, Shape] = {"counts": design.counts_shape, "photons": ()}
    outputs: dict[str, Shape] = {"probabilities": (len(design.classes),)}
    if isinstance(design.exposure, LooksExposure):
        if isinstance(design.classifier, OwnClassifier):
            raise InputError("a classifier of one's own cannot be exported with several looks")
        _write_looks(design, design.exposure, design.classifier, graph)
        dwells = design.exposure.dwells.shape
        inputs |= {"dwell": dwells, "left": (), "shortest": ()}
        return graph.finish(inputs, outputs | {"next": dwells}, _metadata(design))
    if isinstance(design.classifier, OwnClassifier):
        return _traced(design, graph.onnx)
    _write(design, design.classifier, graph)
    return graph.finish(inputs, outputs, _metadata(design))


def _write(design: Design, classifier: Mlp, graph: "_Graph") -> None:
    """Write the nodes of a design from its inputs to its output."""
    shares, budget = _write_features(design, graph)
    centred = graph.add("Sub", shares, graph.constant("mean", design.mean.cpu()), to="centred")
    hidden = graph.add("Div", centred, graph.constant("std", design.std.cpu()), to="scaled")
    layers = [list(each) for each in classifier.arrays]
    *layers[0], level = design.exposure.fold(design.masks, *layers[0])
    if level is not None:
        ratio = graph.add("Div", budget, graph.constant("unit", level.unit), to="ratio")
        log = graph.add("Log", ratio, to="log")
        above = graph.add("Sub", log, graph.constant("middle", level.middle), to="above")
        column = graph.add("Div", above, graph.constant("half", level.half), to="level")
        hidden = graph.add("Concat", hidden, column, to="conditioned", axis=1)
    graph.add("Softmax", graph.network("", layers, hidden), to="probabilities", axis=1)


def _write_looks(design: Design, exposure: LooksExposure, classifier: Mlp, graph: "_Graph") -> None:
    """Write the nodes of a design of several looks: what `adaptive.expose` does in one look."""
    shares, _ = _write_features(design, graph)
    dwells, flat = exposure.dwells, "dwell"
    if dwells.each_rail:
        flat = graph.add("Transpose", "dwell", to="dwell_by_mask", perm=[0, 2, 1])
    flat = graph.add("Flatten", flat, to="dwells", axis=1)
    relative = graph.add("Mul", flat, graph.constant("frames", dwells.count), to="relative")
    places = np.repeat(np.arange(dwells.count), design.features // dwells.count)
    each = graph.add("Gather", relative, graph.index("frame_of", places), to="each", axis=1)
    expected = graph.add("Mul", each, graph.constant("mean", design.mean.cpu()), to="expected")
    centred = graph.add("Sub", shares, expected, to="centred")
    scaled = graph.add("Div", centred, graph.constant("std", design.std.cpu()), to="scaled")
    third = graph.add("Div", relative, graph.constant("three", 3), to="third")
    seen = graph.add("Concat", scaled, third, to="seen", axis=1)
    logits = graph.network("", classifier.arrays, seen)
    graph.add("Softmax", logits, to="probabilities", axis=1)
    left = graph.add("Unsqueeze", "left", graph.index("column", [1]), to="left_column")
    chosen = graph.add("Concat", seen, left, to="chooser_inputs", axis=1)
    scores = graph.network("chooser_", exposure.network.arrays, chosen)
    bound = graph.constant("largest_score", LARGEST_SCORE)
    inner = graph.add("Tanh", graph.add("Div", scores, bound, to="bent"), to="tanh")
    weights = graph.add("Softmax", graph.add("Mul", inner, bound, to="bounded"), to="w", axis=1)
    asked = graph.add("Div", weights, graph.constant("looks", exposure.looks), to="asked")
    shown = _share_out(graph, asked, dwells.count, exposure.shortest)
    if dwells.each_rail:
        shape = graph.index("pair_shape", [0, dwells.masks, 2])
        graph.add("Transpose", graph.add("Reshape", shown, shape, to="pairs"), to="next",
                  perm=[0, 2, 1])  # fmt: skip
    else:
        graph.add("Identity", shown, to="next")


def _share_out(graph: "_Graph", asked: str, frames: int, shortest: float) -> str:
    """Write the nodes of `live.dwells.share_out` for dwells (batch, q); the name of its result."""
    # Frames are sorted, the longest first, which is shown in any case; those that are long enough
    # are the first ones
    axis = graph.index("axis", [1])
    column = graph.add("Unsqueeze", "shortest", axis, to="shortest_column")
    least = graph.add("Max", column, graph.constant("learned_for", [[shortest]]), to="least")
    count = graph.index("frame_count", [frames])
    sort = graph.onnx.helper.make_node("TopK", [asked, count], ["longest_first", "order"], axis=1)
    graph.nodes.append(sort)
    total = graph.add("ReduceSum", asked, axis, to="total", keepdims=1)
    given = graph.add("Mul", "longest_first", total, to="given")
    sums = graph.add("CumSum", "longest_first", graph.index("along", 1), to="sums")
    bar = graph.add("Mul", least, graph.constant("slack", 1 - ROUNDING), to="bar")
    short = graph.add("Less", given, graph.add("Mul", sums, bar, to="needed"), to="short")
    others = graph.constant("others", [[place > 0 for place in range(frames)]], np.bool_)
    dropped = graph.add("And", short, others, to="dropped")
    zero = graph.constant("zero", 0)
    kept = graph.add("Where", dropped, zero, "longest_first", to="kept")
    nothing = graph.add("Mul", asked, zero, to="nothing")
    shown = graph.add("ScatterElements", nothing, "order", kept, to="shown", axis=1)
    lit = graph.add("ReduceSum", shown, axis, to="shown_total", keepdims=1)
    return graph.add("Mul", shown, graph.add("Div", total, lit, to="more"), to="shared")


def _write_features(design: Design, graph: "_Graph") -> tuple[str, str]:
    """Write the nodes from counts to features over the budget; their name, and the budget's."""
    features = "counts"
    if design.rails.count == 2 and design.detection.readout == "both":
        order = [0, 2, 1, 3][: 1 + len(design.counts_shape)]
        features = graph.add("Transpose", "counts", to="by_mask", perm=order)
    elif design.rails.count == 2:
        for place, rail in enumerate(("plus", "minus")):
            graph.add("Gather", "counts", graph.index(f"{rail}_at", place), to=rail, axis=1)
        features = graph.add("Sub", "plus", "minus", to="differences")
    features = graph.add("Flatten", features, to="features", axis=1)
    budget = graph.add("Unsqueeze", "photons", graph.index("columns", [1]), to="budget")
    shares = graph.add("Div", features, budget, to="shares")
    return shares, budget


class _Graph:
    """ONNX graph in the making, of nodes and constants with names."""

    def __init__(self) -> None:
        try:
            import onnx
        except ImportError:
            raise InputError(
                "an ONNX graph is written with the package onnx: pip install onnx onnxruntime"
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

    def network(self, name: str, layers: Sequence[Sequence[np.ndarray]], hidden: str) -> str:
        """Add layers of weights (outputs, inputs) and biases, each with ReLU but the last."""
        for place, (weight, bias) in enumerate(layers):
            pair = (
                self.constant(f"{name}weight_{place}", weight.T),
                self.constant(f"{name}bias_{place}", bias),
            )
            hidden = self.add("Gemm", hidden, *pair, to=f"{name}linear_{place}")
            if place < len(layers) - 1:
                hidden = self.add("Relu", hidden, to=f"{name}hidden_{place}")
        return hidden

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
        "rails": design.rails.count,
        "detectors": design.detection.count,
        "readout": design.detection.readout,
        "light": design.light,
        "summed_reflectance": design.summed_reflectance,
        "image_shape": list(design.image_shape),
        "classes": list(design.classes),
        "looks": design.exposure.looks,
    }
