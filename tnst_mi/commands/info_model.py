"""`tnst-mi info` of a trained model: what it was trained for, by what, and how well that went."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tnst_mi.realtime.model import Model, read_model


def lines_of_model(path: Path) -> list[str]:
    """What is to be printed of a model, a file or the name of one that ships with the package.

    Raises:
        InputError: it is none that can be used.
    """
    model = read_model(path)
    return [f"{model.path}: a model that stylizes in one pass (--model {path})", *(f"  {line}" for line in _of(model))]


def _of(model: Model) -> Iterator[str]:
    recipe = ", ".join(f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in model.recipe.items())
    yield f"trained for: {recipe or 'the usual recipe'}"
    yield from _training(model.trained)
    architecture = model.network.architecture
    size = model.path.stat().st_size / 1e6
    yield f"network: {architecture.octaves} grids, {architecture.width} channels, {size:.2g} MB, SHA-256 {model.sha256}"


def _training(trained: Mapping[str, Any]) -> Iterator[str]:
    """What the file says of its training. That is for people and nothing rests on it, so that it is not checked."""
    try:
        yield f"learned from: {_names(trained['inputs'])}"
        judges = f"of {_names(trained['held_out'])}" if trained["held_out"] else "of what it learned from"
        before, after = (float(trained[key]) for key in ("loss_before", "loss"))
        updates = int(trained["updates"])
        yield f"loss {judges} (less is better): {before:.4g} without it, {after:.4g} after {updates} updates"
    except (KeyError, TypeError, ValueError):
        yield "says nothing else of its training"


def _names(inputs: Any) -> str:
    return ", ".join(f"{one['name']} ({one['frames']} frame{'s' if one['frames'] != 1 else ''})" for one in inputs)
