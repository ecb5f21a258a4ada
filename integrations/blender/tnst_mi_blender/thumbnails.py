"""Pictures in the panel: what motifs look like, and the style pictures that were chosen."""

from __future__ import annotations

from pathlib import Path

import bpy
import bpy.utils.previews
import numpy as np

from .motifs import SHEET, motifs

_pictures: bpy.utils.previews.ImagePreviewCollection | None = None
_items: list[tuple[str, str, str, int, int]] = []


def motif_items(_look: object = None, _context: object = None) -> list[tuple[str, str, str, int, int]]:
    """The motifs as choices of an EnumProperty, with their pictures once these are there."""
    if not _items:
        for number, motif in enumerate(motifs()):
            icon = 0 if _pictures is None or motif.tag not in _pictures else _pictures[motif.tag].icon_id
            also = f"Also: {', '.join(motif.synonyms)}" if motif.synonyms else ""
            _items.append((motif.tag, motif.tag.capitalize(), also, icon, number))
    return _items


def picture_icon(file: str) -> int:
    """The icon of a picture file; 0 if it cannot be shown."""
    if _pictures is None or not Path(file).is_file():
        return 0
    if file not in _pictures:
        _pictures.load(file, file, "IMAGE")
    return _pictures[file].icon_id


def _cut_sheet() -> None:
    """Cut the sheet of motifs into previews; not while Blender registers add-ons, when it opens no pictures."""
    if _pictures is None or motifs()[0].tag in _pictures:
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
        preview = _pictures.new(motif.tag)
        preview.image_size = motif.edge, motif.edge
        preview.image_pixels_float = tile.ravel().tolist()
        small = tile.reshape(motif.edge // 2, 2, motif.edge // 2, 2, 4).mean((1, 3))
        preview.icon_size = motif.edge // 2, motif.edge // 2
        preview.icon_pixels_float = small.ravel().tolist()
    _items.clear()


def register() -> None:
    """Make the pictures, as soon as Blender has started."""
    global _pictures
    _pictures = bpy.utils.previews.new()
    bpy.app.timers.register(_cut_sheet, first_interval=0.0)


def unregister() -> None:
    """Free them."""
    global _pictures
    if bpy.app.timers.is_registered(_cut_sheet):
        bpy.app.timers.unregister(_cut_sheet)
    if _pictures is not None:
        bpy.utils.previews.remove(_pictures)
    _pictures = None
    _items.clear()
