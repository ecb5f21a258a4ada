"""Our own files of views: TOML with a table of settings and one for each view (docs/reconstruction.md)."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError, naming
from tnst_mi.io.bounded_toml import toml_values
from tnst_mi.io.cameras.scene_camera import SceneCamera
from tnst_mi.io.cameras.tables import KEYS, camera_of
from tnst_mi.recipe.paths import shipped_lights
from tnst_mi.reconstruction.camera_sets.pixel_rays import RayCamera, read_ray_camera
from tnst_mi.reconstruction.camera_sets.posed_view import CameraSet, PosedView
from tnst_mi.resources import expanded

#: Longest file in bytes, for which Python's reader takes seconds.
_LONGEST = 1 << 20

#: Keys of a view beside those of its camera.
_PICTURES = ("image", "mask", "background")

#: The other keys that a camera has not.
_OTHERS = ("held_out", "rays", "layer")

#: Most pictures in a file of several.
_LAYERS = 10_000


def read_own_tables(path: Path) -> CameraSet:
    """Read a file of ours; everything in it is checked but the pictures.

    Raises:
        InputError: it is too large or deep, or holds something else.
        ValueError: it is no TOML.
        OSError: it cannot be read.
    """
    if (size := path.stat().st_size) > _LONGEST:
        raise InputError(f"{path}: {size} bytes, expected a file of cameras of at most {_LONGEST}")
    text = path.read_bytes().decode("utf-8-sig")
    with naming(path):
        values = toml_values(text.replace("\r\n", "\n"))
        shared = dict(values)
        up, views, settings = (shared.pop(key, None) for key in ("up_axis", "views", "reconstruction"))
        if up not in (None, "y", "z"):
            raise InputError(f'up_axis = {reprlib.repr(up)}: expected "y" or "z"')
        if not isinstance(views, dict) or not views:
            raise InputError("expected a table [views.NAME] for each view, with image and the keys of a camera")
        up, assumed = up or "y", () if up else ('up_axis: is not there, taken as "y"',)
        for name, table in [("", shared), *views.items()]:
            _require_known(name, _table(name, table))
        tables = {name: shared | _table(name, table) for name, table in views.items()}
        by_rays = {name: _rays(name, table, path.parent) for name, table in tables.items() if "rays" in table}
        found = [_view(name, table, up, path.parent, by_rays.get(name)) for name, table in tables.items()]
        assumed = (*assumed, *_said_of_rays(by_rays, len(found)))
        return CameraSet(path, up, found, _settings(_table("reconstruction", settings or {}), path.parent), assumed)


def _require_known(name: str, table: Mapping[str, Any]) -> None:
    """Check that all keys are those of a view, whose table has a name, or such keys above all of them.

    Raises:
        InputError: one is not.
    """
    known = (*_PICTURES, *_OTHERS, *KEYS)
    if unknown := [key for key in table if key not in known]:
        near = difflib.get_close_matches(unknown[0], (*known, "up_axis", "reconstruction", "views"), 1)
        remedy = f"did you mean {near[0]!r}?" if near else f"expected one of {', '.join(known)}"
        where = f"view {name}: " if name else ""
        raise InputError(f"{where}unknown key {reprlib.repr(unknown[0])}; {remedy}")


def _table(name: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{name}: is {reprlib.repr(value)}, expected a table of keys")
    return value


def _settings(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The settings, of which a light is beside the file that names it, as pictures are."""
    light = table.get("light")
    if not isinstance(light, str) or light in shipped_lights():
        return table
    return {**table, "light": str(folder / expanded(Path(light)))}


def _rays(name: str, table: Mapping[str, Any], folder: Path) -> RayCamera:
    with naming(Path(f"view {name}")):
        if other := [key for key in table if key in KEYS]:
            raise InputError(f"{other[0]}: is of another camera than rays, which say all of it; leave it out")
        return read_ray_camera(_path("rays", table["rays"], folder))


def _said_of_rays(cameras: Mapping[str, RayCamera], views: int) -> list[str]:
    """What is to be said of cameras that stand in for rays.

    Raises:
        InputError: they do not stand in one scene.
    """
    if not cameras:
        return []
    turned = {camera.turned for camera in cameras.values()}
    if len(turned) > 1 or (turned == {True} and len(cameras) < views):
        odd = next(name for name, camera in cameras.items() if camera.turned)
        raise InputError(f"view {odd}: its rays are of a left-handed scene, and others are not; mirror its picture")
    worst = max(camera.error for camera in cameras.values())
    said = [f"rays: pinholes with square pixels stand in for them, {worst:.2g} pixels off (RMS) in the worst view"]
    if turned == {True}:
        said.append("rays: their scene is left-handed, and its z is turned round: so are the box and the density")
    return said


def _view(name: str, table: Mapping[str, Any], up: str, folder: Path, by_rays: RayCamera | None) -> PosedView:
    camera = dict(table)
    with naming(Path(f"view {name}")):
        files = {key: _path(key, camera.pop(key), folder) for key in _PICTURES if key in camera}
        held_out = camera.pop("held_out", False)
        if not isinstance(held_out, bool):
            raise InputError(f"held_out = {reprlib.repr(held_out)}: expected true or false")
        if "image" not in files:
            raise InputError('image: is not there, expected a file, such as "left.png"')
        if (layer := camera.pop("layer", None)) is not None:
            layer = _layer(layer)
        if by_rays is not None:
            return PosedView(name, camera=lambda size: by_rays.camera, held_out=held_out, layer=layer, **files)
        # Checked now, with a size that any camera can have, and not when all pictures have been read.
        if "aspect" not in camera:
            _camera(camera, up, (1, 1))
        return PosedView(name=name, camera=partial(_camera, camera, up), held_out=held_out, layer=layer, **files)


def _layer(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < _LAYERS:
        raise InputError(f"layer = {reprlib.repr(value)}: expected the number of a picture in its file, from 0")
    return value


def _path(key: str, value: Any, folder: Path) -> Path:
    if not isinstance(value, str) or not value or "\0" in value:
        raise InputError(f"{key} = {reprlib.repr(value)}: expected the name of a file")
    return folder / value


def _camera(table: Mapping[str, Any], up: str, size: tuple[int, int]) -> SceneCamera:
    """The camera of a table, whose picture has square pixels unless it says an aspect."""
    known = "aspect" in table or "resolution" in table
    return camera_of(table if known else {**table, "resolution": list(size)}, up)
