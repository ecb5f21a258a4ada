"""The channels of atlases, and their pictures."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tnst_mi.network.googlenet import LAYERS

#: The file that describes an atlas, and the names of its pictures.
ATLAS, PICTURE = "atlas.json", re.compile(r"(\d{3,6})_picture\.png")


@dataclass(frozen=True)
class AtlasChannel:
    """A channel of a layer, of the network of a flavour."""

    layer: str
    flavour: str
    channel: int


def channels_of(atlas: Path) -> Iterator[tuple[AtlasChannel, Path]]:
    """The channels of an atlas with their pictures; none of what is damaged."""
    try:
        described = json.loads((atlas / ATLAS).read_text("utf-8"))
        layer, flavour = str(described["layer"]), str(described["flavour"])
        pictures = sorted((atlas / "channels").glob("*_picture.png"))
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return
    for picture in pictures:
        if layer in LAYERS and (match := PICTURE.fullmatch(picture.name)):
            yield AtlasChannel(layer, flavour, int(match[1])), picture
