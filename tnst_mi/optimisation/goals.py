"""The objective of a recipe (paper Eq. 2): its semantic, tag, content, match and style terms."""

from __future__ import annotations

import os
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.losses import terms as losses
from tnst_mi.losses.feature_maps import read_map
from tnst_mi.losses.objective import Objective
from tnst_mi.losses.palette import Palette
from tnst_mi.losses.style import Style
from tnst_mi.network.class_names import matching_classes
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.network.readers import read_weights
from tnst_mi.network.shipped import DOWNLOAD_COMMAND, PATTERNS, shipped_weights
from tnst_mi.network.weights import ENVIRONMENT_VARIABLE
from tnst_mi.recipe.recipe import Recipe


def objective_of(recipe: Recipe) -> Objective:
    """The sum of the recipe's terms; a style that changes over the frames contributes the pictures of all its keys."""
    recipe, colour = recipe.located(Path.cwd()), recipe.colour == "style"
    octaves = recipe.octaves if recipe.all_octaves else 1
    of_style = recipe.style_layers, recipe.style_loss, recipe.style_statistics, colour, octaves, recipe.scale_factor
    styles = [Style(path, *of_style) for path in recipe.style]
    terms = [
        *(losses.Semantic(layer, channels, recipe.damping) for layer, channels in recipe.semantic_channels),
        *(losses.ClassTag(tag) for tag in recipe.tag),
        *(losses.Content(path, layer, colour) for path in recipe.content for layer in recipe.content_layers),
        *(losses.Match(layer, read_map(path)) for layer, path in recipe.maps),
        *styles,
        # Of pictures that have been read already.
        *(Palette(style.picture) for style in styles if colour),
    ]
    weighted = [weight * term for weight, term in zip(term_weights(recipe), terms, strict=True)]
    return Objective(pair for term in weighted for pair in term.weighted_terms)


def term_weights(recipe: Recipe) -> list[float]:
    """Weights of the terms of `objective_of`, in the same order, for the recipe of one frame."""
    named, mapped = [1.0] * (len(recipe.semantic) + len(recipe.tag)), [1.0] * len(recipe.match)
    content = [weight for _ in recipe.content for weight in recipe.content_layers.values()]
    semantic = [recipe.semantic_weight * weight for weight in (*named, *content, *mapped)]
    strokes = [recipe.style_weight * share for share in recipe.style_shares]
    palettes = [recipe.colour_weight * share for share in recipe.style_shares if recipe.colour == "style"]
    return semantic + strokes + palettes


def require_meant(recipe: Recipe, network: GoogLeNet, fallback: bool) -> None:
    """Refuse channel numbers and maps on the network `patterns` unless the recipe names that network explicitly.

    A channel number does not show which network it was chosen for, and recipes use those of networks trained on
    ImageNet; a map of features is one of their layers. Class names and pictures mean the same to any network.
    `fallback`: `patterns` is used because no other network was found.
    """
    if network.flavour != PATTERNS or recipe.weights is not None or not (recipe.semantic or recipe.match):
        return
    if fallback:
        reason, remedy = "no other was found", f"get the paper's network with `{DOWNLOAD_COMMAND}`"
    else:
        reason, remedy = f"${ENVIRONMENT_VARIABLE} names it", "name the network that they are of with --weights"
    tags = ", ".join(repr(name.partition(",")[0].strip()) for name in network.class_names[:2])
    if recipe.semantic:
        named = f"semantic {recipe.semantic[0]!r}: channel numbers are those"
    else:
        named = f"match {recipe.match[0]!r}: the channels of a map are those"
    raise InputError(
        f"{named} of one network; this run would take the "
        f'shipped {PATTERNS} ({reason}); {remedy}, or weights = "{PATTERNS}" if its own are '
        f"meant, or a tag, such as {tags}"
    )


def require_known(recipe: Recipe, network: GoogLeNet, fallback: bool) -> None:
    """Check that the network has the classes, layers and channels that a recipe names.

    `fallback`: `patterns` is used because no other network was found.

    Raises:
        InputError: it lacks one; the message says which network that is, and why it was taken.
    """
    for tag in recipe.tag:
        try:
            network.class_index(tag)
        except InputError as error:
            raise InputError(f"{_which(recipe, network, fallback)}: {error}{_where_else(tag, network)}") from None
    for layer, channels in recipe.semantic_channels:
        try:
            network.check_channels(layer, channels)
        except InputError as error:
            raise InputError(f"{_which(recipe, network, fallback)}: {error}") from None


def _which(recipe: Recipe, network: GoogLeNet, fallback: bool) -> str:
    """Which network is taken, and why."""
    if recipe.weights is not None:
        reason = "as weights says"
    elif os.environ.get(ENVIRONMENT_VARIABLE):
        reason = f"as ${ENVIRONMENT_VARIABLE} says"
    else:
        reason = "as no other was found" if fallback else f"found at {network.source}"
    return f"network {network.flavour} ({reason})"


def _where_else(tag: str, network: GoogLeNet) -> str:
    """That the network that ships with the package has a tag which another one lacks."""
    if network.flavour == PATTERNS or not matching_classes(read_weights(shipped_weights()).class_names or (), tag):
        return ""
    return f"; --weights {PATTERNS} has this tag"
