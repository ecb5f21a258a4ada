"""The panel: in the 3D view's sidebar, in the properties of volumes, and in the physics of fluid domains."""

from __future__ import annotations

import textwrap

import bpy

from ..scene.smoke import domain_settings
from ..versions import show_progress
from .last_run import run_of
from .lists import TNST_MI_UL_looks, TNST_MI_UL_overrides, help_of
from .running import running
from .subject import subject_of
from .thumbnails import picture_icon

#: Pixels of a character of the interface, for lines that are broken.
_CHARACTER = 7


class SmokePanel:
    """What all three places show."""

    bl_label = "Stylize Smoke"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel for the active object, or for the original of the active result."""
        layout, item = self.layout, subject_of(context.object)
        layout.use_property_split, layout.use_property_decorate = True, False
        if item is None:
            _draw_running(layout)
            return
        if item != context.object:
            layout.label(text=f"Stylizes {item.name}", icon="OBJECT_ORIGIN")
        settings = item.tnst_mi
        _draw_looks(layout, settings)
        column = layout.column()
        column.prop(settings, "quality")
        column.prop(settings, "strength")
        column.prop(settings, "use_camera")
        column.prop(settings, "steady")
        column.prop(settings, "use_range")
        if settings.use_range:
            column.prop(settings, "frame_start")
            column.prop(settings, "frame_end")
        column = layout.column()
        column.prop(settings, "source")
        column.prop(settings, "out")
        column.prop(settings, "place")
        _draw_advanced(layout, settings, context.region.width)
        if running() is None:
            _draw_last_run(layout, item, context.region.width)
            _draw_buttons(layout)
        else:
            _draw_running(layout)


def _draw_looks(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
    """The looks, and below them the selected one."""
    row = layout.row()
    row.template_list(
        TNST_MI_UL_looks.bl_idname, "", settings, "looks", settings, "look_index", rows=max(2, len(settings.looks))
    )
    buttons = row.column(align=True)
    buttons.operator("tnst_mi.add_look", text="", icon="ADD")
    if not settings.looks:
        layout.operator("tnst_mi.add_look", text="Choose a Look", icon="ADD")
        return
    buttons.operator("tnst_mi.remove_look", text="", icon="REMOVE")
    look = settings.looks[min(settings.look_index, len(settings.looks) - 1)]
    row = layout.row()
    row.use_property_split = False
    row.prop(look, "goal", expand=True)
    if look.goal == "MOTIF":
        layout.template_icon_view(look, "motif", show_labels=True, scale=6.0, scale_popup=4.0)
        layout.prop(look, "motif")
    elif look.goal == "PICTURE":
        icon = picture_icon(bpy.path.abspath(look.picture))
        if icon:
            layout.template_icon(icon, scale=6.0)
        layout.prop(look, "picture")
    else:
        layout.prop(look, "channel")
    layout.prop(look, "region")
    if look.region is not None:
        layout.prop(look, "edge")
    if len(settings.looks) > 1:
        layout.prop(look, "weight")


def _draw_advanced(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup, width: int) -> None:
    """Keys of the recipe, with what the selected one does."""
    box = layout.box()
    icon = "DISCLOSURE_TRI_DOWN" if settings.show_advanced else "DISCLOSURE_TRI_RIGHT"
    header = box.row()
    header.use_property_split, header.alignment = False, "LEFT"
    header.prop(settings, "show_advanced", icon=icon, emboss=False)
    if not settings.show_advanced:
        return
    row = box.row()
    row.template_list(TNST_MI_UL_overrides.bl_idname, "", settings, "overrides", settings, "override_index", rows=3)
    buttons = row.column(align=True)
    buttons.operator("tnst_mi.add_override", text="", icon="ADD")
    if not settings.overrides:
        return
    buttons.operator("tnst_mi.remove_override", text="", icon="REMOVE")
    override = settings.overrides[min(settings.override_index, len(settings.overrides) - 1)]
    _draw_text(box.column(align=True), help_of(override.key), width)


def _draw_text(column: bpy.types.UILayout, text: str, width: int, icon: str = "NONE") -> None:
    """A text in lines as wide as the panel, in pixels; the icon is before the first."""
    scale = bpy.context.preferences.system.ui_scale or 1.0
    across = max(20, int(width / (_CHARACTER * scale)) - (6 if icon == "NONE" else 10))
    lines = [part for line in text.splitlines() for part in textwrap.wrap(line, across)]
    for number, line in enumerate(lines):
        column.label(text=line, icon=icon if number == 0 or icon == "NONE" else "BLANK1")


def _draw_last_run(layout: bpy.types.UILayout, item: bpy.types.Object, width: int) -> None:
    """How the last run of an object has ended, if there is anything to say of that."""
    run = run_of(item)
    if run is None or not run.text:
        return
    column = layout.box().column(align=True)
    _draw_text(column, run.text, width, icon="ERROR" if run.log else "INFO")
    if run.log:
        _draw_text(column, f"Log: {run.log}", width, icon="TEXT")
        column.operator("wm.path_open", text="Open Log", icon="FILE_TEXT").filepath = run.log


def _draw_running(layout: bpy.types.UILayout) -> None:
    """What runs, which may be for another object than the active one."""
    now = running()
    if now is None:
        return
    column = layout.column()
    column.label(text=now.title, icon="PLAY")
    show_progress(column, now.progress.fraction, "stopping" if now.job.cancelled else now.progress.text)
    column.operator("tnst_mi.cancel", icon="X")


def _draw_buttons(layout: bpy.types.UILayout) -> None:
    """What starts."""
    row = layout.row()
    row.scale_y = 1.4
    row.operator("tnst_mi.stylize", icon="PLAY")
    column = layout.column(align=True)
    column.operator("tnst_mi.resume", icon="FILE_REFRESH")
    column.operator("tnst_mi.bake_markers", icon="MARKER_HLT")


class TNST_MI_PT_sidebar(SmokePanel, bpy.types.Panel):
    """In the sidebar of the 3D view."""

    bl_idname = "TNST_MI_PT_sidebar"
    bl_space_type, bl_region_type = "VIEW_3D", "UI"
    bl_category = "Stylize"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """For volumes and domains; while something runs, whatever is selected."""
        return running() is not None or subject_of(context.object) is not None


class TNST_MI_PT_volume(SmokePanel, bpy.types.Panel):
    """In the data properties of volumes."""

    bl_idname = "TNST_MI_PT_volume"
    bl_space_type, bl_region_type = "PROPERTIES", "WINDOW"
    bl_context = "data"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """For volumes."""
        return context.object is not None and context.object.type == "VOLUME"


class TNST_MI_PT_domain(SmokePanel, bpy.types.Panel):
    """In the physics properties of domains."""

    bl_idname = "TNST_MI_PT_domain"
    bl_space_type, bl_region_type = "PROPERTIES", "WINDOW"
    bl_context = "physics"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """For domains of smoke."""
        return domain_settings(context.object) is not None


_CLASSES = (TNST_MI_PT_sidebar, TNST_MI_PT_volume, TNST_MI_PT_domain)

register, unregister = bpy.utils.register_classes_factory(_CLASSES)
