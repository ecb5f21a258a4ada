"""An object to come back to later, though artists go on working meanwhile."""

from __future__ import annotations

import bpy


class Kept:
    """An object that is found again after Undo, for which Blender makes all objects anew, and after it was renamed.

    Args:
        item: the object.
    """

    def __init__(self, item: bpy.types.Object) -> None:
        self._item: bpy.types.Object | None = item
        self.name = item.name
        """As it was when it was last found."""
        self._forgotten = False

    def find(self) -> bpy.types.Object | None:
        """The object; None if it was deleted. To be called now and then, lest it is renamed and then made anew."""
        if self._forgotten:
            return None
        try:
            if self._item is not None:
                self.name = self._item.name
        except ReferenceError:
            self._item = None
        if self._item is None:
            self._item = bpy.data.objects.get(self.name)
        # What is deleted may be left without a scene, where something refers to it.
        return self._item if self._item is not None and self._item.users_collection else None

    def forget(self) -> None:
        """Another file was opened: what has the name there is another object."""
        self._item, self._forgotten = None, True
