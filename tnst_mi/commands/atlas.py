"""`tnst-mi atlas`: what the channels of a layer look for, and what they make of smoke."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from tnst_mi.commands.base import Command, given, recipe_flags
from tnst_mi.errors import StoppedError
from tnst_mi.recipe.recipe import Recipe

if TYPE_CHECKING:
    from tnst_mi.atlas.layer_atlas import Atlas as LayerAtlas

_FOLDER = "tnst_mi-atlas"

#: How many of the channels that the smoke answers to best are named at the end.
_NAMED = 8


ResourceFlags = recipe_flags(("weights", "variant"))


@dataclass(kw_only=True)
class Atlas(Command):
    """Show every channel of a layer: the picture that excites it, and the smoke patch it makes of a ball of smoke.

    Writes a contact sheet and a page for the browser, to choose a channel for stylize --semantic LAYER:CHANNEL.
    Finished channels are kept: the same command goes on where it stopped, and adds channels to those there are.
    """

    layer: Annotated[str, tyro.conf.arg(metavar="LAYER")] = "inception_4b/pool_proj"
    """Layer of GoogLeNet, such as inception_3b/3x3_reduce, or its name in TensorFlow."""
    channels: Annotated[
        str | None, tyro.conf.arg(metavar="FIRST:LAST", help_behavior_hint="(default: all, some seconds each)")
    ] = None
    """Numbers of the first and the last channel, both included; or a list of numbers and ranges, such as 6,16,40:47."""
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint=f"(default: {_FOLDER}/NETWORK-LAYER)")
    ] = None
    """New or empty folder, or that of an atlas of the same layer and network."""
    resources: ResourceFlags = field(default_factory=ResourceFlags)
    """Which network, and where is computed."""

    def run(self) -> int:
        """Make what is missing, write sheet and page, and say where they are."""
        from tnst_mi.machine.backend import activate

        recipe = Recipe().updated_by_flags(given(self.resources))
        activate(recipe.variant)
        from tnst_mi.atlas.layer_atlas import Atlas as LayerAtlas
        from tnst_mi.atlas.layer_atlas import channel_numbers
        from tnst_mi.network.googlenet import GoogLeNet

        network = GoogLeNet.load(recipe.weights)
        layer = network.resolve(self.layer)
        count = network.channels(layer)
        channels = list(range(count)) if self.channels is None else channel_numbers(self.channels, count)
        out = self.out or Path(_FOLDER) / f"{network.flavour}-{layer.replace('/', '-')}"
        atlas = LayerAtlas(network, layer, out)
        try:
            _make(atlas, channels)
        except KeyboardInterrupt:
            raise StoppedError(
                f"interrupted with {len(atlas.missing(channels))} of {len(channels)} channels to go; "
                f"the same command goes on in {out} where it stopped"
            ) from None
        finally:
            finished = atlas.publish()
        strongest = sorted(finished, key=lambda channel: -channel.response)[:_NAMED]
        named = ", ".join(f"{channel.number} ({channel.response:.2f})" for channel in strongest)
        print(f"channels  {len(finished)} of {count} of {layer}, {network.flavour}")
        print(f"response  strongest in the smoke: {named}")
        print(f"sheet     {out / 'atlas.png'}")
        print(f"page      {out / 'atlas.html'}")
        return 0


def _make(atlas: LayerAtlas, channels: list[int]) -> None:
    """Make channels under a progress bar, which counts iterations."""
    from tqdm import tqdm

    missing = atlas.missing(channels)
    layout = "{desc} {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
    total = atlas.steps * len(missing)
    with tqdm(total=total, bar_format=layout, dynamic_ncols=True, file=sys.stderr, disable=not missing) as bar:

        def advance(channel: int, what: str) -> None:
            place = f"{missing.index(channel) + 1}/{len(missing)}"
            bar.set_description_str(f"channel {channel} ({place}) {what:7}", refresh=False)
            bar.update()

        atlas.make(missing, advance)
