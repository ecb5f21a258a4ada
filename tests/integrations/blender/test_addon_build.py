"""The zip of the Blender add-on, and its tables, which come from tnst_mi."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
import zipfile
from pathlib import Path

import blender_addon
import build_blender_addon
import pytest
from motifs import FAMILIES
from PIL import Image, ImageChops, ImageStat
from tnst_mi_blender.interface.motifs import SHEET, motifs
from tnst_mi_blender.recipes.parameters import parameters

from tnst_mi.network.class_names import class_names
from tnst_mi.network.readers import read_weights
from tnst_mi.network.shipped import FILE
from tnst_mi.recipe.parameters import parameters as of_recipe
from tnst_mi.resources import VERSION


def test_the_tables_are_those_of_tnst_mi() -> None:
    for name, content in build_blender_addon.generated().items():
        now = (blender_addon.ADDON / name).read_bytes()
        assert now == content, f"{name} has drifted: run python scripts/build_blender_addon.py --generate"


def test_versions_are_that_of_tnst_mi() -> None:
    """Also those of `bl_info`, which older versions of Blender read."""
    modules = "".join(file.read_text("utf-8") for file in blender_addon.ADDON.rglob("*.py"))
    assert VERSION in re.findall(r'VERSION = "(.*)"', modules)
    numbers = f"({', '.join(VERSION.split('.'))})"
    assert {numbers} | set(re.findall(r'"version": (\(.*?\))', modules)) == {numbers}


#: In the Python of Blender 3.4 to 4.0, and in all of them.
OLDEST, THERE = (
    (3, 10),
    {"bpy", "bpy_extras", "bmesh", "gpu", "mathutils", "numpy", *sys.stdlib_module_names} - {"tomllib"},
)


@pytest.mark.parametrize("module", sorted(blender_addon.ADDON.rglob("*.py")), ids=lambda file: file.name)
def test_modules_are_for_the_python_of_old_blenders_and_import_nothing_heavy(module: Path) -> None:
    tree = ast.parse(module.read_text("utf-8"), feature_version=OLDEST)
    imported = [name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names]
    imported += [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and not node.level]
    assert {name.split(".")[0] for name in imported} <= THERE


def test_the_panel_shows_all_keys_as_the_recipe_documents_them() -> None:
    shown = parameters()
    assert list(shown) == [row["key"] for row in of_recipe()]
    assert (shown["gamma"].kind, shown["gamma"].words, shown["gamma"].above) == ("number", ("auto",), 0.0)
    assert all(each.help and each.expected for each in shown.values())


def test_every_tag_of_the_network_that_ships_has_its_thumbnail() -> None:
    shown = motifs()
    assert [", ".join((motif.tag, *motif.synonyms)) for motif in shown] == list(class_names(read_weights(FILE)))
    with Image.open(SHEET) as sheet:
        assert sheet.mode == "L" and SHEET.stat().st_size < 1 << 20
        places = {(motif.left, motif.top, motif.left + motif.edge, motif.top + motif.edge) for motif in shown}
        assert len(places) == 64
        for place in places:
            assert 0 <= place[0] and place[2] <= sheet.width and 0 <= place[1] and place[3] <= sheet.height
            assert ImageStat.Stat(sheet.crop(place)).stddev[0] > 10  # something is drawn there


def test_thumbnails_are_of_their_motifs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Three of them, drawn again: another torch may round otherwise, and no more."""
    monkeypatch.setattr(build_blender_addon, "FAMILIES", FAMILIES[:3])
    (tmp_path / "again.png").write_bytes(build_blender_addon.sheet())
    with Image.open(SHEET) as sheet, Image.open(tmp_path / "again.png") as again:
        for motif in motifs()[:3]:
            place = (motif.left, motif.top, motif.left + motif.edge, motif.top + motif.edge)
            difference = ImageChops.difference(sheet.crop(place), again.crop(place))
            assert ImageStat.Stat(difference).mean[0] < 1


def test_the_zip_is_the_same_twice_and_as_blender_expects_it(tmp_path: Path) -> None:
    for name in ("one.zip", "two.zip"):
        assert build_blender_addon.main(["--without-wheel", "--out", str(tmp_path / "new" / name)]) == 0
    one, two = (tmp_path / "new" / name for name in ("one.zip", "two.zip"))
    assert one.read_bytes() == two.read_bytes()
    with zipfile.ZipFile(one) as archive:
        assert archive.testzip() is None
        names = archive.namelist()
        # One folder: older versions of Blender name the add-on by it, newer ones accept it.
        assert {name.split("/")[0] for name in names} == {"tnst_mi_blender"}
        assert {file.name for file in blender_addon.ADDON.rglob("*.py")} <= {Path(name).name for name in names}
        assert not any("__pycache__" in name or "carried" in name for name in names)
        assert (
            archive.read("tnst_mi_blender/export_camera.py")
            == (build_blender_addon.ROOT / "scripts" / "export_camera.py").read_bytes()
        )
        manifest = tomllib.loads(archive.read("tnst_mi_blender/blender_manifest.toml").decode())
    assert (manifest["version"], manifest["blender_version_min"]) == (VERSION, "4.2.0")
    # Blender's own limits: 64 characters, no period.
    for text in (manifest["tagline"], *manifest["permissions"].values()):
        assert len(text) <= 64 and text[-1].isalnum()
    assert set(manifest["permissions"]) == {"files", "network"}


def test_the_zip_carries_the_wheel_that_is_installed(tmp_path: Path) -> None:
    wheel = tmp_path / f"tnst_mi-{VERSION}-py3-none-any.whl"
    wheel.write_bytes(b"a wheel")
    files = build_blender_addon.contents(wheel)
    assert files[f"tnst_mi_blender/carried/{wheel.name}"] == b"a wheel"
    assert (
        files["tnst_mi_blender/carried/constraints.txt"] == (build_blender_addon.ROOT / "constraints.txt").read_bytes()
    )


@pytest.mark.parametrize("out", ["addon.tar", "."])
def test_what_is_no_zip_is_refused(out: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert build_blender_addon.main(["--without-wheel", "--out", str(tmp_path / out)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
