"""A design as an ONNX graph: counts and budget in, class probabilities out, no torch needed."""

import json
import math
from importlib.metadata import version
from typing import Any

import numpy as np

from deepfsi.design.artifact import Design
from deepfsi.design.classifiers import Mlp
from deepfsi.errors import InputError

SCHEMA = 1
"""Of what the graph takes and gives, and of its metadata."""

OPSET, IR = 13, 7
"""Old enough for every runtime since 2020, and all that the graph needs."""


def to_onnx(design: Design) -> bytes:
    """Write a design as an ONNX graph that does what `Design.classify` does.

    Parameters
    ----------
    design : Design
        With an `Mlp`.

    Returns
    -------
    bytes
        Content of an ``.onnx`` file. Its inputs are float32 ``counts``, (batch, 2, m) for dual-rail
        designs and (batch, m) for single-rail ones, and ``photons``, (batch,), each finite and the
        budgets above 0, which the graph does not check; its output ``probabilities``, (batch, C).
        Metadata: `metadata`, each value as JSON.

    Raises
    ------
    InputError
        If the package onnx is not there, the classifier is not an `Mlp`, or dwells are not fixed.
    """
    try:
        from onnx import TensorProto, checker, helper, numpy_helper
    except ImportError:
        raise InputError(
            "an ONNX graph is written with the package onnx: pip install 'deepfsi[onnx]'"
        ) from None
    if not isinstance(design.classifier, Mlp):
        raise InputError(
            f"a {type(design.classifier).__name__} classifier cannot be exported: only Mlp can"
        )
    design.check_fixed()
    dual, masks, classes = len(design.rails) == 2, design.masks, len(design.classes)
    nodes, constants = [], []

    def constant(name: str, value: Any, kind: type = np.float32) -> str:
        constants.append(numpy_helper.from_array(np.asarray(value, dtype=kind), name))
        return name

    def add(operation: str, *inputs: str, to: str, **settings: Any) -> str:
        nodes.append(helper.make_node(operation, inputs, [to], **settings))
        return to

    features = "counts"
    if dual:
        for place, rail in enumerate(("plus", "minus")):
            add("Gather", "counts", constant(f"{rail}_at", place, np.int64), to=rail, axis=1)
        features = add("Sub", "plus", "minus", to="features")
    budget = add("Unsqueeze", "photons", constant("columns", [1], np.int64), to="budget")
    shares = add("Div", features, budget, to="shares")
    centred = add("Sub", shares, constant("mean", design.mean.cpu()), to="centred")
    hidden = add("Div", centred, constant("std", design.std.cpu()), to="scaled")
    layers = [
        [parameter.detach().cpu().numpy() for parameter in layer.parameters()]
        for layer in design.classifier.layers
    ]
    if told := design.told:
        middle = math.log(told.span) / 2
        ratio = add("Div", budget, constant("unit", design.used * told.photons), to="ratio")
        log = add("Log", ratio, to="log")
        above = add("Sub", log, constant("middle", middle), to="above")
        level = add("Div", above, constant("half", max(middle, 1.0)), to="level")
        hidden = add("Concat", hidden, level, to="told", axis=1)
        # masks not shown read 0, and how many are is one number for a design: both fold away
        weight, bias = layers[0]
        layers[0] = [
            np.hstack([weight[:, :masks], weight[:, -2:-1]]),
            bias + weight[:, -1] * np.float32(masks / told.masks),
        ]
    for place, (weight, bias) in enumerate(layers):
        pair = constant(f"weight_{place}", weight.T), constant(f"bias_{place}", bias)
        hidden = add("Gemm", hidden, *pair, to=f"linear_{place}")
        if place < len(layers) - 1:
            hidden = add("Relu", hidden, to=f"hidden_{place}")
    add("Softmax", hidden, to="probabilities", axis=1)

    def value(name: str, *shape: int) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", *shape])

    graph = helper.make_graph(
        nodes,
        "deepfsi",
        [value("counts", *((2, masks) if dual else (masks,))), value("photons")],
        [value("probabilities", classes)],
        constants,
    )
    model = helper.make_model(
        graph,
        ir_version=IR,
        opset_imports=[helper.make_opsetid("", OPSET)],
        producer_name="deepfsi",
        producer_version=version("deepfsi"),
    )
    helper.set_model_props(model, {k: json.dumps(v) for k, v in metadata(design).items()})
    checker.check_model(model, full_check=True)
    return model.SerializeToString(deterministic=True)


def metadata(design: Design) -> dict[str, Any]:
    """What a graph says of its design, JSON types only."""
    return {
        "schema": SCHEMA,
        "name": design.name,
        "masks": design.masks,
        "rails": len(design.rails),
        "light": design.light,
        "summed_reflectance": design.summed_reflectance,
        "image_shape": list(design.image_shape),
        "classes": list(design.classes),
    }
