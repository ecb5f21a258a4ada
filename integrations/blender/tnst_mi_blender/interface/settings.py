"""What is set in the panel; it belongs to an object and is saved with the scene."""

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ..recipes.parameters import parameters
from ..versions import PATH
from . import thumbnails

#: Keys of a recipe that cannot be set in *Advanced*: the panel has controls for them, or the add-on writes them itself.
OWN_KEYS = frozenset(
    "style tag semantic content match mask target quality frames camera format origin voxel_size up strength".split()
)

_QUALITIES = (
    ("draft", "Draft", "Soon: where motifs will be, without the finest details"),
    ("preview", "Preview", "Most of the details"),
    ("final", "Final", "All of it"),
)
_GOALS = (
    ("MOTIF", "Motif", "One of 64 motifs that ship with tnst_mi"),
    ("PICTURE", "Picture", "The style of a picture"),
    ("CHANNEL", "Channel", "A channel of the network, as LAYER:NUMBER, for those who know it"),
)
_PLACES = (
    ("IN_PLACE", "In Its Place", "Where the original is, which is hidden"),
    ("BESIDE", "Beside", "Next to the original, which stays visible"),
)


def _choices(override: "TnstMiOverride", _context: object) -> list[tuple[str, str, str]]:
    parameter = parameters().get(override.key)
    return _CHOICES[override.key] if parameter is not None and parameter.kind == "choice" else [("", "", "")]


# Blender keeps no reference to texts of dynamic choices.
_CHOICES = {
    key: [(choice, choice, "") for choice in parameter.choices]
    for key, parameter in parameters().items()
    if parameter.kind == "choice"
}


class TnstMiLook(bpy.types.PropertyGroup):
    """What smoke is stylized towards, and where."""

    goal: EnumProperty(name="Towards", items=_GOALS, description="What the smoke is stylized towards")
    motif: EnumProperty(name="Motif", items=thumbnails.motif_items, default=2, description="What the smoke will show")
    picture: StringProperty(
        name="Picture",
        subtype="FILE_PATH",
        options=PATH,
        description="Picture whose style the smoke takes on: a file, or one that ships: spirals, net, flames, cells",
    )
    channel: StringProperty(name="Channel", description="LAYER:NUMBER, such as inception_4b/pool_proj:63")
    region: PointerProperty(
        name="Region",
        type=bpy.types.Object,
        poll=lambda _look, item: item.type in ("EMPTY", "MESH"),
        description="Where: inside of an empty displayed as a sphere or a cube, or of a mesh. Everywhere without one",
    )
    edge: FloatProperty(
        name="Soft Edge",
        min=0.0,
        subtype="DISTANCE",
        description="Depth inside of the region at which it has its whole effect",
    )
    weight: FloatProperty(name="Weight", default=1.0, min=0.0, soft_max=4.0, description="Against the other looks")


class TnstMiOverride(bpy.types.PropertyGroup):
    """A key of the recipe with a value of its own."""

    key: StringProperty()
    text: StringProperty(name="Value")
    switch: BoolProperty(name="On")
    choice: EnumProperty(name="Value", items=_choices)


class TnstMiRun(bpy.types.PropertyGroup):
    """What a scene keeps of an object's last run; see `last_run`."""

    item: PointerProperty(type=bpy.types.Object, description="Whose smoke it is")
    identifier: StringProperty(description="In its plan too")
    folder: StringProperty(description="Where its plan is, as an absolute path")
    text: StringProperty(description="What is said of it until the next run: how it was stopped, or notes")
    log: StringProperty(description="Of one that has failed")


class TnstMiSettings(bpy.types.PropertyGroup):
    """Of an object with smoke."""

    source: StringProperty(
        name="Smoke",
        subtype="FILE_PATH",
        options=PATH,
        description="Folder of the cache, or VDB file, to read instead of the object's own; empty for its own",
    )
    looks: CollectionProperty(type=TnstMiLook)
    look_index: IntProperty()
    quality: EnumProperty(name="Quality", items=_QUALITIES, default="draft")
    use_range: BoolProperty(name="Frame Range", description="Stylize a part of the frames instead of all")
    frame_start: IntProperty(name="First", default=1)
    frame_end: IntProperty(name="Last", default=24)
    use_camera: BoolProperty(
        name="Camera",
        default=True,
        description="Stylize what the camera of the scene sees in each frame; otherwise, the view from the front",
    )
    steady: BoolProperty(
        name="Steady",
        default=True,
        description="Motifs move with the smoke: each frame follows its neighbours. Takes longer",
    )
    strength: FloatProperty(
        name="Strength", default=1.0, min=0.0, max=1.0, subtype="FACTOR", description="How much of it all is seen"
    )
    out: StringProperty(
        name="Results",
        subtype="DIR_PATH",
        options=PATH,
        description="Folder for the results; empty for one beside the scene's file, or beside the smoke",
    )
    place: EnumProperty(name="Show", items=_PLACES, description="Where the stylized smoke is shown")
    show_advanced: BoolProperty(name="Advanced")
    overrides: CollectionProperty(type=TnstMiOverride)
    override_index: IntProperty()
    original: PointerProperty(type=bpy.types.Object, description="Of a result: what it was made of")
    part: StringProperty(description="Of a result: the marker that it begins at")
    hidden: EnumProperty(
        items=[("hide_viewport", "Viewports", ""), ("hide_render", "Renders", "")],
        options={"ENUM_FLAG"},
        description="Of an original: where it was hidden since its result is in its place, and not by its artist",
    )
    shown_as: StringProperty(description="Of a result: its name as it was last shown, which duplicates do not have")


#: Of an object.
_SETTINGS = (TnstMiLook, TnstMiOverride, TnstMiSettings)


def _let_overrides_have(group: type[bpy.types.PropertyGroup]) -> None:
    """Let overrides of objects of other files have settings of their own, which Blender allows one by one."""
    for wanted in group.__annotations__.values():
        inserted = {"USE_INSERTION"} if wanted.function is CollectionProperty else set()
        wanted.keywords["override"] = {"LIBRARY_OVERRIDABLE"} | inserted


def register() -> None:
    """Add the settings to objects, and what is kept of runs to scenes."""
    for each in _SETTINGS:
        _let_overrides_have(each)
        bpy.utils.register_class(each)
    bpy.utils.register_class(TnstMiRun)
    bpy.types.Scene.tnst_mi_runs = CollectionProperty(type=TnstMiRun)
    bpy.types.Object.tnst_mi = PointerProperty(type=TnstMiSettings, override={"LIBRARY_OVERRIDABLE"})


def unregister() -> None:
    """Remove them."""
    del bpy.types.Scene.tnst_mi_runs, bpy.types.Object.tnst_mi
    for each in (TnstMiRun, *reversed(_SETTINGS)):
        bpy.utils.unregister_class(each)
