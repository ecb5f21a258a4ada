"""Parts of the HTML of a notebook: text that is escaped, pictures that are embedded, tables.

Styles are inline, since a style sheet would change the page around it.
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Mapping

import numpy as np
from PIL import Image

from tnst_mi.io.pictures.png import eight_bits
from tnst_mi.losses.pictures import resized
from tnst_mi.machine.terminal import printable, shortened

#: Most columns and rows of a picture.
LARGEST = 400

#: Most characters of a text.
_LONGEST = 160


def text(value: object, most: int = _LONGEST) -> str:
    """A value in words, escaped and shortened.

    Example:
        >>> text("<b>"), text("a long word", 6)
        ('&lt;b&gt;', 'a lon…')
    """
    return html.escape(shortened(printable(str(value)), most))


def embedded(image: np.ndarray, largest: int = LARGEST) -> str:
    """A picture (rows, columns[, 3]), 1 is white, as the address of a PNG in itself; a larger one is reduced."""
    if max(image.shape) > largest:
        width, height = shown_size(image.shape, largest)
        image = resized(np.clip(image, 0.0, 1.0), height, width)
    file = io.BytesIO()
    Image.fromarray(eight_bits(image)).save(file, "PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode('ascii')}"


def shown_size(shape: tuple[int, ...], largest: int = LARGEST) -> tuple[int, int]:
    """(width, height) at which a picture (rows, columns) is shown: enlarged by a whole number, or reduced to fit.

    Example:
        >>> shown_size((96, 64)), shown_size((800, 200))
        ((256, 384), (100, 400))
    """
    rows, columns = shape[:2]
    scale = max(1, largest // max(rows, columns)) if max(rows, columns) <= largest else largest / max(rows, columns)
    return max(1, round(scale * columns)), max(1, round(scale * rows))


def picture(image: np.ndarray, caption: str, largest: int = LARGEST) -> str:
    """A picture (rows, columns[, 3]) with a caption below it."""
    width, height = shown_size(image.shape, largest)
    return (
        '<figure style="display:inline-block;margin:0 8px 8px 0;vertical-align:top;white-space:normal">'
        f'<img src="{embedded(image, largest)}" width="{width}" height="{height}" alt="{text(caption)}" '
        'style="display:block;margin:0;background:#000">'
        f'<figcaption style="max-width:{max(width, 100)}px;font-size:85%;overflow-wrap:anywhere">{text(caption)}'
        "</figcaption></figure>"
    )


def table(rows: Mapping[str, object], meanings: Mapping[str, str] | None = None) -> str:
    """Names with their values; what a name means is said where the mouse rests on it."""
    cell = '<td style="padding:1px 12px 1px 0;text-align:left;vertical-align:top'
    lines = [
        f'<tr>{cell};opacity:.7" title="{text((meanings or {}).get(name, name), 500)}">{text(name)}</td>'
        f'{cell};overflow-wrap:anywhere">{text(value)}</td></tr>'
        for name, value in rows.items()
    ]
    return f'<table style="border-collapse:collapse;margin:0"><tbody>{"".join(lines)}</tbody></table>'


def without_picture(error: Exception) -> str:
    """What stands in the place of a picture that could not be made."""
    return f"<p>no picture: {text(str(error) or type(error).__name__, 300)}</p>"


def box(title: str, parts: Iterable[str]) -> str:
    """Parts below a title."""
    return f'<div><div style="font-weight:bold;margin-bottom:4px">{text(title)}</div>{"".join(parts)}</div>'
