"""The states that a run leaves in its folder, state/NAME.safetensors, from which another run can go on.

A file holds what is optimised of one frame, in the cells of the octave in which the run ended: never more than the
velocities that it writes too, and with a motif size far less. The run does not need it any more.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save

from tnst_mi.io.atomic import written_whole
from tnst_mi.optimisation.start import State
from tnst_mi.run.written import written


def state_file(out: Path, name: str) -> Path:
    """The file with the state of a frame in the folder of a run."""
    return out / "state" / f"{name}.safetensors"


def write_state(out: Path, name: str, state: State) -> dict[str, Any]:
    """Write the state of a frame; returns what run.json holds of it."""
    words = {"octave": state.octave, "iterations": state.iterations, "scales": dict(state.scales)}
    fields = {key: np.ascontiguousarray(field) for key, field in state.fields.items()}
    path = state_file(out, name)
    with written_whole(path) as temporary:
        # One entry: several are written in another order each time.
        temporary.write_bytes(save(fields, {"state": json.dumps(words)}))
    (of_file,) = written(out, [path]).values()
    return {"octave": state.octave, "iterations": state.iterations, **of_file}


def read_state(path: Path, fields: bool = True) -> State:
    """The state of a frame; whatever is raised means that the file is not what was written.

    Args:
        path: the file.
        fields: whether to read what is optimised too, rather than how far it has got alone.
    """
    with safe_open(path, framework="numpy") as file:
        words: dict[str, Any] = json.loads(file.metadata()["state"])
        found = {name: file.get_tensor(name) for name in file.keys()} if fields else {}
    return State(words["octave"], words["iterations"], found, words["scales"])
