"""Writes a stage of USD (.usda, .usdc, .usd) that shows smoke, by Pixar's library, which tnst_mi[usd] installs.

A `UsdVol.Volume` has a field of the kind `UsdVol.OpenVDBAsset` for each grid, whose file is another in every frame.
Time codes are the numbers of frames, and lengths are metres. What is read of untrusted stages is read in another
process (`tnst_mi.io.cameras`); here the library gets nothing but what we write.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.geometry.affine import Affine
from tnst_mi.io.atomic import write_failure, written_whole
from tnst_mi.io.stages.asset_paths import asset_path
from tnst_mi.io.stages.own_stages import metadata
from tnst_mi.io.stages.smoke_volume import VolumeField, VolumeFrame

#: Extensions of stages: text, binary, and either, of which the library takes the binary.
STAGES = (".usda", ".usdc", ".usd")

_MODULES = ("Gf", "Kind", "Sdf", "Tf", "Usd", "UsdGeom", "UsdVol", "Vt")


def usd_library(path: Path) -> Any:
    """Pixar's library, which takes some 60 MB, and is loaded only where it is needed.

    Args:
        path: the stage that it is for.

    Raises:
        InputError: it is not installed, or cannot be imported.
    """
    if importlib.util.find_spec("pxr") is None:
        raise InputError(f"{path}: stages of USD need Pixar's library: pip install 'tnst_mi[usd]' (or usd-core)")
    try:
        for name in _MODULES:
            importlib.import_module(f"pxr.{name}")
        return importlib.import_module("pxr")
    except ImportError as error:
        raise InputError(
            f"{path}: Pixar's library cannot be imported ({error}); install it again: "
            "pip install --force-reinstall usd-core"
        ) from None


def write_stage(path: Path, frames: Sequence[VolumeFrame], up: str, frames_per_second: float) -> list[str]:
    """Write a stage with one volume, its default prim.

    Args:
        path: the stage; its extension selects text or binary.
        frames: the volume by time; a single one without a number does not depend on it.
        up: the axis of the scene that is up, "y" or "z".
        frames_per_second: of the time codes.

    Returns:
        The paths by which it names the files of the frames.

    Raises:
        InputError: there is no library, or no frame has an active voxel.
        OSError: it cannot be written.
    """
    pxr = usd_library(path)
    if all(frame.extent is None for frame in frames):
        raise InputError(f"{frames[0].path}: neither it nor any other frame has an active voxel to show")
    stage = pxr.Usd.Stage.CreateInMemory()
    stage.GetRootLayer().customLayerData = metadata()
    pxr.UsdGeom.SetStageUpAxis(stage, up.upper())
    pxr.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(frames_per_second)
    stage.SetFramesPerSecond(frames_per_second)
    numbers = [float(frame.number) for frame in frames if frame.number is not None]
    if numbers:
        stage.SetStartTimeCode(min(numbers))
        stage.SetEndTimeCode(max(numbers))
    root = pxr.UsdGeom.Xform.Define(stage, f"/{pxr.Tf.MakeValidIdentifier(path.stem)}")
    stage.SetDefaultPrim(root.GetPrim())
    pxr.Usd.ModelAPI(root.GetPrim()).SetKind(pxr.Kind.Tokens.component)
    volume = pxr.UsdVol.Volume.Define(stage, root.GetPath().AppendChild("volume"))
    _place(pxr, volume, frames)
    paths, names = [asset_path(frame.path, path) for frame in frames], set[str]()
    for field in dict.fromkeys((field.grid, field.index) for frame in frames for field in frame.fields):
        name = _free_name(pxr.Tf.MakeValidIdentifier(field[0]), names)
        names.add(name)
        asset = pxr.UsdVol.OpenVDBAsset.Define(stage, volume.GetPath().AppendChild(name))
        volume.CreateFieldRelationship(name, asset.GetPath())
        _describe(pxr, asset, field, frames, paths)
    with written_whole(path) as unfinished:
        try:
            stage.GetRootLayer().Export(str(unfinished))
        except pxr.Tf.ErrorException as error:
            raise write_failure(unfinished, "cannot be written by Pixar's library") from error
    return paths


def _place(pxr: Any, volume: Any, frames: Sequence[VolumeFrame]) -> None:
    """The boxes of the voxels and, where files place them wrongly, what puts them right."""
    extent = volume.CreateExtentAttr()
    correction = None
    if any(frame.correction is not None for frame in frames):
        correction = volume.AddTransformOp(opSuffix="adaptiveDomain")
    for frame in frames:
        time = _time(pxr, frame)
        if frame.extent is not None:  # in between there is nothing to be seen
            extent.Set(pxr.Vt.Vec3fArray.FromNumpy(frame.extent.astype(np.float32)), time)
        if correction is not None:
            correction.Set(pxr.Gf.Matrix4d(_on_rows(frame.correction).tolist()), time)


def _describe(pxr: Any, asset: Any, key: tuple[str, int], frames: Sequence[VolumeFrame], paths: Sequence[str]) -> None:
    """Which grid a field is, and in which file it is in each frame."""
    file_path = asset.CreateFilePathAttr()
    told: VolumeField | None = None
    for frame, path in zip(frames, paths, strict=True):
        field = next((field for field in frame.fields if (field.grid, field.index) == key), None)
        # No value at all, or the file of an earlier frame would be taken.
        where = pxr.Sdf.ValueBlock() if field is None else pxr.Sdf.AssetPath(path)
        file_path.Set(where, _time(pxr, frame))
        told = told or field
    assert told is not None, "every field is one of a frame"
    asset.CreateFieldNameAttr(told.grid)
    if told.index:
        asset.CreateFieldIndexAttr(told.index)
    if told.data_type:
        asset.CreateFieldDataTypeAttr(told.data_type)
    if told.grid_class:
        asset.CreateFieldClassAttr(told.grid_class)
    if told.role != "None":
        asset.CreateVectorDataRoleHintAttr(told.role)


def _time(pxr: Any, frame: VolumeFrame) -> Any:
    return pxr.Usd.TimeCode.Default() if frame.number is None else pxr.Usd.TimeCode(float(frame.number))


def _free_name(wanted: str, taken: set[str]) -> str:
    """A name that no other field has, such as density_1 for a second density."""
    name, number = wanted, 0
    while name in taken:
        number += 1
        name = f"{wanted}_{number}"
    return name


def _on_rows(map: Affine | None) -> np.ndarray:
    """A map as a matrix (4, 4) that is applied to rows, as USD has it."""
    matrix = np.eye(4)
    if map is not None:
        matrix[:3, :3], matrix[3, :3] = map.matrix.T, map.offset
    return matrix
