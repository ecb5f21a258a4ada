"""Reading a file of cameras with their pictures, of whichever kind."""

from __future__ import annotations

from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.machine.gate import opening
from tnst_mi.reconstruction.camera_sets.mitsuba_sensors import read_sensors
from tnst_mi.reconstruction.camera_sets.nerf_transforms import read_transforms
from tnst_mi.reconstruction.camera_sets.own_tables import read_own_tables
from tnst_mi.reconstruction.camera_sets.posed_view import CameraSet
from tnst_mi.reconstruction.camera_sets.view_names import require_usable_names

_READERS = {".toml": read_own_tables, ".json": read_transforms, ".xml": read_sensors}


def read_camera_set(path: Path) -> CameraSet:
    """Read a file of cameras with their pictures: our TOML, a NeRF's JSON, or a Mitsuba scene.

    Raises:
        InputError: it cannot be read, or is none of these.
    """
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise InputError(
            f"{path}: expected a file of cameras: our .toml, a NeRF's transforms.json, or a Mitsuba scene (.xml)"
        )
    with opening(path, "a file of cameras"):
        found = _READERS[suffix](path)
    require_usable_names(path, [view.name for view in found.views])
    return found
