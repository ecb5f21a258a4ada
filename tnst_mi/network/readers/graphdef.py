"""TensorFlow's frozen `GraphDef` (.pb) of Inception5h: weights are `Const` nodes, LRN constants attributes.

Field numbers: TensorFlow's graph.proto, node_def.proto, attr_value.proto, tensor.proto, tensor_shape.proto.
"""

from __future__ import annotations

import math
import re

import numpy as np
import torch

from tnst_mi.machine.terminal import quoted
from tnst_mi.network.readers.network_weights import (
    CLASSIFIER,
    CONVOLUTIONS,
    MalformedFile,
    NetworkWeights,
    ResponseNorm,
    tensorflow_name,
)
from tnst_mi.network.readers.protobuf import Message

_FLOAT32 = 1
_AUXILIARY = re.compile(r"(head|nn|softmax)[01]_")
"""The two auxiliary classifiers, used only in training."""


def read_graphdef(data: bytes) -> NetworkWeights:
    """The weights of Inception5h and the constants of its two normalisations; raises `MalformedFile`."""
    layers = {tensorflow_name(layer): layer for layer in (*CONVOLUTIONS, CLASSIFIER)}
    tensors, response_norms = {}, {}
    for node in Message(memoryview(data)).messages(1):
        name, operation = node.text(1), node.text(2)
        if operation == "LRN":
            response_norms[name] = _response_norm(_attributes(node))
        if operation != "Const" or not name.endswith(("_w", "_b")) or _AUXILIARY.match(name):
            continue
        values = _constant(_attributes(node), name)
        layer = layers.get(name[:-2], name[:-2])
        kind = "weight" if name.endswith("_w") else "bias"
        # TensorFlow orders axes (rows, columns, in, out), torch (out, in, rows, columns).
        axes = {4: (3, 2, 0, 1), 2: (1, 0), 1: (0,)}.get(values.ndim)
        if axes is None:
            raise MalformedFile(f"node {quoted(name)} has {values.ndim} axes")
        tensors[f"{layer}.{kind}"] = torch.from_numpy(np.ascontiguousarray(values.transpose(axes)))
    first, second = (response_norms.get(f"localresponsenorm{index}") for index in (0, 1))
    if first is None or second is None:
        raise MalformedFile("weights of another network: no nodes 'localresponsenorm0' and 'localresponsenorm1'")
    return NetworkWeights("inception5h", tensors, response_norms=(first, second))


def _attributes(node: Message) -> dict[str, Message]:
    """NodeDef.attr (5), a map: key (1), value (2)."""
    attributes = {}
    for entry in node.messages(5):
        values = entry.messages(2)
        attributes[entry.text(1)] = values[-1] if values else Message(memoryview(b""))
    return attributes


def _response_norm(attributes: dict[str, Message]) -> ResponseNorm:
    """The attributes of an LRN node; an absent one takes the default of TensorFlow's operation."""

    def number(name: str, default: float) -> float:
        values = attributes[name].floats(4) if name in attributes else np.empty(0)
        return float(values[-1]) if values.size else default

    radius = attributes["depth_radius"].integers(3) if "depth_radius" in attributes else []
    norm = ResponseNorm(
        depth_radius=radius[-1] if radius else 5,
        bias=number("bias", 1.0),
        alpha=number("alpha", 1.0),
        beta=number("beta", 0.5),
    )
    if not (norm.depth_radius < 1000 and norm.bias > 0 and norm.alpha >= 0 and math.isfinite(norm.bias + norm.alpha)):
        raise MalformedFile(f"impossible constants of local response normalisation: {norm}")
    return norm


def _constant(attributes: dict[str, Message], name: str) -> np.ndarray:
    """The TensorProto (AttrValue 8) of a Const node: dtype 1, shape 2, raw bytes 4 or a list of floats 5."""
    tensors = attributes["value"].messages(8) if "value" in attributes else []
    if not tensors or tensors[-1].integers(1) != [_FLOAT32]:
        raise MalformedFile(f"node {quoted(name)} is not a float32 constant")
    tensor = tensors[-1]
    shape = [size for part in tensor.messages(2) for axis in part.messages(2) for size in axis.integers(1)]
    values = tensor.floats(4) if tensor.byte_ranges(4) else tensor.floats(5)
    if math.prod(shape) != values.size or values.size == 0 or len(shape) > 4:
        raise MalformedFile(f"node {quoted(name)} states the shape {shape} for {values.size} values")
    return values.reshape(shape)
