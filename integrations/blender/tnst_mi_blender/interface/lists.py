"""The lists of looks and of advanced keys: adding and removing."""

# Blender reads the annotations of classes: they are no texts here.

import bpy
from bpy.props import EnumProperty

from ..recipes.advanced import fill_in
from ..recipes.parameters import parameters
from ..recipes.toml import assignment
from ..scene.shots import BASIS, MOTIFS, STEADY
from .settings import OWN_KEYS
from .subject import subject_of


def help_of(key: str) -> str:
    """What a key in *Advanced* does, and what it is without an entry there, where a setting of the panel decides that.

    Empty for a key that is none, as in a scene of another version.
    """
    if key not in parameters():
        return ""
    ways = ((STEADY, "with Steady"), (MOTIFS, "with a Motif"), (BASIS, "in Blender"))
    notes = [f"{when}, {assignment(key, values[key])}" for values, when in ways if key in values]
    return "\n".join(filter(None, (parameters()[key].help, f"If not set here: {'; '.join(notes)}." if notes else "")))


_KEYS = [(key, key, help_of(key)) for key in parameters() if key not in OWN_KEYS]


class ListOperator:
    """Changes a list of the object that the panel is about."""

    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """With a volume or a domain of smoke."""
        return subject_of(context.object) is not None


class Removes(ListOperator):
    """Removes the selected entry of a list.

    Attributes:
        entries: the name of the list in the settings.
        index: the name of the number of the selected one.
    """

    entries: str
    index: str

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove it, and select the one before."""
        settings = subject_of(context.object).tnst_mi
        selected = getattr(settings, self.index)
        getattr(settings, self.entries).remove(selected)
        setattr(settings, self.index, max(0, selected - 1))
        return {"FINISHED"}


class TNST_MI_UL_looks(bpy.types.UIList):
    """What the smoke is stylized towards, a line each."""

    bl_idname = "TNST_MI_UL_looks"

    def draw_item(self, _context, layout, _data, look, _icon, _active, _property, _index=0, _flag=0) -> None:
        """Draw a line: the goal and its region."""
        row = layout.row(align=True)
        picture = bpy.path.basename(look.picture) or "no picture"
        names = {"MOTIF": look.motif.capitalize(), "PICTURE": picture, "CHANNEL": look.channel or "no channel"}
        icon = {"MOTIF": "OUTLINER_OB_VOLUME", "PICTURE": "IMAGE_DATA", "CHANNEL": "NODE"}[look.goal]
        row.label(text=names[look.goal], icon=icon)
        row.label(text="everywhere" if look.region is None else look.region.name)


class TNST_MI_OT_add_look(ListOperator, bpy.types.Operator):
    """Add a motif or a picture"""

    bl_idname = "tnst_mi.add_look"
    bl_label = "Add Look"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add one at the end and select it."""
        settings = subject_of(context.object).tnst_mi
        settings.looks.add()
        settings.look_index = len(settings.looks) - 1
        return {"FINISHED"}


class TNST_MI_OT_remove_look(Removes, bpy.types.Operator):
    """Remove this motif or picture"""

    bl_idname = "tnst_mi.remove_look"
    bl_label = "Remove Look"

    entries, index = "looks", "look_index"


class TNST_MI_UL_overrides(bpy.types.UIList):
    """Keys of the recipe with values of their own, a line each."""

    bl_idname = "TNST_MI_UL_overrides"

    def draw_item(self, _context, layout, _data, override, _icon, _active, _property, _index=0, _flag=0) -> None:
        """Draw a line: the key and its value."""
        split = layout.split(factor=0.45)
        split.label(text=override.key)
        parameter = parameters().get(override.key)
        kind = "" if parameter is None else parameter.kind
        split.prop(override, {"switch": "switch", "choice": "choice"}.get(kind, "text"), text="")


class TNST_MI_OT_add_override(ListOperator, bpy.types.Operator):
    """Choose a key of the recipe to give it a value"""

    bl_idname = "tnst_mi.add_override"
    bl_label = "Add Key"
    bl_property = "key"

    key: EnumProperty(name="Key", items=_KEYS)

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Search for it by typing."""
        context.window_manager.invoke_search_popup(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add it, or select the one that is there."""
        settings = subject_of(context.object).tnst_mi
        index = settings.overrides.find(self.key)
        if index < 0:
            fill_in(settings.overrides.add(), self.key)
            index = len(settings.overrides) - 1
        settings.override_index = index
        for area in context.screen.areas if context.screen else ():
            area.tag_redraw()
        return {"FINISHED"}


class TNST_MI_OT_remove_override(Removes, bpy.types.Operator):
    """Let this key have its default again"""

    bl_idname = "tnst_mi.remove_override"
    bl_label = "Remove Key"

    entries, index = "overrides", "override_index"


_CLASSES = (
    TNST_MI_UL_looks,
    TNST_MI_OT_add_look,
    TNST_MI_OT_remove_look,
    TNST_MI_UL_overrides,
    TNST_MI_OT_add_override,
    TNST_MI_OT_remove_override,
)

register, unregister = bpy.utils.register_classes_factory(_CLASSES)
