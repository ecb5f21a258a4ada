"""Text for the Generate callback of a Python Processor in TOPs: a work item for each shot and each variation.

Paste it, change the first part, and cook the node: the Local Scheduler and those of farms run the command line of each
item. TOPs gives `item_holder`. Items have the attributes `recipe`, `shot`, `variation`, `out` and `results` (a pattern
with ####) for the nodes below.
"""

from pathlib import Path

import hou
from tnst_mi_houdini.environment import find_program
from tnst_mi_houdini.work_items import work_items

SHOTS = {"sh010": hou.text.expandString("$HIP") + "/sh010/smoke.$F4.vdb"}
BASE = {"tag": ["fire"], "weights": "patterns", "window": 9, "fps": hou.fps()}
VARIATIONS = {"motif_size": [0.15, 0.25], "eta": [0.002, 0.004]}
FOLDER = Path(hou.text.expandString("$HIP/tnst_mi/wedges"))
PROGRAM = find_program("", {name: hou.getenv(name) or "" for name in ("PATH", "HFS", "TNST_MI_PROGRAM")})
CLUSTER = ""  # or "local:4", "tcp://HOST:PORT", "slurm:FILE"

for index, item in enumerate(work_items(PROGRAM, SHOTS, BASE, VARIATIONS, FOLDER, CLUSTER)):
    work_item = item_holder.addWorkItem(index=index)  # noqa: F821 (a name that TOPs gives)
    for name, text in (
        ("recipe", item.recipe),
        ("shot", item.shot),
        ("variation", item.name),
        ("out", item.out),
        ("results", item.results),
    ):
        work_item.setStringAttrib(name, str(text))
    work_item.setCommand(item.command)
