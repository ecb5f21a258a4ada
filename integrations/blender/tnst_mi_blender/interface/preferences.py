"""The add-on's preferences: which tnst-mi is run, and the button that installs one."""

# Blender reads the annotations of classes: they are no texts here.

from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..problems import CannotStylizeError
from ..processes.environment import EnvironmentMissing, Installation, find_environment, forget_checks, installed_program
from ..versions import ADDON, PATH, show_progress
from .running import Running, RunsJob, running


def private_folder() -> Path:
    """Where the private environment is; it outlives updates of the add-on."""
    return Path(bpy.utils.user_resource("DATAFILES", path="tnst_mi"))


def preferences_of(context: bpy.types.Context) -> "TnstMiPreferences":
    """What is set in the preferences, which are named by the package: extensions have other names than add-ons."""
    return context.preferences.addons[ADDON].preferences


def environment_of(context: bpy.types.Context) -> Path:
    """The tnst-mi that is run.

    Raises:
        EnvironmentMissing: there is none that can be.
    """
    return find_environment(bpy.path.abspath(preferences_of(context).program), private_folder()).program


class TnstMiPreferences(bpy.types.AddonPreferences):
    """Shown with the add-on in Blender's preferences."""

    bl_idname = ADDON

    program: StringProperty(
        name="tnst-mi",
        subtype="FILE_PATH",
        options=PATH,
        description="The program, or the folder of its environment; empty for the one on the PATH, or installed here",
    )
    weights: StringProperty(
        name="Network",
        subtype="FILE_PATH",
        options=PATH,
        description="File or folder of weights, or the word patterns; empty for those that are found",
    )
    checkout: StringProperty(
        name="Install From",
        subtype="DIR_PATH",
        options=PATH,
        description="A checkout of tnst_mi to install; empty for the version that the add-on brings",
    )

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the preferences."""
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(self, "program")
        column.prop(self, "weights")
        column.prop(self, "checkout")
        now = running()
        if now is not None:
            show_progress(column, now.progress.fraction, f"{now.title}: {now.progress.text}")
            column.operator("tnst_mi.cancel", icon="X")
            return
        installed = installed_program(private_folder())
        text = "No private environment yet" if installed is None else f"Private environment: {private_folder()}"
        column.label(text=text, icon="INFO" if installed is None else "CHECKMARK")
        row = column.row(align=True)
        row.operator("tnst_mi.install", text="Install" if installed is None else "Install Again", icon="IMPORT")
        row.operator("tnst_mi.check", icon="VIEWZOOM")


class TNST_MI_OT_install(RunsJob, bpy.types.Operator):
    """Download and install tnst-mi, with all that it needs, into an environment of its own (some GB)"""

    bl_idname = "tnst_mi.install"
    bl_label = "Install"

    def begin(self, context: bpy.types.Context) -> Running:
        """The installation.

        Raises:
            CannotStylizeError: Blender 4.2 or newer may not go online.
        """
        if not getattr(bpy.app, "online_access", True):
            raise CannotStylizeError(
                "Install needs Allow Online Access, in the preferences of Blender, System, Network"
            )
        chosen, private = preferences_of(context).checkout, private_folder()
        # Of this Blender alone: in the private folder, another one may be installing.
        log = Path(bpy.app.tempdir, "tnst_mi_install.log")
        job = Installation(private, log, Path(bpy.path.abspath(chosen)) if chosen else None)
        job.start()
        return Running(job, "Installing tnst-mi", lambda: f"Installed in {private}")


class TNST_MI_OT_check(bpy.types.Operator):
    """Say which tnst-mi is run"""

    bl_idname = "tnst_mi.check"
    bl_label = "Check"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Look for it."""
        chosen = bpy.path.abspath(preferences_of(context).program)
        forget_checks()
        try:
            found = find_environment(chosen, private_folder())
        except EnvironmentMissing as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"tnst-mi {found.version} ({found.origin}): {found.program}")
        return {"FINISHED"}


_CLASSES = (TnstMiPreferences, TNST_MI_OT_install, TNST_MI_OT_check)

register, unregister = bpy.utils.register_classes_factory(_CLASSES)
