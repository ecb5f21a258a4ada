"""The card of a model: how it was trained, and how well; beside the model, for people, and for going on."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.machine import environment
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.network.shipped import PATTERNS
from tnst_mi.recipe.paths import shipped_name
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.sections import Goals, Method
from tnst_mi.training.footage import Footage


def _keys(recipe: Recipe, folder: Path) -> dict[str, Any]:
    """The keys of a recipe that say what was learned, as in a recipe file of a folder; not those that are as always."""
    usual, keys = Recipe(), {}
    for name in (key for section in (Goals, Method) for key in section.__annotations__):
        value = getattr(recipe, name)
        if value != getattr(usual, name):
            keys[name] = [_from(path, folder) for path in value] if name in ("style", "content") else value
    return keys


def _from(path: str, folder: Path) -> str:
    """The name of a picture that ships; of others, the way from a folder: both can be moved, and tell little else."""
    name = shipped_name(path)
    try:
        return name if name != path else os.path.relpath(path, folder.resolve())
    except ValueError:  # on another drive
        return path


def card_of(
    recipe: Recipe, footage: Sequence[Footage], held_out: Sequence[Footage], judge: GoogLeNet, width: int, folder: Path
) -> dict[str, Any]:
    """What is known of a training before it begins.

    Args:
        recipe: of the training.
        footage: what it learns from.
        held_out: what it is judged by, if that is something else.
        judge: the network that sees the images.
        width: of the network.
        folder: of the model.
    """
    shipped = {"weights": PATTERNS} if judge.flavour == PATTERNS else {}
    return {
        "recipe": _keys(recipe, folder) | shipped,
        "inputs": _shown_inputs(footage),
        "held_out": _shown_inputs(held_out),
        "seed": recipe.seed,
        "width": width,
        "weights": {"sha256": judge.sha256, "flavour": judge.flavour},
        "versions": environment.versions(),
    }


def _shown_inputs(footage: Sequence[Footage]) -> list[dict[str, Any]]:
    """What of inputs is told: models are given to others, who need not know where the files were."""
    return [{"name": Path(one.name).name, "frames": len(one)} for one in footage]


def earlier_curve(card: Path, now: Mapping[str, Any]) -> list[dict[str, float]]:
    """The curve of the training that is resumed.

    Raises:
        InputError: its card is damaged, or it had another recipe or other weights than there are now.
    """
    try:
        earlier = json.loads(card.read_text("utf-8"))
        for key in ("recipe", "weights", "inputs", "held_out"):
            if earlier[key] != json.loads(json.dumps(now[key])):
                raise InputError(f"{card}: has another {key}, expected the same to go on; leave out --resume")
        return [dict(point) for point in earlier["curve"]]
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{card}: damaged or gone, so no training can go on from there; leave out --resume") from None
