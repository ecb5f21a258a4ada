"""The 8-bit format in which the network `patterns` ships: a safetensors file, a quarter of the size of float32.

For each convolution and the classifier, under its BVLC name:

    <layer>.weight   int8 (out, in, rows, columns), the classifier's (out, in)
    <layer>.scale    float32 (out,): the weights of an output channel are its integers times its scale
    <layer>.bias     float32 (out,)

The metadata hold flavour = "patterns" and, in `classes`, a JSON list with the name of each output of the classifier,
with synonyms separated by commas.
"""

from __future__ import annotations

import json
import reprlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file
from torch import Tensor

from tnst_mi.network.readers.network_weights import (
    CLASSIFIER,
    CONVOLUTIONS,
    MalformedFile,
    NetworkWeights,
    require_names,
)
from tnst_mi.network.shipped import PATTERNS

_LAYERS = (*CONVOLUTIONS, CLASSIFIER)
_DTYPES = {"weight": torch.int8, "scale": torch.float32, "bias": torch.float32}
_LARGEST = 127
"""The integers are symmetric about 0, so -128 is not used."""


def write_quantised(path: Path, weights: NetworkWeights) -> None:
    """Write a network with its class names, its weights quantised to 8 bits per output channel.

    A weight changes by at most half the scale of its channel, which is the channel's largest |weight| / 127.
    The file is written in place; use `io.atomic.written_whole` to write it atomically. Raises `MalformedFile` if the
    network is not `patterns` or its class names do not match its classifier.
    """
    if weights.flavour != PATTERNS:
        raise MalformedFile(f"weights of flavour {weights.flavour!r}, expected {PATTERNS!r}")
    names = _checked_classes(list(weights.class_names or ()), weights.tensors[f"{CLASSIFIER}.bias"])
    tensors: dict[str, Tensor] = {}
    for layer in _LAYERS:
        integers, scale = quantised(weights.tensors[f"{layer}.weight"])
        bias = weights.tensors[f"{layer}.bias"].detach().cpu().contiguous()
        tensors |= {f"{layer}.weight": integers, f"{layer}.scale": scale, f"{layer}.bias": bias}
    save_file(tensors, path, {"flavour": PATTERNS, "classes": json.dumps(names, ensure_ascii=False)})


def quantised(weight: Tensor) -> tuple[Tensor, Tensor]:
    """Round float weights (out, ...) to (integers int8 of the same shape, scale float32 (out,)).

    The scale of an output channel whose weights are all 0 is 0.
    """
    weight = weight.detach().cpu().double()
    scale = (weight.flatten(1).abs().amax(1) / _LARGEST).float()
    divisor = torch.where(scale > 0, scale.double(), 1.0)
    integers = (weight / _per_channel(divisor, weight)).round().clamp(-_LARGEST, _LARGEST)
    return integers.to(torch.int8).contiguous(), scale


def is_quantised(names: Iterable[str], metadata: Mapping[str, str]) -> bool:
    """Whether the header of a safetensors file indicates this format."""
    return metadata.get("flavour") == PATTERNS or any(name.endswith(".scale") for name in names)


def from_quantised(tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> NetworkWeights:
    """The network in the contents of a quantised file, in float32, with its class names; raises `MalformedFile`."""
    if metadata.get("flavour") != PATTERNS:
        raise MalformedFile(f"8-bit weights whose metadata have flavour {metadata.get('flavour')!r}, not {PATTERNS!r}")
    require_names(tensors.keys(), {f"{layer}.{kind}" for layer in _LAYERS for kind in _DTYPES})
    expanded: dict[str, Tensor] = {}
    for layer in _LAYERS:
        for kind, dtype in _DTYPES.items():
            if (found := tensors[f"{layer}.{kind}"].dtype) != dtype:
                raise MalformedFile(f"tensor '{layer}.{kind}' is {found}, expected {dtype}")
        weight, scale = tensors[f"{layer}.weight"], tensors[f"{layer}.scale"]
        if weight.ndim == 0 or scale.shape != weight.shape[:1]:
            raise MalformedFile(
                f"tensor '{layer}.scale' has shape {tuple(scale.shape)}, expected {tuple(weight.shape[:1])}: "
                f"one for each output channel of the weight {tuple(weight.shape)}"
            )
        if not bool(((scale >= 0) & scale.isfinite()).all()):
            raise MalformedFile(f"tensor '{layer}.scale' has values that are not finite numbers of 0 or more")
        expanded[f"{layer}.weight"] = weight.float() * _per_channel(scale, weight)
        expanded[f"{layer}.bias"] = tensors[f"{layer}.bias"]
    classes = _checked_classes(_json(metadata.get("classes")), expanded[f"{CLASSIFIER}.bias"])
    return NetworkWeights(PATTERNS, expanded, class_names=tuple(classes))


def _per_channel(values: Tensor, weight: Tensor) -> Tensor:
    """Values (out,) shaped to broadcast over weights (out, ...)."""
    return values.reshape(-1, *(1,) * (weight.ndim - 1))


def _json(text: str | None) -> Any:
    if text is None:
        raise MalformedFile("the metadata lack the classes")
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise MalformedFile("the classes in the metadata are not JSON") from None


def _checked_classes(names: Any, bias: Tensor) -> list[str]:
    """The class names, checked to be a list with one text per output of the classifier."""
    if not isinstance(names, list) or len(names) != bias.numel():
        found = f"{len(names)} names" if isinstance(names, list) else f"a {type(names).__name__}"
        raise MalformedFile(f"the classes in the metadata are {found}, expected a list of {bias.numel()} names")
    for index, name in enumerate(names):
        # They are printed on terminals, and each synonym can be requested.
        if not isinstance(name, str) or not name.isprintable() or not all(map(str.strip, name.split(","))):
            raise MalformedFile(
                f"class {index} in the metadata is {reprlib.repr(name)}, expected names separated by commas"
            )
    return names
