"""A trained network as a file: weights as safetensors, and in its metadata what a run has to know of them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole
from tnst_mi.machine.backend import torch_device
from tnst_mi.machine.terminal import quoted
from tnst_mi.network.download import file_hash
from tnst_mi.realtime.potential_network import Architecture, PotentialNetwork
from tnst_mi.recipe.paths import MODELS

#: What the metadata of these files has, apart from those of other programs.
_KEY = "tnst_mi_model"

#: Of the metadata: what else it says of itself is not read.
_FORMAT = 2

#: Limits of what a file may ask for.
_MOST_OCTAVES, _MOST_WIDTH = 4, 64


@dataclass(frozen=True)
class Model:
    """A network that has learned a style.

    Attributes:
        network: in evaluation mode, on the device of the active variant.
        recipe: the keys of the recipe by which it was trained, as in a recipe file.
        trained: what became of the training, for people.
        path, sha256: of the file.
    """

    network: PotentialNetwork
    recipe: Mapping[str, Any]
    trained: Mapping[str, Any]
    path: Path
    sha256: str


def write_model(path: Path, network: PotentialNetwork, recipe: Mapping[str, Any], trained: Mapping[str, Any]) -> None:
    """Write a network, weights in half precision.

    Raises:
        OSError: it cannot be written.
    """
    architecture = network.architecture
    described = {
        "format": _FORMAT,
        "octaves": architecture.octaves,
        "width": architecture.width,
        "recipe": dict(recipe),
        "trained": dict(trained),
    }
    weights = {name: weight.detach().half().cpu().contiguous() for name, weight in network.state_dict().items()}
    with written_whole(path) as temporary:
        temporary.write_bytes(save(weights, {_KEY: json.dumps(described)}))


def shipped_models() -> dict[str, Path]:
    """The models that come with the package, by name."""
    return {path.stem: path for path in sorted(MODELS.glob("*.safetensors"))}


def read_model(path: Path) -> Model:
    """Read a network: a file, or one of `shipped_models` by its name if there is no such file.

    Raises:
        InputError: there is no such file, or it is not one that `tnst-mi train` has written, or damaged.
    """
    shipped = shipped_models()
    if not path.is_file():
        path = shipped.get(str(path), path)
    if not path.is_file():
        raise InputError(
            f"{path}: no such file, expected one that `tnst-mi train` has written, or a model that ships with the "
            f"package: {', '.join(shipped)}"
        )
    try:
        with safe_open(path, "pt") as file:
            described = json.loads((file.metadata() or {}).get(_KEY, "null"))
            if described is None:
                raise InputError(f"{path}: has no model of tnst-mi, expected a file that `tnst-mi train` has written")
            architecture = _architecture(path, described)
            network = PotentialNetwork(architecture)
            expected = network.state_dict()
            if set(file.keys()) != set(expected):
                raise InputError(f"{path}: damaged, it lacks weights or has others; train it again")
            for name, weight in expected.items():
                if list(file.get_slice(name).get_shape()) != list(weight.shape):
                    raise InputError(f"{path}: damaged, {name} has another size than expected; train it again")
                expected[name] = file.get_tensor(name).float()
                if not torch.isfinite(expected[name]).all():
                    raise InputError(f"{path}: damaged, {name} has values that are not finite; train it again")
        recipe, trained = dict(described["recipe"]), dict(described["trained"])
    except InputError:
        raise
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise InputError(
            f"{path}: damaged, or no model that `tnst-mi train` has written, expected its .safetensors"
        ) from None
    network.load_state_dict(expected)
    return Model(network.eval().to(torch_device()), recipe, trained, path, file_hash(path, "sha256"))


def _architecture(path: Path, described: Mapping[str, Any]) -> Architecture:
    """That of a file.

    Raises:
        InputError: it is of a later version, or beyond all limits.
    """
    if described["format"] != _FORMAT:
        found = quoted(str(described["format"]))
        raise InputError(f"{path}: has format {found}, expected {_FORMAT}; use the version of tnst-mi that wrote it")
    octaves, width = described["octaves"], described["width"]
    whole = isinstance(octaves, int) and isinstance(width, int)
    if not (whole and 1 <= octaves <= _MOST_OCTAVES and 1 <= width <= _MOST_WIDTH):
        raise InputError(f"{path}: damaged, it describes no network that there can be; train it again")
    return Architecture(octaves, width)
