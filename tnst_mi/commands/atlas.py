"""`tnst-mi atlas`: what the channels of a layer look for, and what they make of smoke."""

from __future__ import annotations

from pathlib import Path

from tnst_mi.atlas.layer_atlas import LayerAtlas, channel_numbers
from tnst_mi.commands.arguments import ATLAS_FOLDER, AtlasArguments
from tnst_mi.commands.base import given
from tnst_mi.errors import StoppedError
from tnst_mi.machine.backend import activate
from tnst_mi.machine.progress_bar import progress_bar
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.recipe.recipe import Recipe

#: How many of the channels with the strongest response in the smoke are listed at the end.
_NAMED = 8


def run(arguments: AtlasArguments) -> int:
    """Make the missing channels, write the sheet and the page, and print their paths."""
    recipe = Recipe().updated_by_flags(given(arguments.resources))
    activate(recipe.variant)
    network = GoogLeNet.load(recipe.weights)
    layer = network.resolve(arguments.layer)
    count = network.channels(layer)
    channels = list(range(count)) if arguments.channels is None else channel_numbers(arguments.channels, count)
    out = arguments.out or Path(ATLAS_FOLDER) / f"{network.flavour}-{layer.replace('/', '-')}"
    atlas = LayerAtlas(network, layer, out)
    smoke = not arguments.pictures_only
    try:
        _make(atlas, channels, smoke)
    except KeyboardInterrupt:
        raise StoppedError(
            f"interrupted with {len(atlas.missing(channels, smoke))} of {len(channels)} channels to go; "
            f"the same command goes on in {out} where it stopped"
        ) from None
    finally:
        finished = atlas.publish()
    if not smoke:
        print(f"pictures  {out / 'channels'}")
        return 0
    strongest = sorted(finished, key=lambda channel: -channel.response)[:_NAMED]
    named = ", ".join(f"{channel.number} ({channel.response:.2f})" for channel in strongest)
    print(f"channels  {len(finished)} of {count} of {layer}, {network.flavour}")
    print(f"response  strongest in the smoke: {named}")
    print(f"sheet     {out / 'atlas.png'}")
    print(f"page      {out / 'atlas.html'}")
    return 0


def _make(atlas: LayerAtlas, channels: list[int], smoke: bool) -> None:
    """Make channels under a progress bar, which counts iterations."""
    missing = atlas.missing(channels, smoke)
    layout = "{desc} {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
    total = atlas.steps(smoke) * len(missing)
    with progress_bar(total=total, bar_format=layout, disable=not missing) as bar:

        def advance(channel: int, what: str) -> None:
            place = f"{missing.index(channel) + 1}/{len(missing)}"
            bar.set_description_str(f"channel {channel} ({place}) {what:7}", refresh=False)
            bar.update()

        atlas.make(missing, advance, smoke)
