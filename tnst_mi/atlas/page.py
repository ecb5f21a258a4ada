"""The two views of an atlas: a contact sheet, and a self-contained page for the browser."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template

from PIL import Image, ImageDraw, ImageFont

from tnst_mi.io.atomic import written_whole
from tnst_mi.resources import DATA

_TEMPLATE = DATA / "atlas.html"

#: Minimum number of channels in a row of the sheet; with many, a row has about twice as many tiles as a column.
_IN_ROW = 8

#: Pixels between tiles, and height of the line of text above them.
_GAP, _CAPTION = 6, 18


@dataclass(frozen=True)
class Channel:
    """A finished channel.

    Attributes:
        number: of the channel, from 0.
        picture: PNG file of what excites it.
        smoke: PNG file of the stylized ball of smoke.
        response: how much the smoke raises the channel's mean, relative to the picture.
    """

    number: int
    picture: Path
    smoke: Path
    response: float


def write_sheet(path: Path, channels: Sequence[Channel]) -> None:
    """Write a PNG with a tile for every channel, one or more: its number, its picture, and below it the smoke."""
    rows = [[_grey(file) for file in (channel.picture, channel.smoke)] for channel in channels]
    width = max(image.width for images in rows for image in images)
    height = _CAPTION + max(sum(image.height + 1 for image in images) for images in rows)
    in_row = min(len(channels), max(_IN_ROW, math.isqrt(2 * len(channels))))
    lines = -(-len(channels) // in_row)
    sheet = Image.new("L", (_GAP + in_row * (width + _GAP), _GAP + lines * (height + _GAP)), 255)
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(_CAPTION - 4)
    for i, (channel, images) in enumerate(zip(channels, rows, strict=True)):
        left, top = _GAP + i % in_row * (width + _GAP), _GAP + i // in_row * (height + _GAP)
        pen.text((left, top), str(channel.number), fill=0, font=font)
        top += _CAPTION
        for image in images:
            sheet.paste(image, (left, top))
            top += image.height + 1
    with written_whole(path) as temporary:
        sheet.save(temporary, optimize=True)


def write_page(path: Path, layer: str, network: str, channels: Sequence[Channel]) -> None:
    """Write the HTML page.

    Args:
        path: the file, ending in .html.
        layer: BVLC's name of the layer.
        network: a description of the network and of its origin.
        channels: in the order of their numbers.
    """
    page = Template(_TEMPLATE.read_text("utf-8")).substitute(
        title=html.escape(f"Channels of {layer}"),
        network=html.escape(network),
        figures="\n".join(_figure(layer, channel) for channel in channels),
    )
    with written_whole(path) as temporary:
        temporary.write_text(page, "utf-8")


def _figure(layer: str, channel: Channel) -> str:
    flag = html.escape(f"--semantic {layer}:{channel.number}")
    images = "".join(
        f'<img src="data:image/png;base64,{base64.b64encode(file.read_bytes()).decode("ascii")}" alt="{what}">'
        for file, what in ((channel.picture, "picture"), (channel.smoke, "smoke"))
    )
    return (
        f'<figure tabindex="0" data-channel="{channel.number}" data-response="{channel.response:.4f}" '
        f'data-flag="{flag}" title="{flag}"><div>{images}</div>'
        f"<figcaption><b>{channel.number}</b><span>response {channel.response:.2f}</span></figcaption></figure>"
    )


def _grey(file: Path) -> Image.Image:
    with Image.open(file, formats=["PNG"]) as image:
        return image.convert("L")
