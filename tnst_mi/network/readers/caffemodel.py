"""Caffe's `.caffemodel`: a NetParameter message (caffe.proto) whose layers carry their weights as blobs."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from tnst_mi.machine.terminal import quoted
from tnst_mi.network.readers.network_weights import CLASSIFIER, MalformedFile, NetworkWeights
from tnst_mi.network.readers.protobuf import Message

# NetParameter holds `layer` (100), or in files older than 2015 `layers` (2); each with its own field numbers.
_LAYER_FORMATS = ((100, 1, 7), (2, 4, 6))
"""(field of NetParameter, field of the layer's name, field of its blobs)."""

_AUXILIARY = ("loss1/", "loss2/")
"""The two auxiliary classifiers, used only in training."""


def read_caffemodel(data: bytes) -> NetworkWeights:
    """The weights of BVLC GoogLeNet; raises `MalformedFile`."""
    network = Message(memoryview(data))
    tensors: dict[str, Tensor] = {}
    for layers_field, name_field, blobs_field in _LAYER_FORMATS:
        for layer in network.messages(layers_field):
            name, blobs = layer.text(name_field), layer.messages(blobs_field)
            if not blobs or name.startswith(_AUXILIARY):
                continue
            if len(blobs) != 2:
                raise MalformedFile(
                    f"weights of another network: layer {quoted(name)} has {len(blobs)} blobs, expected 2"
                )
            weight, bias = (_blob(blob, name) for blob in blobs)
            # Old files give every blob four axes: a matrix is (1, 1, rows, columns), a vector (1, 1, 1, n).
            matrix = name == CLASSIFIER and weight.ndim == 4
            tensors[f"{name}.weight"] = weight.flatten(0, 2) if matrix else weight
            tensors[f"{name}.bias"] = bias.reshape(-1)
    return NetworkWeights("bvlc", tensors)


def _blob(blob: Message, layer: str) -> Tensor:
    """A BlobProto: shape.dim (7.1), or num, channels, height, width (1 to 4) in old files; data (5)."""
    values = blob.floats(5)
    if shapes := blob.messages(7):
        shape = shapes[-1].integers(1)
    else:
        shape = [(blob.integers(axis) or [0])[-1] for axis in (1, 2, 3, 4)]
    if math.prod(shape) != values.size or values.size == 0 or len(shape) > 4:
        raise MalformedFile(f"layer {quoted(layer)} states the shape {shape} for {values.size} values")
    return torch.from_numpy(values).reshape(shape)
