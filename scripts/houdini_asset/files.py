"""The files of the asset, expanded as Houdini's `hotl -t` leaves it: text that `hotl -l` collapses into an .hda."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from houdini_asset.interface import LABEL, OPERATOR, dialog_script

# Within names of folders, / is _1, : is _8 and _ is itself twice.
_TYPE = "tnst_mi::Sop/stylize::1.0"
DEFINITION = _TYPE.replace("_", "__").replace("/", "_1").replace(":", "_8")

_INDEX = {
    "Operator": OPERATOR,
    "Label": LABEL,
    "Path": f"oplib:/{_TYPE}?{_TYPE}",
    "Icon": "SOP_vdb",
    "Table": "Sop",
    "License": "",
    "Extra": "",
    "User": "",
    "Inputs": "1 to 1",
    "Subnet": "false",
    "Python": "true",
    "Empty": "false",
    "Modified": "Sat Nov 28 00:00:00 2026",
}

_CREATE = f"""\
# Automatically generated script
\\set noalias = 1
#
#  Creation script for {OPERATOR} operator
#

if ( "$arg1" == "" ) then
    echo This script is intended as a creation script
    exit
endif

# Node $arg1 ({_TYPE})
opexprlanguage -s hscript $arg1
opuserdata -n '___Version___' -v '' $arg1
"""

_COOK = '''\
"""Show the results of the current frame, or the input where there are none."""

import hou

try:
    from tnst_mi_houdini import node
except ImportError:
    raise hou.NodeError(
        "Houdini's Python does not find tnst_mi_houdini; put integrations/houdini/tnst_mi.json in a packages folder, "
        "with the path of your checkout in it (docs/houdini.md)"
    )

node.cook(hou.pwd())
'''

_MODULE = '''\
"""What the buttons call."""

from tnst_mi_houdini.node import cancel, resume, stylize
'''

_DELETED = '''\
"""A run ends with its node."""

kwargs["node"].hdaModule().cancel(kwargs["node"])
'''

_OPTIONS = """\
CheckExternal := 1;
ContentsCompressionType := 1;
ForbidOutsideParms := 1;
GzipContents := 1;
LockContents := 1;
MakeDefault := 1;
ParmsFromVfl := 0;
PrefixDroppedParmLabel := 0;
PrefixDroppedParmName := 0;
SaveCachedCode := 0;
SaveIcon := 1;
SaveSpareParms := 0;
UnlockOnCreate := 0;
UseDSParms := 1;
"""

_TOOLS = """\
<?xml version="1.0" encoding="UTF-8"?>
<shelfDocument>
  <tool name="$HDA_DEFAULT_TOOL" label="$HDA_LABEL" icon="$HDA_ICON">
    <toolMenuContext name="viewer">
      <contextNetType>SOP</contextNetType>
    </toolMenuContext>
    <toolMenuContext name="network">
      <contextOpType>$HDA_TABLE_AND_NAME</contextOpType>
    </toolMenuContext>
    <toolSubmenu>VDB</toolSubmenu>
    <script scriptType="python"><![CDATA[import soptoolutils

soptoolutils.genericTool(kwargs, '$HDA_NAME')]]></script>
  </tool>
</shelfDocument>
"""

_HELP = f"""\
= {LABEL} =

#type: node
#context: sop
#internal: stylize

\"\"\"Gives smoke the style of a picture by moving it, with tnst-mi.\"\"\"

The input are VDBs: `density`, and for sequences that are to be steady in time the velocity as `vel` (or `vel.x`,
`vel.y`, `vel.z`). *Stylize* writes them frame by frame, runs tnst-mi as a process beside Houdini, and shows its results
frame by frame as they are done: the same grids, moved, with the same names and at the same place.

Every parameter of the folders after the first is a key of the recipe, by its name; rest the mouse on one for what it
does. Animated parameters become keyframes of the recipe where it allows that. See docs/houdini.md and docs/recipes.md
of tnst_mi.
"""


def files(parameters: Sequence[dict[str, Any]], suggestions: dict[str, list[str]]) -> dict[str, str]:
    """The text of each file, by its path within the asset's folder."""
    sections = {
        "DialogScript": dialog_script(parameters, suggestions),
        "PythonCook": _COOK,
        "TypePropertiesOptions": _OPTIONS,
        "Help": _HELP,
        "Tools.shelf": _TOOLS,
        "FunctionName": OPERATOR,
        "CreateScript": _CREATE,
        "PythonModule": _MODULE,
        "OnDeleted": _DELETED,
        "ExtraFileOptions": _extra_options("PythonModule", "OnDeleted"),
    }
    return {
        "houdini.hdalibrary": "",
        "INDEX__SECTION": "".join(f"{name + ':':14}{value}\n" for name, value in _INDEX.items()) + "\n",
        "Sections.list": _listed(
            {"INDEX__SECTION": "INDEX_SECTION", DEFINITION: _TYPE, "houdini.hdalibrary": "houdini.hdalibrary"}
        ),
        f"{DEFINITION}/Sections.list": _listed({name: name for name in sections}),
        **{f"{DEFINITION}/{name}": text for name, text in sections.items()},
    }


def _listed(names: dict[str, str]) -> str:
    """The sections of a folder: the name of each file, and that of its section."""
    return '""\n' + "".join(f"{file}\t{section}\n" for file, section in names.items())


def _extra_options(*scripts: str) -> str:
    """That sections are scripts in Python."""
    options = {}
    for name in scripts:
        options[f"{name}/IsExpr"] = {"type": "bool", "value": False}
        options[f"{name}/IsPython"] = {"type": "bool", "value": True}
        options[f"{name}/IsScript"] = {"type": "bool", "value": True}
        options[f"{name}/Source"] = {"type": "string", "value": ""}
    return json.dumps(options, indent="\t", separators=(",", ":")) + "\n"
