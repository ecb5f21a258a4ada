"""Pictures in the panel: what motifs look like, and the style pictures that were chosen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy
import bpy.utils.previews
import numpy as np

from .motifs import SHEET, motifs


class _Loaded:
    """The pictures while the add-on is on, and the choices that show them: Blender keeps no reference to these."""

    pictures: bpy.utils.previews.ImagePreviewCollection | None = None
    items: tuple[tuple[str, str, str, int, int], ...] = ()


def motif_items(_look: object = None, _context: object = None) -> Sequence[tuple[str, str, str, int, int]]:
    """The motifs as choices of an EnumProperty, with their pictures once these are there."""
    if not _Loaded.items:
        _Loaded.items = tuple(
            (motif.tag, motif.tag.capitalize(), f"Also: {', '.join(motif.synonyms)}", _icon(motif.tag), number)
            for number, motif in enumerate(motifs())
        )
    return _Loaded.items


def _icon(name: str) -> int:
    pictures = _Loaded.pictures
    return 0 if pictures is None or name not in pictures else pictures[name].icon_id


def picture_icon(file: str) -> int:
    """The icon of a picture file; 0 if it cannot be shown."""
    if _Loaded.pictures is None or not Path(file).is_file():
        return 0
    if file not in _Loaded.pictures:
        _Loaded.pictures.load(file, file, "IMAGE")
    return _icon(file)


def _cut_sheet() -> None:
    """Cut the sheet of motifs into previews; not while Blender registers add-ons, when it opens no pictures."""
    pictures = _Loaded.pictures
    if pictures is None or motifs()[0].tag in pictures:
        return
    sheet = bpy.data.images.load(str(SHEET))
    try:
        sheet.colorspace_settings.name = "Non-Color"
        width, height = sheet.size
        pixels = np.empty(width * height * 4, np.float32)
        sheet.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(sheet)
    # Rows from the bottom up, as previews have them too.
    rows = pixels.reshape(height, width, 4)
    for motif in motifs():
        below = height - motif.top - motif.edge
        tile = rows[below : below + motif.edge, motif.left : motif.left + motif.edge]
        preview = pictures.new(motif.tag)
        preview.image_size = motif.edge, motif.edge
        preview.image_pixels_float = tile.ravel().tolist()
        small = tile.reshape(motif.edge // 2, 2, motif.edge // 2, 2, 4).mean((1, 3))
        preview.icon_size = motif.edge // 2, motif.edge // 2
        preview.icon_pixels_float = small.ravel().tolist()
    _Loaded.items = ()


def register() -> None:
    """Make the pictures, as soon as Blender has started."""
    _Loaded.pictures = bpy.utils.previews.new()
    # Persistent, for where Blender is started with a file, which it opens first.
    bpy.app.timers.register(_cut_sheet, first_interval=0.0, persistent=True)


def unregister() -> None:
    """Free them."""
    if bpy.app.timers.is_registered(_cut_sheet):
        bpy.app.timers.unregister(_cut_sheet)
    if _Loaded.pictures is not None:
        bpy.utils.previews.remove(_Loaded.pictures)
    _Loaded.pictures = None
    _Loaded.items = ()
