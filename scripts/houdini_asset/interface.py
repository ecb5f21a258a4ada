"""All parameters of the asset in their folders, and the table by which its Python code reads them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from houdini_asset import dialog
from houdini_asset.controls import parms_of

OPERATOR, LABEL = "tnst_mi::stylize::1.0", "TNST Stylize"

#: Keys that the asset decides itself: the frames are all that it writes, and results are .vdb as the input is.
DECIDED = ("frames", "context", "format")

#: Folders by section of the recipe.
FOLDERS = {"Goals": "Goals", "Method": "Method", "Colouring": "Colour", "Resources": "Run", "Reading": "Input"}

#: Of each section, the keys that artists turn to first; the others are in a folder that opens.
_FIRST = {
    "Goals": ("style", "tag", "semantic", "mask", "target"),
    "Method": (
        *("preset", "quality", "strength", "motif_size", "gamma", "look", "iterations", "eta", "octaves", "views"),
        *("camera", "azimuth", "elevation", "window", "coherence", "reach", "keep_silhouette", "seed"),
    ),
}

_PYTHON = {"script_callback_language": "python"}


def shown(parameters: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The keys that have parameters."""
    return [about for about in parameters if about["key"] not in DECIDED]


def dialog_script(parameters: Sequence[dict[str, Any]], suggestions: dict[str, list[str]]) -> str:
    """The DialogScript of the asset.

    Args:
        parameters: what `tnst_mi.recipe.parameters` says.
        suggestions: texts to choose from, by key.
    """
    folders = [dialog.folder("stylize_folder", "Stylize", _own())]
    for section, label in FOLDERS.items():
        keys = {about["key"]: about for about in shown(parameters) if about["section"] == section}
        names = _FIRST.get(section, tuple(keys))
        first = [parm for key in names for parm in parms_of(keys.pop(key), suggestions)]
        more = [parm for about in keys.values() for parm in parms_of(about, suggestions)]
        name = f"{section.lower()}_folder"
        if more:
            first.append(dialog.folder(f"{name}_details", "Details", more, "groupcollapsible"))
        folders.append(dialog.folder(name, label, first))
    return dialog.script(OPERATOR, LABEL, ["VDBs of the smoke"], folders)


def table(parameters: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """What the asset's Python code has to know of each key."""
    names = ("key", "kind", "default", "words", "keyable")
    return [{name: about[name] for name in names} for about in shown(parameters)]


def _own() -> list[str]:
    """The parameters that are none of a recipe's keys."""

    def button(name: str, label: str, help: str, join: bool) -> str:
        tags = {"script_callback": f"hou.phm().{name}(kwargs['node'])", **_PYTHON}
        return dialog.parm(name, label, "button", ["0"], help=help, join=join, tags=tags)

    return [
        button("stylize", "Stylize", "Write the input of all frames, and begin to stylize them.", True),
        button("resume", "Resume", "Go on where the run of this folder was stopped, by its own recipe.", True),
        button("cancel", "Cancel", "Stop the run. What it has got stays, and Resume goes on from there.", False),
        dialog.parm(
            "range",
            "Start/End",
            "integer",
            ["$FSTART", "$FEND"],
            help="First and last frame to stylize, both included.",
        ),
        dialog.parm(
            "folder",
            "Folder",
            "directory",
            ["$HIP/tnst_mi/$HIPNAME.$OS"],
            help="Where the input, the recipe, the log and the results are written.",
        ),
        dialog.parm(
            "replace",
            "Replace an Earlier Run",
            "toggle",
            ["0"],
            help="Whether Stylize may remove the results that are in the folder.",
        ),
        dialog.parm(
            "result",
            "Results",
            "file",
            ['`chs("folder")`/run/density/smoke.$F4.vdb'],
            help="The files that this node shows: those of its own run, unless you choose others.",
        ),
        dialog.parm(
            "program",
            "tnst-mi Program",
            "file",
            [""],
            help="tnst-mi, or the folder of the Python environment that it is installed in. If empty, that of "
            "$TNST_MI_PROGRAM, else the one on the PATH.",
        ),
        dialog.parm(
            "cluster",
            "Cluster",
            "string",
            [""],
            help="Who does the work: local:4 (four processes), tcp://HOST:PORT (a Dask cluster) or slurm:FILE "
            "(docs/cluster.md). If empty, one process on this machine.",
        ),
    ]
