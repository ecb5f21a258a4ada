"""Torch state dicts (.pth, .safetensors), in any of the three naming conventions in use for GoogLeNet.

- BVLC:        `inception_4b/pool_proj.weight`
- TensorFlow:  `mixed4b_pool_reduce_pre_relu_conv.weight` (ports of Inception5h such as lucent's),
               also without `_pre_relu` or `_conv`
- torchvision: `inception4b.branch4.1.conv.weight`, each convolution without bias and followed by `….bn.*`
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from tnst_mi.machine.terminal import quoted
from tnst_mi.network.readers.network_weights import (
    CLASSIFIER,
    CONVOLUTIONS,
    STEM,
    MalformedFile,
    NetworkWeights,
    tensorflow_name,
)

T = TypeVar("T")

_TENSORFLOW_KEY = re.compile(r"(?P<layer>.+?)(_pre_relu|_pre_activation)?(_conv|_matmul)?\.(?P<kind>weight|bias)")
_AUXILIARY = ("loss1/", "loss2/", "aux1.", "aux2.")
"""The auxiliary classifiers, used only in training."""

_TORCHVISION_BRANCHES = {
    "1x1": "branch1",
    "3x3_reduce": "branch2.0",
    "3x3": "branch2.1",
    "5x5_reduce": "branch3.0",
    "5x5": "branch3.1",
    "pool_proj": "branch4.1",
}
#: Where training programs put the state dict among other things, and what they put before its names.
_NESTED = ("state_dict", "model_state_dict", "model", "net", "network", "params", "weights")
_DEEPEST = 3
_PREFIXES = re.compile(r"(?:module|model|net|network|backbone|_orig_mod)\.")

_BATCH_NORM_PARTS = ("weight", "bias", "running_mean", "running_var")
_BATCH_NORM_EPSILON = 1e-3  # torchvision's googlenet.py
_FIRST_TENSORS = {
    "conv1/7x7_s2.weight": "bvlc",
    "conv2d0_pre_relu_conv.weight": "inception5h",
    "conv2d0_pre_relu.weight": "inception5h",
    "conv2d0.weight": "inception5h",
    "conv1.conv.weight": "torchvision",
}


def flavour_of_names(names: Iterable[str]) -> str:
    """The flavour implied by the tensor names; raises `MalformedFile` if they belong to another network."""
    names = list(names)
    for name in names:
        if name in _FIRST_TENSORS:
            return _FIRST_TENSORS[name]
    found = f"{len(names)} tensors, such as {quoted(sorted(names)[0])}" if names else "no tensors"
    raise MalformedFile(
        f"weights of another network: {found}, but no first layer, such as {next(iter(_FIRST_TENSORS))!r}"
    )


def safetensors_header(path: Path) -> tuple[list[str], dict[str, str]]:
    """The names of the tensors in a .safetensors file, and its metadata; raises `MalformedFile`."""
    try:
        with safe_open(path, framework="pt") as file:
            return list(without_prefix(dict.fromkeys(file.keys()))), file.metadata() or {}
    except SafetensorError as error:
        raise MalformedFile(f"truncated or not a safetensors file ({_first_line(error)})") from None


def read_safetensors(path: Path) -> dict[str, Tensor]:
    """All tensors of a .safetensors file; raises `MalformedFile`. The format cannot hold code."""
    try:
        with safe_open(path, framework="pt") as file:
            return without_prefix({name: file.get_tensor(name) for name in file.keys()})
    except SafetensorError as error:
        raise MalformedFile(f"truncated or not a safetensors file ({_first_line(error)})") from None


def read_pth(path: Path) -> dict[str, Tensor]:
    """All tensors of a file written by `torch.save`; raises `MalformedFile`.

    `weights_only` restricts the unpickler to tensors and containers, so the file cannot run code.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about pickle protocols; what matters raises an error
            contents = torch.load(path, map_location="cpu", weights_only=True)
    except MemoryError:
        raise
    except Exception as error:  # a malformed pickle can make the unpickler raise almost anything
        raise MalformedFile(
            f"truncated, not a torch state dict, or one that holds more than tensors ({_first_line(error)})"
        ) from None
    for _ in range(_DEEPEST):
        if isinstance(contents, dict) and (name := next((n for n in _NESTED if _is_dict(contents, n)), None)):
            contents = contents[name]
    if not isinstance(contents, dict) or not all(isinstance(value, Tensor) for value in contents.values()):
        raise MalformedFile(
            f"not a torch state dict: expected a dictionary of tensors, or one in an entry {', '.join(_NESTED)}"
        )
    return without_prefix({str(name): value for name, value in contents.items()})


def without_prefix(tensors: dict[str, T]) -> dict[str, T]:
    """A state dict without what wrappers of the network put before all of its names, such as `module.`."""
    while tensors and len(prefixes := {_prefix(name) for name in tensors}) == 1 and "" not in prefixes:
        (prefix,) = prefixes
        tensors = {name.removeprefix(prefix): value for name, value in tensors.items()}
    return tensors


def _prefix(name: str) -> str:
    match = _PREFIXES.match(name)
    return match[0] if match else ""


def _is_dict(contents: dict, name: str) -> bool:
    return isinstance(contents.get(name), dict)


def from_state_dict(tensors: dict[str, Tensor]) -> NetworkWeights:
    """The network in a state dict that follows any of the three conventions; raises `MalformedFile`."""
    flavour = flavour_of_names(tensors)
    for name, tensor in tensors.items():
        if not tensor.is_floating_point() and not name.endswith(".num_batches_tracked"):
            raise MalformedFile(f"tensor {quoted(name)} is {tensor.dtype}, expected floating point")
    # The file may hold strided views and half precision.
    tensors = {
        name: tensor.detach().to(torch.float32).contiguous()
        for name, tensor in tensors.items()
        if not name.startswith(_AUXILIARY)
    }
    rename = {"bvlc": dict, "inception5h": _from_tensorflow, "torchvision": _fold_batch_norm}[flavour]
    return NetworkWeights(flavour, rename(tensors))


def _from_tensorflow(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """Rename TensorFlow's layer names to BVLC's; other names are kept and later reported as unexpected."""
    layers = {tensorflow_name(layer): layer for layer in (*CONVOLUTIONS, CLASSIFIER)}
    renamed = {}
    for name, tensor in tensors.items():
        match = _TENSORFLOW_KEY.fullmatch(name)
        if match and match["layer"] in layers:
            name = f"{layers[match['layer']]}.{match['kind']}"
        renamed[name] = tensor
    return renamed


def _fold_batch_norm(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """Rename torchvision's layers and fold each batch normalisation into the convolution before it."""
    remaining = {name: value for name, value in tensors.items() if not name.endswith(".num_batches_tracked")}
    folded = {}
    for layer in CONVOLUTIONS:
        prefix = _torchvision_name(layer)
        names = [f"{prefix}.{part}" for part in ("conv.weight", *(f"bn.{part}" for part in _BATCH_NORM_PARTS))]
        parts = [remaining.pop(name) for name in names if name in remaining]
        if len(parts) != len(names):
            continue  # reported as missing
        weight, gamma, beta, mean, variance = parts
        if any(part.shape != weight.shape[:1] for part in (gamma, beta, mean, variance)):
            raise MalformedFile(f"weights of another network: {prefix}.bn does not fit {prefix}.conv")
        gain = gamma / torch.sqrt(variance + _BATCH_NORM_EPSILON)
        folded[f"{layer}.weight"] = weight * gain.reshape(-1, *(1,) * (weight.ndim - 1))
        folded[f"{layer}.bias"] = beta - mean * gain
    for kind in ("weight", "bias"):
        if f"fc.{kind}" in remaining:
            folded[f"{CLASSIFIER}.{kind}"] = remaining.pop(f"fc.{kind}")
    return folded | remaining


def _torchvision_name(layer: str) -> str:
    if layer in STEM:
        return f"conv{STEM.index(layer) + 1}"
    block, branch = layer.split("/")
    return f"{block.replace('_', '')}.{_TORCHVISION_BRANCHES[branch]}"


def _first_line(error: Exception) -> str:
    """The first line of a library's message, which may have several."""
    return (str(error).strip() or type(error).__name__).splitlines()[0][:120]
