"""A stand-in for Blender's layout, for panels that are drawn where there is no window."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import bpy


class Layout:
    """Whatever is drawn has to exist."""

    def __init__(self) -> None:
        self.drawn: list[str] = []
        self.texts: list[str] = []

    def prop(self, data: Any, name: str, **_: Any) -> None:
        assert name in data.bl_rna.properties, name
        self.drawn.append(name)

    def template_icon_view(self, data: Any, name: str, **_: Any) -> None:
        self.prop(data, name)

    def template_list(self, kind: str, _id: str, data: Any, name: str, active: Any, index: str, **_: Any) -> None:
        assert hasattr(bpy.types, kind), kind
        self.prop(data, name)
        self.prop(active, index)

    def operator(self, name: str, **_: Any) -> SimpleNamespace:
        group, operator = name.split(".")
        getattr(getattr(bpy.ops, group), operator).get_rna_type()
        self.drawn.append(name)
        return SimpleNamespace()

    def label(self, text: str = "", **_: Any) -> None:
        self.texts.append(text)

    def template_icon(self, *_: Any, **__: Any) -> None:
        pass

    progress = label

    def row(self, **_: Any) -> Layout:
        return self

    column = box = split = row
