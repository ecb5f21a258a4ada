"""The object that the panel is about, and its buttons work on."""

from __future__ import annotations

import bpy

from ..scene.smoke import can_be_stylized


def subject_of(item: bpy.types.Object | None) -> bpy.types.Object | None:
    """The object whose smoke is stylized when an object is selected: of a result, its original.

    A result whose original was deleted is one by itself. What has no smoke is nobody's subject: None.
    """
    if item is None or not can_be_stylized(item):
        return None
    original = item.tnst_mi.original
    # What is deleted may be left without a collection, where something refers to it.
    if original is None or not original.users_collection:
        return item
    return subject_of(original) or item
