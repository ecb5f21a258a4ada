"""The colour of smoke in the studio: a grid of albedo in place of the one grey number that a look's scene states."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np

#: The parameter of such a scene that holds the albedo, (D, H, W, 3).
ALBEDO = "smoke.interior_medium.albedo.data"


def load_coloured(file: Path, **parameters: object) -> tuple[mi.Scene, float]:
    """Load the scene of a look with a grid of albedo, on the box of its density.

    Args:
        file: the scene.
        parameters: values of its $names.

    Returns:
        The scene, and the albedo that it states: that of white smoke.
    """
    config = mi.parser.ParserConfig(mi.variant())
    state = mi.parser.parse_file(config, str(file), **{name: str(value) for name, value in parameters.items()})
    mi.parser.transform_all(config, state)
    nodes = {node.props.plugin_name(): node.props for node in state.nodes}
    smoke, density, sky = nodes["heterogeneous"], nodes["gridvolume"], nodes["envmap"]
    white = float(mi.ScalarColor3f(smoke["albedo"])[0])
    smoke["albedo"] = mi.load_dict(
        {
            "type": "gridvolume",
            "grid": mi.VolumeGrid(np.full((2, 2, 2, 3), white, np.float32)),
            "to_world": density["to_world"],
            "raw": True,
            "accel": False,
        }
    )
    # Relative to the scene, whose folder only `mi.load_file` looks into.
    sky["filename"] = str(file.parent / sky["filename"])
    scene = mi.parser.instantiate(config, state)
    return scene, white


def albedo_of(colour: np.ndarray, white: float) -> np.ndarray:
    """The albedo (D, H, W, 3) of smoke of a colour (D, H, W, 3), linear RGB: times that of white smoke, at most it."""
    return np.ascontiguousarray(white * np.clip(colour, 0.0, 1.0), np.float32)
