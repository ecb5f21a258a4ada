"""`tnst-mi convert INPUT out.usda`: what Pixar's library finds on the stage, and what its checker says."""

from __future__ import annotations

import errno
import importlib.util
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Run, refused, run

from tnst_mi.cli import main
from tnst_mi.commands import convert_stage
from tnst_mi.frame import Frame
from tnst_mi.geometry.affine import Affine
from tnst_mi.io import save_frames
from tnst_mi.io.grids.vdb import DenseGrid, write_vdb
from tnst_mi.io.stages import asset_paths
from tnst_mi.recipe.recipe import Recipe

__all__ = ["run"]

usd = pytest.mark.skipif(importlib.util.find_spec("pxr") is None, reason="no usd-core: pip install 'tnst_mi[usd]'")

#: Of the sequence below: where its smoke begins in each frame, in voxels, and its extents.
LOWS, EXTENTS, EDGE, OFFSET = {-1: (0, 0, 0), 0: (3, -2, 1), 1: (40, 5, 9)}, (4, 5, 6), 0.25, (1.0, 2.0, 3.0)


def box(low: tuple[int, ...], extents: tuple[int, ...] = EXTENTS, edge: float = EDGE, offset: Any = OFFSET) -> Any:
    """The lowest and the highest corner of the voxels in the scene."""
    first = np.array(low) - 0.5
    return np.array([first, first + extents]) * edge + offset


def grid(name: str, low: tuple[int, int, int], components: int = 1, **keys: Any) -> DenseGrid:
    shape = (*EXTENTS[::-1], 3) if components == 3 else EXTENTS[::-1]
    return DenseGrid(name, np.ones(shape, np.float32), low, transform=Affine.scaling(EDGE, OFFSET), **keys)


@pytest.fixture
def moving(tmp_path: Path) -> Path:
    """Three frames, -1 to 1, of smoke that moves, with vectors and two grids of one name; frame 0 has no flame."""
    for number, low in LOWS.items():
        grids = [grid("density", low), grid("vel", low, 3), grid("Cd", low, 3), grid("force", low, 3)]
        flames = [] if number == 0 else [grid("flame", low)]
        again = [grid("density", low), grid("a.b", low, grid_class="level set")]
        write_vdb(tmp_path / "cache" / f"smoke.{number:04d}.vdb", [*grids, *flames, *again], {})
    return tmp_path / "cache"


def opened(path: Path) -> Any:
    stage = importlib.import_module("pxr.Usd").Stage.Open(str(path))
    stage.Reload()  # the library keeps what it has opened
    return stage


def volume_of(stage: Any) -> Any:
    """The volume of a stage, which has to be the only one and below the default prim."""
    (volume,) = [prim for prim in stage.Traverse() if prim.GetTypeName() == "Volume"]
    assert volume.GetParent() == stage.GetDefaultPrim()
    return importlib.import_module("pxr.UsdVol").Volume(volume)


def fields_of(stage: Any) -> dict[str, Any]:
    """The fields of its volume, by the names of the relations."""
    vol = importlib.import_module("pxr.UsdVol")
    return {
        name: vol.OpenVDBAsset(stage.GetPrimAtPath(path)) for name, path in volume_of(stage).GetFieldPaths().items()
    }


def extent_at(stage: Any, time: float) -> np.ndarray:
    """The box of the volume at a time, in the world."""
    geometry = importlib.import_module("pxr.UsdGeom")
    cache = geometry.BBoxCache(time, [geometry.Tokens.default_])
    found = cache.ComputeWorldBound(volume_of(stage).GetPrim()).ComputeAlignedRange()
    return np.array([found.GetMin(), found.GetMax()])


def require_valid(stage: Any) -> None:
    """Have all of Pixar's validators check a stage; older libraries have one checker instead."""
    try:
        validation = importlib.import_module("pxr.UsdValidation")
    except ImportError:
        checker = importlib.import_module("pxr.UsdUtils").ComplianceChecker()
        checker.CheckCompliance(stage.GetRootLayer().realPath)
        found = [*checker.GetErrors(), *checker.GetWarnings(), *checker.GetFailedChecks()]
    else:
        validators = validation.ValidationRegistry().GetOrLoadAllValidators()
        assert len(validators) > 5
        errors = validation.ValidationContext(validators).Validate(stage)
        found = [error.GetErrorAsString() for error in errors]
    assert found == []


@usd
@pytest.mark.parametrize("suffix", ["usda", "usdc", "usd"])
def test_a_sequence_is_a_volume_whose_files_change(run: Run, moving: Path, tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"out.{suffix}"
    ran = run("convert", moving, out, "--fps", "25")
    assert (ran.code, ran.errors) == (0, ["note: y is up, no metadata say otherwise (--up)"])
    grids = "density, vel, Cd, force, flame, a.b"
    assert ran.out == f"stage     {out}: frames -1 to 1, y up, in metres, 25 fps: {grids}\n"
    assert out.read_bytes().startswith(b"#usda" if suffix == "usda" else b"PXR-USDC")
    # What it names goes with it.
    elsewhere = tmp_path / "else where"
    elsewhere.mkdir()
    shutil.move(moving, elsewhere / "cache")
    stage = opened(shutil.move(out, elsewhere / out.name))
    require_valid(stage)
    geometry = importlib.import_module("pxr.UsdGeom")
    assert (geometry.GetStageUpAxis(stage), geometry.GetStageMetersPerUnit(stage)) == ("Y", 1.0)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (-1, 1)
    assert (stage.GetTimeCodesPerSecond(), stage.GetFramesPerSecond()) == (25, 25)
    assert volume_of(stage).GetExtentAttr().GetTimeSamples() == [-1, 0, 1]
    for number, low in LOWS.items():
        np.testing.assert_allclose(extent_at(stage, number), box(low), atol=1e-5)
    fields = fields_of(stage)
    described = {
        name: tuple(
            attribute.Get()
            for attribute in (
                field.GetFieldNameAttr(),
                field.GetFieldIndexAttr(),
                field.GetFieldDataTypeAttr(),
                field.GetFieldClassAttr(),
                field.GetVectorDataRoleHintAttr(),
            )
        )
        for name, field in fields.items()
    }
    assert described == {
        "density": ("density", None, "float", "fogVolume", "None"),
        "density_1": ("density", 1, "float", "fogVolume", "None"),
        "vel": ("vel", None, "float3", "unknown", "Vector"),
        "Cd": ("Cd", None, "float3", "unknown", "Color"),
        "force": ("force", None, "float3", "unknown", "None"),
        "flame": ("flame", None, "float", "fogVolume", "None"),
        "a_b": ("a.b", None, "float", "levelSet", "None"),
    }
    for number in LOWS:
        for name, field in fields.items():
            path = field.GetFilePathAttr().Get(number)
            if (name, number) == ("flame", 0):
                assert path is None
                continue
            assert path.path == f"./cache/smoke.{number:04d}.vdb"
            assert Path(path.resolvedPath) == elsewhere / path.path


@usd
def test_frames_of_other_formats_are_written_beside(run: Run, tmp_path: Path) -> None:
    frames = [Frame(np.ones((3, 4, 5)), None, None, f"f_{n}", n, grids={"flame": np.ones((3, 4, 5))}) for n in (1, 2)]
    save_frames(tmp_path / "in", frames)
    out = tmp_path / "new" / "out.usda"
    assert run("convert", tmp_path / "in", out, "--voxel-size", "0.5").code == 0
    assert sorted(path.name for path in out.parent.rglob("*")) == ["f_1.vdb", "f_2.vdb", "out.usda", "out_vdb"]
    stage = opened(out)
    require_valid(stage)
    assert importlib.import_module("pxr.UsdGeom").GetStageUpAxis(stage) == "Z"
    assert fields_of(stage)["flame"].GetFilePathAttr().Get(2).path == "./out_vdb/f_2.vdb"
    # Ours (z, y, x) = (3, 4, 5) is Blender's (X, Y, Z) = (5, 3, 4).
    np.testing.assert_allclose(extent_at(stage, 1), box((0, 0, 0), (5, 3, 4), 0.5, 0.0), atol=1e-6)
    refused(run, out.parent, ["convert", tmp_path / "in", out], "out_vdb: is not empty; remove it, or give the stage")


@usd
def test_flags_that_change_a_grid_make_files_anew(run: Run, tmp_path: Path) -> None:
    moving, out = tmp_path / "moving", tmp_path / "out.usda"
    for number, low in LOWS.items():
        write_vdb(moving / f"smoke.{number:04d}.vdb", [grid("density", low), grid("flame", low)], {})
    assert run("convert", moving, out, "--frames", "1:1", "--up", "z", "--origin", "1,0,0").code == 0
    stage = opened(out)
    assert fields_of(stage)["density"].GetFilePathAttr().Get(1).path == "./out_vdb/smoke.0001.vdb"
    np.testing.assert_allclose(extent_at(stage, 1), box(LOWS[1]) + np.array([1, 0, 0]), atol=1e-5)
    assert importlib.import_module("pxr.UsdGeom").GetStageUpAxis(stage) == "Z"
    assert run("convert", moving, tmp_path / "b.usda", "--frames", "0:1", "--up", "z").code == 0
    assert not (tmp_path / "b_vdb").exists()
    assert importlib.import_module("pxr.UsdGeom").GetStageUpAxis(opened(tmp_path / "b.usda")) == "Z"


@usd
def test_a_run_has_the_rate_of_its_recipe(run: Run, moving: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.move(moving, folder / "density")
    (folder / "run.json").write_text("{}", "utf-8")
    (folder / "recipe.toml").write_text(Recipe(style=("spirals",), fps=12).to_toml(), "utf-8")
    ran = run("convert", folder, folder / "out.usda")
    assert ran.code == 0 and not any("per second" in line for line in ran.errors)
    stage = opened(folder / "out.usda")
    assert stage.GetTimeCodesPerSecond() == 12
    assert fields_of(stage)["density"].GetFilePathAttr().Get(1).path == "./density/smoke.0001.vdb"
    (folder / "recipe.toml").write_text("nonsense", "utf-8")
    ran = run("convert", folder, folder / "out.usda")  # the stage before is replaced
    assert ran.code == 0 and "note: 24 frames per second are assumed (--fps)" in ran.errors
    assert opened(folder / "out.usda").GetTimeCodesPerSecond() == 24


@usd
def test_files_of_an_adaptive_domain_are_put_where_they_are(run: Run, tmp_path: Path) -> None:
    """Their transforms are untrue; our results say where they are."""
    true = {1: (0.2, (1.0, 0.0, 0.0)), 2: (0.5, (0.0, -2.0, 3.0))}
    for number, (edge, offset) in true.items():
        place = {"tnst_mi_voxel_size": ("double", edge), "tnst_mi_translation": ("vec3d", offset)}
        write_vdb(tmp_path / "run" / f"d_{number}.vdb", [grid("density", (3, 0, 0))], place)
    assert run("convert", tmp_path / "run", tmp_path / "out.usda").code == 0
    stage = opened(tmp_path / "out.usda")
    require_valid(stage)
    for number, (edge, offset) in true.items():
        np.testing.assert_allclose(extent_at(stage, number), box((3, 0, 0), EXTENTS, edge, offset), atol=1e-5)


@usd
def test_sub_frames_single_files_and_frames_without_smoke(run: Run, tmp_path: Path) -> None:
    for name in ("s.0001", "s.0001.50", "s.0002"):
        write_vdb(tmp_path / "sub" / f"{name}.vdb", [grid("density", (0, 0, 0))], {})
    assert run("convert", tmp_path / "sub", tmp_path / "sub.usda", "--frames", "1.0:2.0").code == 0
    stage = opened(tmp_path / "sub.usda")
    attribute = fields_of(stage)["density"].GetFilePathAttr()
    assert attribute.GetTimeSamples() == [1, 1.5, 2] and attribute.Get(1.5).path == "./sub/s.0001.50.vdb"

    write_vdb(tmp_path / "alone.vdb", [grid("density", (0, 0, 0))], {})
    ran = run("convert", tmp_path / "alone.vdb", tmp_path / "1 alone.usda")
    stage = opened(tmp_path / "1 alone.usda")
    assert ran.code == 0 and not stage.HasAuthoredTimeCodeRange()
    require_valid(stage)
    assert fields_of(stage)["density"].GetFilePathAttr().Get().path == "./alone.vdb"
    np.testing.assert_allclose(volume_of(stage).GetExtentAttr().Get(), box((0, 0, 0)), atol=1e-5)

    nothing = DenseGrid("density", np.zeros((2, 2, 2), np.float32), (0, 0, 0))
    write_vdb(tmp_path / "rising" / "r_1.vdb", [nothing], {})
    write_vdb(tmp_path / "rising" / "r_2.vdb", [grid("density", (0, 0, 0))], {})
    write_vdb(tmp_path / "rising" / "r_3.vdb", [], {})
    assert run("convert", tmp_path / "rising", tmp_path / "rising.usda").code == 0
    stage = opened(tmp_path / "rising.usda")
    assert volume_of(stage).GetExtentAttr().GetTimeSamples() == [2]
    paths = [fields_of(stage)["density"].GetFilePathAttr().Get(number) for number in (1, 2, 3)]
    assert [path and path.path for path in paths] == ["./rising/r_1.vdb", "./rising/r_2.vdb", None]


@usd
def test_what_cannot_be_shown_is_refused(
    run: Run, moving: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out.usda"
    refused(run, tmp_path, ["convert", moving, out, "--format", "uni"], "--format uni: a stage shows .vdb files")
    refused(run, tmp_path, ["convert", moving, tmp_path / "out.usdz"], r"expected one of .*\.vdb.*\.usda")
    (tmp_path / "file").touch()
    refused(run, tmp_path, ["convert", moving, tmp_path / "file" / "out.usda"], "file: is a file, expected a folder")
    write_vdb(tmp_path / "none" / "n_1.vdb", [DenseGrid("density", np.zeros((2, 2, 2), np.float32), (0, 0, 0))], {})
    refused(run, tmp_path, ["convert", tmp_path / "none", out], "n_1.vdb: .* no.* active voxel")
    metadata = {"up_axis": ("string", "z")}
    write_vdb(tmp_path / "two" / "t_1.vdb", [grid("density", (0, 0, 0))], metadata)
    write_vdb(tmp_path / "two" / "t_2.vdb", [grid("density", (0, 0, 0))], {})
    refused(
        run, tmp_path, ["convert", tmp_path / "two", out], "t_1.vdb has z up and t_2.vdb y, .*give --up y or --up z"
    )
    (moving / "smoke.0000.vdb").write_bytes((moving / "smoke.0000.vdb").read_bytes()[:300])
    refused(run, tmp_path, ["convert", moving, out], "smoke.0000.vdb: .*--skip-bad leaves it out")
    ran = run("convert", moving, out, "--skip-bad", "--fps", "24", "--up", "y")
    assert ran.code == 0 and len(ran.errors) == 1 and "smoke.0000.vdb" in ran.errors[0]
    stage = opened(out)
    assert fields_of(stage)["density"].GetFilePathAttr().GetTimeSamples() == [-1, 1]
    out.unlink()
    folder = tmp_path / "run"
    (folder / "density").mkdir(parents=True)
    for name in ("run.json", "recipe.toml"):
        (folder / name).touch()
    refused(run, tmp_path, ["convert", folder, out], "a run that has not finished a frame")
    write_vdb(folder / "velocity" / "v_1.vdb", [grid("velocity", (0, 0, 0), 3)], {})
    refused(run, tmp_path, ["convert", folder / "velocity", out], r"velocity v\* of a run, whose smoke is in .*density")

    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device", str(out))

    save_frames(tmp_path / "in", Frame(np.ones((2, 2, 2)), name="f_1"))
    monkeypatch.setattr(convert_stage, "write_stage", full)
    ran = run("convert", tmp_path / "in", out)
    assert ran.code != 0 and "No space left" in ran.errors[-1]
    assert not out.exists() and not (tmp_path / "out_vdb").exists()


@usd
@pytest.mark.parametrize("suffix", ["usda", "usdc", "usd"])
def test_only_stages_of_ours_are_replaced(run: Run, moving: Path, tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"shot.{suffix}"
    stage = importlib.import_module("pxr.Usd").Stage.CreateNew(str(out))
    importlib.import_module("pxr.UsdGeom").Xform.Define(stage, "/tnst_mi")
    stage.GetRootLayer().customLayerData = {"creator": "tnst_mi"}
    stage.Save()
    refused(run, tmp_path, ["convert", moving, out], f"shot.{suffix}: is there, and was not written by tnst-mi convert")
    stage.GetRootLayer().subLayerPaths.append(f"./ours.{suffix}")
    stage.Save()
    assert run("convert", moving, tmp_path / f"ours.{suffix}").code == 0
    kept = out.read_bytes()
    assert run("convert", moving, out).code == 2 and out.read_bytes() == kept
    assert run("convert", moving, tmp_path / f"ours.{suffix}", "--fps", "7").code == 0
    assert opened(tmp_path / f"ours.{suffix}").GetFramesPerSecond() == 7


@usd
@pytest.mark.skipif(os.name == "nt", reason="pipes of POSIX")
def test_what_cannot_be_looked_into_is_not_replaced(run: Run, moving: Path, tmp_path: Path) -> None:
    (tmp_path / "empty.usda").touch()
    os.mkfifo(tmp_path / "pipe.usda")  # nobody writes there: to read it would be to wait
    for name in ("empty.usda", "pipe.usda"):
        refused(run, tmp_path, ["convert", moving, tmp_path / name], f"{name}: is there, and was not written by")


@usd
def test_behind_links_files_are_found_whichever_way_the_stage_is_reached(
    run: Run, moving: Path, tmp_path: Path
) -> None:
    (tmp_path / "deep" / "a" / "b").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "deep" / "a" / "b", target_is_directory=True)
    ran = run("convert", moving, tmp_path / "link" / "out.usda", "--fps", "24", "--up", "y")
    assert (ran.code, len(ran.errors)) == (0, 1) and "out.usda names its files by absolute paths" in ran.errors[0]
    for way in ("link", "deep/a/b"):
        stage = opened(tmp_path / way / "out.usda")
        path = fields_of(stage)["density"].GetFilePathAttr().Get(1)
        assert Path(path.resolvedPath).samefile(moving / "smoke.0001.vdb")
    # A link above both, or to the files, leads nowhere else.
    (tmp_path / "all").symlink_to(tmp_path, target_is_directory=True)
    (tmp_path / "deep" / "smoke").symlink_to(moving, target_is_directory=True)
    for folder, out, told in (("all/cache", "all/deep/c.usda", "../cache"), ("deep/smoke", "deep/d.usda", "./smoke")):
        ran = run("convert", tmp_path / folder, tmp_path / out, "--fps", "24", "--up", "y")
        assert (ran.code, ran.errors) == (0, [])
        stage = opened(tmp_path / out)
        path = fields_of(stage)["density"].GetFilePathAttr().Get(1)
        assert path.path == f"{told}/smoke.0001.vdb"
        assert Path(path.resolvedPath).samefile(moving / "smoke.0001.vdb")


@usd
def test_between_drives_of_windows_paths_are_absolute(
    run: Run, moving: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def two_drives(path: object, start: object) -> str:
        raise ValueError("path is on mount 'D:', start on mount 'C:'")

    monkeypatch.setattr(asset_paths.os.path, "relpath", two_drives)
    ran = run("convert", moving, tmp_path / "out.usda")
    monkeypatch.undo()
    assert ran.code == 0 and any("names its files by absolute paths" in line for line in ran.errors)
    stage = opened(tmp_path / "out.usda")
    assert fields_of(stage)["density"].GetFilePathAttr().Get(1).path == (moving / "smoke.0001.vdb").as_posix()


@usd
def test_of_a_full_disk_the_cause_and_the_remedy_are_told(
    run: Run, moving: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pixar's library says only that it could not write."""
    tf = importlib.import_module("pxr.Tf")
    out = tmp_path / "out.usda"

    def fails(_layer: object, path: str) -> None:
        Path(path).touch()
        raise tf.ErrorException("Failed to write")

    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(importlib.import_module("pxr.Sdf").Layer, "Export", fails)
    monkeypatch.setattr(os, "fsync", full)
    ran = run("convert", moving, out)
    assert ran.code == 1
    assert ran.errors[-1] == (
        f"tnst-mi: {out}: cannot be written by Pixar's library (No space left on device); free some space on its disk, "
        "or give another place"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["cache"]


def test_the_help_tells_of_stages(capsys: pytest.CaptureFixture[str]) -> None:
    """In its first line, which the overview has too."""
    for arguments in (["--help"], ["convert", "--help"]):
        assert main(arguments) == 0
        said = " ".join(capsys.readouterr().out.split())
        assert "folder of numbered ones, to npz, .vol, .uni, .vdb, or a stage of USD. " in said


def test_without_the_library_the_remedy_is_said(
    run: Run, moving: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == "pxr" else found(name, *rest))
    message = r"out.usda: stages of USD need Pixar's library: pip install 'tnst_mi\[usd\]'"
    refused(run, tmp_path, ["convert", moving, tmp_path / "out.usda"], message)
