"""A Mitsuba scene file, rendered by its own integrator or by another one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi

from tnst_mi.compare.bench.renderers.renderer import SideRenderer
from tnst_mi.compare.bench.renderers.sides import OURS, PATH_TRACERS, Side
from tnst_mi.errors import InputError
from tnst_mi.machine.optix import require_optix

#: γ of ours in scene files: media emit 1e-6 of their extinction, so that the transmittance of what is behind remains.
SCENE_GAMMA = 1e6

#: What an integrator takes over from the one that it replaces.
_TAKEN_OVER = ("max_depth", "rr_depth", "hide_emitters")

#: Pixels of an image, at most: all batches of it are in memory.
_MOST_PIXELS = 1 << 18


def scene_renderer(path: Path, side: Side) -> SideRenderer:
    """The renderer of a scene file: with its own integrator, or with that of a side of ours or of a path tracer.

    Raises:
        InputError: the file cannot be read, has no sensor, or an image that is too large.
    """
    require_optix("compare")
    scene = _loaded(path)
    if not scene.sensors():
        raise InputError(f"{path}: the scene has no sensor, expected one")
    film = scene.sensors()[0].film()
    if film.class_name() == "SpecFilm":
        raise InputError(f"{path}: the film of its sensor has bands of wavelengths, expected an hdrfilm")
    columns, rows = (int(edge) for edge in film.crop_size())
    if columns * rows > _MOST_PIXELS:
        raise InputError(
            f"{path}: the image has {columns}×{rows} pixels, expected at most {_MOST_PIXELS}; make its film smaller"
        )
    integrator = scene.integrator()
    if side.kind in PATH_TRACERS or side.kind == OURS:
        integrator = mi.load_dict(_replacement(path, side))
    elif integrator is None:
        raise InputError(f"{path}: the scene has no integrator, expected one")
    return SideRenderer(scene, integrator, 1, False, side.kind != OURS)


def _loaded(path: Path) -> mi.Scene:
    try:
        return mi.load_file(str(path))
    except Exception as error:  # Mitsuba's parser and plugins raise RuntimeError, TypeError, …, on many lines
        reason = next((line for line in str(error).splitlines() if line.strip()), repr(error))
        raise InputError(f"{path}: cannot be read as a Mitsuba scene ({reason.strip()})") from None


def _replacement(path: Path, side: Side) -> dict[str, Any]:
    """The description of an integrator with the depths of the one that the file has."""
    if side.kind == OURS:
        return {"type": OURS, "gamma": SCENE_GAMMA, "quadrature": side.quadrature}
    nodes = mi.parser.parse_file(mi.parser.ParserConfig(mi.variant()), str(path)).nodes
    # The outermost comes first.
    integrators = [node.props for node in nodes if node.type == mi.ObjectType.Integrator]
    found = {name: next((own[name] for own in integrators if name in own), None) for name in _TAKEN_OVER}
    return {"type": side.kind} | {name: value for name, value in found.items() if value is not None}
