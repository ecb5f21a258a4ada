"""Views that tell nothing of the smoke are refused where none tells anything, and named where others do."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tnst_mi
from tnst_mi.io.pictures.exr import read_exr, write_exr
from tnst_mi.reconstruction.checks.usable_views import require_box_in_sight, require_contrast, without_contrast
from tnst_mi.reconstruction.photographs import Photograph
from tnst_mi.reconstruction.preparation import prepare
from tnst_mi.reconstruction.reconstruct import reconstruct
from tnst_mi.reconstruction.settings import ReconstructionSettings

QUICK = {"iterations": 12, "levels": 1, "batch": 3}


@pytest.fixture
def copied(views, tmp_path) -> Path:
    shutil.copytree(views.parent, tmp_path / "views")
    return tmp_path / "views" / "cameras.toml"


def at(
    z: float, perspective: bool = True, field: float = 40.0, shift: tuple[float, float] = (0.0, 0.0)
) -> tnst_mi.Camera:
    """The camera that looks towards −z from a place on that axis."""
    to_world = np.eye(4)
    to_world[2, 3] = z
    return tnst_mi.Camera(to_world, perspective, field, 1.0, shift)


def changed(cameras: Path, picture) -> Path:
    """Other pictures in place of those of cameras: `picture(image, name)`."""
    for file in cameras.parent.glob("*.exr"):
        write_exr(file, picture(read_exr(file), file.stem), {})
    return cameras


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"integrator": "prbvolpath"}, "prbvolpath renders smoke before black"),
        ({"quadrature": "paper"}, "quadrature = paper has no transmittance"),
    ],
)
def test_pictures_of_backgrounds_are_refused_where_a_number_is(copied, keys, message):
    copied.write_text(copied.read_text().replace("[views.view_03]", '[views.view_03]\nbackground = "empty.exr"'))
    with pytest.raises(tnst_mi.InputError, match=rf"view view_03: background = .*empty\.exr: .*{message}"):
        prepare(copied, keys, None, None)
    prepare(copied, {}, None, None)


@pytest.mark.parametrize(
    ("camera", "seen"),
    [
        (at(40), True),
        (at(40, field=0.1), True),  # a part of the box that is between any points
        (at(4e4), True),  # a box that is between any rays
        (at(-40), False),
        (at(40, shift=(0.0, 2.0)), False),
        (at(0, perspective=False, field=5), True),
        (at(0, perspective=False, field=5, shift=(4.0, 0.0)), False),
    ],
)
def test_whether_a_camera_sees_the_box(camera, seen, cloud):
    blank = np.zeros((4, 4), np.float32)
    photograph = Photograph("", camera, blank, blank + 1, None, False)
    if seen:
        require_box_in_sight([photograph], cloud.shape)
    else:
        with pytest.raises(tnst_mi.InputError, match="no view that is used sees any of the box; check --box"):
            require_box_in_sight([photograph], cloud.shape)
    with pytest.raises(tnst_mi.InputError):
        require_box_in_sight([replace(photograph, held_out=True)], cloud.shape)


def test_a_box_elsewhere_is_refused_and_cameras_inside_are_named(copied):
    with pytest.raises(tnst_mi.InputError, match=r"cameras\.toml: no view that is used sees any of the box"):
        prepare(copied, {"box": (900, 900, 900, 910, 910, 910)}, None, None).photographs(None)
    remarks = prepare(copied, {"box": (-500, -500, -500, 500, 500, 500)}, None, None).remarks
    assert any(re.search("view_00, .*view_11: the camera stands inside of the box", remark) for remark in remarks)
    assert not any("inside" in remark for remark in prepare(copied, {}, None, None).remarks)


def test_a_single_view_is_said(copied):
    copied.write_text(copied.read_text().split("[views.view_01]")[0])
    assert any("view_00 alone is used" in remark for remark in prepare(copied, {}, None, None).remarks)


def test_pictures_of_one_value_are_refused(copied, tmp_path):
    white = changed(copied, lambda image, name: image * 0 + 1)
    with pytest.raises(tnst_mi.InputError, match="every pixel of every picture is as bright as all others of it, 1 in"):
        reconstruct(white, tmp_path / "out", {"levels": 1}, progress=False)
    require_contrast(prepare(white, {}, None, None).photographs(None), ReconstructionSettings(background=0.5))


def test_views_that_show_nothing_are_told_from_others(copied, tmp_path):
    pictures = prepare(changed(copied, lambda i, name: i * (name != "view_03")), {}, None, None).photographs(None)
    assert without_contrast(pictures) == ["view_03"]
    found = reconstruct(copied, tmp_path / "out", QUICK, progress=False)
    assert [remark for remark in found.remarks if "all pixels are alike" in remark] == found.records[0]["remarks"]
    assert "views: view_03: all pixels are alike" in (tmp_path / "out" / "report.json").read_text()
    assert without_contrast([replace(one, values=0 * one.values) for one in pictures]) == []


def test_smoke_that_explains_nothing_is_said(copied, tmp_path):
    """The box is beside the smoke, and views still see it."""
    beside = {**QUICK, "box": (12, -8, -6, 16, 8, 6)}
    found = reconstruct(copied, tmp_path / "a", beside, progress=False)
    assert any("explains the pictures hardly better than none; check --box" in remark for remark in found.remarks)
    found = reconstruct(copied, tmp_path / "b", QUICK, progress=False)
    assert found.records[0]["remarks"] == []
