"""Undamaged stages of USD with a camera, as text, in binary and packed; they need usd-core."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any


def stages(folder: Path) -> Iterator[bytes]:
    """Stages as text and in binary, both of which may be called .usd."""
    for suffix in (".usda", ".usdc"):
        for number, moves in enumerate((False, True)):
            path = folder / f"stage{number}{suffix}"
            _write(path, moves)
            yield path.read_bytes()


def packages(folder: Path) -> Iterator[bytes]:
    """The same as .usdz."""
    write_package = importlib.import_module("pxr.UsdUtils").CreateNewUsdzPackage
    for suffix in (".usda", ".usdc"):
        stage, package = folder / f"packed{suffix}", folder / f"{suffix[1:]}.usdz"
        _write(stage, moves=True)
        write_package(str(stage), str(package))
        yield package.read_bytes()


def _write(path: Path, moves: bool) -> None:
    """A stage with a camera on a rig, some points, and an instance of these."""
    gf, usd, geometry = (importlib.import_module(f"pxr.{name}") for name in ("Gf", "Usd", "UsdGeom"))
    # Pixar's library has stages that it knows by their paths.
    stage: Any = usd.Stage.CreateInMemory()
    geometry.SetStageUpAxis(stage, "Z")
    geometry.SetStageMetersPerUnit(stage, 0.01)
    rig = geometry.Xform.Define(stage, "/rig")
    place, turn = rig.AddTranslateOp(), rig.AddRotateXYZOp()
    camera = geometry.Camera.Define(stage, "/rig/main")
    for time in (1, 3, 4.5) if moves else (usd.TimeCode.Default(),):
        place.Set(gf.Vec3d(3, -4, 2), time)
        turn.Set(gf.Vec3f(70, 10, 15), time)
        camera.GetFocalLengthAttr().Set(35.0, time)
    rig.AddScaleOp().Set(gf.Vec3f(2, 2, 2))
    points = geometry.Points.Define(stage, "/smoke/points")
    points.GetPointsAttr().Set([gf.Vec3f(n, n % 3, -n) for n in range(40)])
    stage.DefinePrim("/other").GetReferences().AddInternalReference("/smoke")
    stage.GetPrimAtPath("/other").SetInstanceable(True)
    stage.GetRootLayer().Export(str(path))
