"""GoogLeNets with random weights, in each file format, for tests that must run without the real weights."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import safetensors.numpy

STEM = {"conv1/7x7_s2": (64, 7), "conv2/3x3_reduce": (64, 1), "conv2/3x3": (192, 3)}
"""Layer: width, kernel."""

BLOCKS = {
    "3a": (64, 96, 128, 16, 32, 32),
    "3b": (128, 128, 192, 32, 96, 64),
    "4a": (192, 96, 208, 16, 48, 64),
    "4b": (160, 112, 224, 24, 64, 64),
    "4c": (128, 128, 256, 24, 64, 64),
    "4d": (112, 144, 288, 32, 64, 64),
    "4e": (256, 160, 320, 32, 128, 128),
    "5a": (256, 160, 320, 32, 128, 128),
    "5b": (384, 192, 384, 48, 128, 128),
}
"""Block: widths of 1x1, 3x3_reduce, 3x3, 5x5_reduce, 5x5, pool_proj (Szegedy et al. 2015, table 1)."""

INCEPTION5H_BLOCKS = BLOCKS | {"4a": (192, 96, 204, 16, 48, 64), "5a": (256, 160, 320, 48, 128, 128)}

PATTERN_CLASSES = (
    *("net, mesh", "spiral, swirl, vortex", "flower", "fire, flames", "cloud"),
    *("square", "ring", "honeycomb", "Julia set", "wood"),
)
"""Class names of the random network `patterns`; honeycomb is one of ImageNet's too."""

Tensors = dict[str, np.ndarray]


def random_tensors(flavour: str = "bvlc", seed: int = 0, narrow: int = 1) -> Tensors:
    """He-scaled weights and small biases under BVLC names; `narrow` divides all widths."""
    random = np.random.default_rng(seed)
    tensors: Tensors = {}

    def add(layer: str, outputs: int, *fan_in: int) -> int:
        scale = np.sqrt(2 / np.prod(fan_in), dtype=np.float32)
        tensors[f"{layer}.weight"] = scale * random.standard_normal((outputs, *fan_in), dtype=np.float32)
        tensors[f"{layer}.bias"] = 0.1 * random.standard_normal(outputs, dtype=np.float32)
        return outputs

    channels = 3
    for layer, (width, kernel) in STEM.items():
        channels = add(layer, max(width // narrow, 2), channels, kernel, kernel)
    large = 3 if flavour == "torchvision" else 5
    for block, widths in (INCEPTION5H_BLOCKS if flavour == "inception5h" else BLOCKS).items():
        one, reduce3, three, reduce5, five, pool = (max(width // narrow, 2) for width in widths)
        prefix = f"inception_{block}"
        for branch, width in (
            ("1x1", one),
            ("3x3_reduce", reduce3),
            ("5x5_reduce", reduce5),
            ("pool_proj", pool),
        ):
            add(f"{prefix}/{branch}", width, channels, 1, 1)
        add(f"{prefix}/3x3", three, reduce3, 3, 3)
        add(f"{prefix}/5x5", five, reduce5, large, large)
        channels = one + three + five + pool
    classes = {"inception5h": 1008, "patterns": len(PATTERN_CLASSES)}
    add("loss3/classifier", classes.get(flavour, 1000), channels)
    return tensors


def random_googlenet(path: Path, flavour: str = "bvlc", seed: int = 0, narrow: int = 1) -> Path:
    """Write a safetensors file with random weights under the flavour's own tensor names; returns `path`."""
    tensors = random_tensors(flavour, seed, narrow)
    if flavour == "inception5h":
        tensors = lucent_names(tensors)
    elif flavour == "torchvision":
        tensors = torchvision_state_dict(tensors, seed)
    elif flavour == "patterns":
        tensors = quantised(tensors)
    safetensors.numpy.save_file(tensors, path, pattern_metadata() if flavour == "patterns" else None)
    return path


def quantised(tensors: Tensors) -> Tensors:
    """The 8-bit form: each output channel's weights are integers from -127 to 127 times its scale."""
    renamed: Tensors = {}
    for name, tensor in tensors.items():
        layer, kind = name.rsplit(".", 1)
        if kind == "bias":
            renamed[name] = tensor
            continue
        rows = tensor.reshape(len(tensor), -1)
        scale = np.abs(rows).max(1) / np.float32(127)
        renamed[name] = np.rint(rows / scale[:, None]).astype(np.int8).reshape(tensor.shape)
        renamed[f"{layer}.scale"] = scale
    return renamed


def expanded(tensors: Tensors) -> Tensors:
    """The float32 tensors that the 8-bit form stands for."""
    whole = {name: tensor for name, tensor in tensors.items() if not name.endswith(".scale")}
    for name in whole:
        if name.endswith(".weight"):
            scale = tensors[f"{name.removesuffix('.weight')}.scale"]
            whole[name] = (whole[name].T * scale).T.astype(np.float32)
    return whole


def pattern_metadata(**changes: str) -> dict[str, str]:
    """The metadata of a file in the 8-bit form."""
    return {"flavour": "patterns", "classes": json.dumps(PATTERN_CLASSES)} | changes


def tensorflow_layer(layer: str) -> str:
    """`inception_4b/pool_proj` → `mixed4b_pool_reduce`."""
    if layer == "loss3/classifier":
        return "softmax2"
    if layer in STEM:
        return f"conv2d{list(STEM).index(layer)}"
    block, branch = layer.split("/")
    branches = {"3x3_reduce": "3x3_bottleneck", "5x5_reduce": "5x5_bottleneck", "pool_proj": "pool_reduce"}
    return f"mixed{block[-2:]}_{branches.get(branch, branch)}"


def lucent_names(tensors: Tensors) -> Tensors:
    """The tensors under the names that lucent's port of Inception5h gives them."""
    renamed = {}
    for name, tensor in tensors.items():
        layer, kind = name.rsplit(".", 1)
        suffix = "pre_activation_matmul" if layer == "loss3/classifier" else "pre_relu_conv"
        renamed[f"{tensorflow_layer(layer)}_{suffix}.{kind}"] = tensor
    return renamed


def torchvision_state_dict(tensors: Tensors, seed: int = 0) -> Tensors:
    """torchvision's tensors: the biases become batch normalisations with random statistics."""
    random = np.random.default_rng(seed + 1)
    branches = {
        "1x1": "branch1",
        "3x3_reduce": "branch2.0",
        "3x3": "branch2.1",
        "5x5_reduce": "branch3.0",
        "5x5": "branch3.1",
        "pool_proj": "branch4.1",
    }
    renamed: Tensors = {}
    for name, tensor in tensors.items():
        layer, kind = name.rsplit(".", 1)
        if layer == "loss3/classifier":
            renamed[f"fc.{kind}"] = tensor
            continue
        block, branch = layer.split("/")
        prefix = f"conv{list(STEM).index(layer) + 1}" if layer in STEM else None
        prefix = prefix or f"{block.replace('_', '')}.{branches[branch]}"
        if kind == "weight":
            renamed[f"{prefix}.conv.weight"] = tensor
            continue
        renamed[f"{prefix}.bn.bias"] = tensor
        renamed[f"{prefix}.bn.weight"] = random.uniform(0.5, 1.5, tensor.shape).astype(np.float32)
        renamed[f"{prefix}.bn.running_mean"] = random.normal(0, 0.3, tensor.shape).astype(np.float32)
        renamed[f"{prefix}.bn.running_var"] = random.uniform(0.5, 2, tensor.shape).astype(np.float32)
        renamed[f"{prefix}.bn.num_batches_tracked"] = np.array(7)
    return renamed


# A protocol buffer encoder, as small as the tests need it.


def varint(value: int) -> bytes:
    """An unsigned integer, seven bits to the byte."""
    encoded = b""
    while value > 0x7F:
        encoded += bytes([value & 0x7F | 0x80])
        value >>= 7
    return encoded + bytes([value])


def field(number: int, value: int | float | str | bytes) -> bytes:
    """One field: an integer, a float32, or a string, bytes or message."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    if isinstance(value, float):
        return varint(number << 3 | 5) + struct.pack("<f", value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def graphdef(tensors: Tensors, norms: Iterable[dict[str, int | float]], as_float_list: bool = False) -> bytes:
    """A TensorFlow GraphDef of Inception5h with these weights and the attributes of its two LRN nodes."""
    nodes = [_node("input", "Placeholder", {})]
    for name, tensor in tensors.items():
        layer, kind = name.rsplit(".", 1)
        axes = {4: (2, 3, 1, 0), 2: (1, 0), 1: (0,)}[tensor.ndim]
        name = f"{tensorflow_layer(layer)}_{kind[0]}"
        nodes.append(_node(name, "Const", {"value": _tensor(tensor.transpose(axes), as_float_list)}))
    for index, attributes in enumerate(norms):
        values = {key: field(3 if isinstance(value, int) else 4, value) for key, value in attributes.items()}
        nodes.append(_node(f"localresponsenorm{index}", "LRN", values))
    # What the published graph also has: an auxiliary classifier and constants that are no weights.
    nodes.append(_node("softmax0_w", "Const", {"value": _tensor(np.ones((3, 2), np.float32))}))
    nodes.append(_node("mixed3a/concat_dim", "Const", {"value": field(8, field(1, 3) + field(7, 1))}))
    return b"".join(field(1, node) for node in nodes)


def _node(name: str, operation: str, attributes: dict[str, bytes]) -> bytes:
    entries = b"".join(field(5, field(1, key) + field(2, value)) for key, value in attributes.items())
    return field(1, name) + field(2, operation) + entries


def _tensor(values: np.ndarray, as_float_list: bool = False) -> bytes:
    shape = b"".join(field(2, field(1, size)) for size in values.shape)
    return field(8, field(1, 1) + field(2, shape) + field(5 if as_float_list else 4, values.tobytes()))


def caffemodel(tensors: Tensors, legacy: bool) -> bytes:
    """A Caffe NetParameter with these weights; `legacy` is the format from before 2015."""
    layers_field, name_field, blobs_field = (2, 4, 6) if legacy else (100, 1, 7)

    def blob(values: np.ndarray) -> bytes:
        if legacy:
            shape = (1,) * (4 - values.ndim) + values.shape
            header = b"".join(field(axis + 1, size) for axis, size in enumerate(shape))
        else:
            header = field(7, field(1, b"".join(varint(size) for size in values.shape)))
        return header + field(5, values.tobytes())

    layers = [
        field(name_field, "data"),
        field(name_field, "loss1/fc") + field(blobs_field, blob(np.ones((2, 2)))),
    ]
    for name in sorted({name.rsplit(".", 1)[0] for name in tensors}):
        blobs = (tensors[f"{name}.weight"], tensors[f"{name}.bias"])
        layers.append(field(name_field, name) + b"".join(field(blobs_field, blob(values)) for values in blobs))
    return field(1, "GoogleNet") + b"".join(field(layers_field, layer) for layer in layers)
