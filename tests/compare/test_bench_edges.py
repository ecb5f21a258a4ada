"""What comparisons of any two renderers must not take for agreement, and what they must say."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from command_line import Run, refused, run

from tnst_mi.compare.bench.renderers.pictures import pictures
from tnst_mi.compare.bench.renderers.scene_file import scene_renderer
from tnst_mi.compare.bench.renderers.sides import side_of
from tnst_mi.compare.bench.renderers.smoke_scene import SmokeScene, smoke_renderer
from tnst_mi.compare.bench.renderers.variants import LUMINANCE
from tnst_mi.compare.bench.statistics.batches import Batches, certain_beside, comparable
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.machine.backend import activate
from tnst_mi.resources import scene_file

__all__ = ["run"]

#: Two that are quick, since no kernel is compiled for them.
SCALAR = ("--left", "volpath@scalar_rgb", "--right", "volpathmis@scalar_rgb", "--spp", 32)

SCENE = """<scene version="3.0.0">{before}
    <sensor type="orthographic">
        <film type="{film}"><integer name="width" value="{width}"/><integer name="height" value="3"/>{bands}</film>
    </sensor>{content}
</scene>"""


@pytest.fixture(autouse=True)
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few batches, and no figures."""
    monkeypatch.setattr("tnst_mi.compare.bench.renderers.prepared_side.BATCHES", 8)

    def empty(path: Path, figure: object) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")

    monkeypatch.setattr("tnst_mi.compare.bench.bench_report.write_figure", empty)


def scene(file: Path, content: str, before: str = "", film: str = "hdrfilm", width: int = 2, bands: str = "") -> Path:
    file.write_text(SCENE.format(content=content, before=before, film=film, width=width, bands=bands))
    return file


def test_pixels_that_are_not_finite_are_not_agreed_on(run: Run, tmp_path: Path) -> None:
    """NaN is neither above nor below any bound."""
    path = scene(tmp_path / "nan.xml", '<emitter type="constant"><spectrum name="radiance" value="nan"/></emitter>', "")
    arguments = ["compare", path, *SCALAR, "--out", tmp_path / "out"]
    ran = run(*arguments)
    assert ran.code == 2 and not list((tmp_path / "out").glob("*"))
    message = "volpath@scalar_rgb: 6 pixels are not finite, the first in row 0, column 0 of view 0"
    assert ran.errors[-1].startswith(f"tnst-mi: {message}"), ran.errors


def test_two_that_are_black_do_not_agree_since_nothing_is_seen(run: Run, tmp_path: Path) -> None:
    path = scene(tmp_path / "black.xml", '<shape type="sphere"/>')
    out = tmp_path / "out"
    ran = run("compare", path, *SCALAR, "--out", out)
    assert ran.code == 1 and "untested  anything: both sides are black" in ran.out
    assert "verdict   INCONCLUSIVE: volpath@scalar_rgb and volpathmis@scalar_rgb: nothing could be tested" in ran.out


def test_scenes_and_films_that_a_side_cannot_show_are_named(run: Run, tmp_path: Path) -> None:
    def refuse(path: Path, side: str, message: str) -> None:
        arguments = ["compare", path, "--left", side, "--right", "volpath", "--out", tmp_path / "out"]
        refused(run, tmp_path, arguments, message)

    light = '<emitter type="constant"/>'
    bare = scene(tmp_path / "bare.xml", light)
    refuse(bare, "emission_absorption", r"emission_absorption: cannot render it in \w+ \(.*the scene has no medium")
    large = scene(tmp_path / "large.xml", light, width=1 << 17)
    refuse(large, "volpathmis", "large.xml: the image has 131072×3 pixels, expected at most 262144; make its film")
    bands = scene(tmp_path / "bands.xml", light, film="specfilm", bands='<spectrum name="band" value="400:0, 500:1"/>')
    refuse(bands, "volpath@spectral", "bands.xml: the film of its sensor has bands of wavelengths, expected an hdrfilm")


def test_integrators_keep_the_depth_of_the_one_that_they_replace(tmp_path: Path) -> None:
    """Whether it is a $name, or of an integrator inside another."""
    activate()
    path = scene(
        tmp_path / "deep.xml",
        '<emitter type="constant"/><integrator type="moment"><integrator type="volpath">'
        '<integer name="max_depth" value="$depth"/><boolean name="hide_emitters" value="true"/>'
        "</integrator></integrator>",
        '<default name="depth" value="3"/>',
    )
    assert "max_depth = 3" in str(scene_renderer(path, side_of("left", "prbvolpath")).integrator)
    assert "max_depth = 4294967295" in str(
        scene_renderer(scene_file("known/furnace.xml"), side_of("left", "volpath")).integrator
    )


def write_channels(path: Path, channels: dict[str, np.ndarray]) -> None:
    with OpenEXR.File({"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}, channels) as file:
        file.write(str(path))


def test_pictures_count_as_they_are_stored(tmp_path: Path) -> None:
    """A film with alpha holds what reaches the camera: divided by alpha, thin smoke would be as bright as thick."""
    rng = np.random.default_rng(1)
    colours = {name: rng.random((4, 5)).astype(np.float32) for name in "RGB"}
    alpha = np.full((4, 5), 0.25, np.float32)
    alpha[0] = 0
    write_channels(tmp_path / "a.exr", colours | {"A": alpha})
    layers = {f"Smoke.{name}": value for name, value in colours.items()}
    write_channels(tmp_path / "b.exr", layers | {"Depth.Z": alpha})
    stored = np.stack(list(colours.values()), -1)
    with pytest.raises(InputError, match=r"b\.exr: is the same picture as a\.exr, expected independent renders"):
        pictures(tmp_path, (1, 4, 5, 3))
    (other := tmp_path / "other").mkdir()
    (tmp_path / "a.exr").rename(other / "a.exr")
    for folder in (tmp_path, other):
        np.testing.assert_array_equal(pictures(folder, (1, 4, 5, 3))[0].values, stored[None, None])
    found, remarks = pictures(other, (1, 4, 5, 1))
    np.testing.assert_allclose(found.mean[0, ..., 0], (stored * LUMINANCE).sum(-1), rtol=1e-6)
    assert f"colours of {other}: luminance alone is compared" in remarks
    write_channels(tmp_path / "c.exr", {"Z": alpha})
    with pytest.raises(InputError, match=r"c\.exr: has the channels Z, expected R, G and B, or Y"):
        pictures(tmp_path, (1, 4, 5, 3))


def test_a_single_picture_is_said_to_be_taken_as_exact(run: Run, tmp_path: Path) -> None:
    folder = tmp_path / "renders"
    folder.mkdir()

    def write(name: str, value: float) -> None:
        write_channels(folder / name, {channel: np.full((1, 1), value, np.float32) for channel in "RGB"})

    write("a.exr", 0.36787944)
    slab = scene_file("known/slab.xml")
    sides = ("--left", "emission_absorption", "--right", folder, "--spp", 32)
    ran = run("compare", slab, *sides, "--out", tmp_path / "out")
    assert ran.code == 0 and f"untested  noise of {folder}: it has one picture of each view, taken as exact" in ran.out
    write("b.exr", 0.367880)
    ran = run("compare", slab, *sides, "--out", tmp_path / "two")
    assert "taken as exact" not in ran.out and "2 renders tell little of their noise; 8 or more do" in ran.out


def test_folders_of_which_it_is_not_clear_what_they_show_are_refused(run: Run, tmp_path: Path) -> None:
    def folder(*names: str) -> Path:
        made = tmp_path / "_".join(names)
        made.mkdir()
        for number, name in enumerate(names):
            write_channels(made / name, {"Y": np.full((1, 1), number, np.float32)})
        return made

    views = (2, 1, 1, 1)
    for names, message in (
        (("0_a.exr", "1_a.exr", "2_a.exr"), r"2_a\.exr: is of none of the 2 views, expected 0_….exr to 1_….exr"),
        (("0_a.exr", "1_a.exr", "b.exr"), r"b\.exr: is of none of the 2 views"),
        (("0_left.exr", "1_right.exr"), "has pictures of a left and a right side, expected those of one renderer"),
    ):
        with pytest.raises(InputError, match=message):
            pictures(folder(*names), views)
    found, _ = pictures(folder("0.exr", "._0.exr"), (1, 1, 1, 1))
    assert found.exact, "what a file system keeps beside a picture is none"
    save_frames(tmp_path / "smoke.npz", Frame(np.ones((1, 1, 1), np.float32), name="smoke"))
    sides = ["--left", "emission_absorption", "--right", tmp_path / "0.exr_._0.exr", "--views", "0,0"]
    arguments = ["compare", tmp_path / "smoke.npz", *sides, "--out", tmp_path / "out"]
    refused(run, tmp_path, arguments, r"its pictures are of one γ, expected one --gamma and not 0\.05, 0\.5, 2")


def test_a_baseline_of_another_scene_is_refused_before_anything_is_rendered(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sides = ("--left", "emission_absorption", "--right", "answer", "--spp", 32)
    assert run("compare", scene_file("known/slab.xml"), *sides, "--out", tmp_path / "a").code == 0
    assert json.loads((tmp_path / "a" / "report.json").read_text("utf-8"))["agree"]
    monkeypatch.setattr("tnst_mi.commands.compare_sides.prepare", lambda *arguments: pytest.fail("was prepared"))
    arguments = ["compare", scene_file("known/gaussian.xml"), *sides, "--out", tmp_path / "b"]
    refused(
        run,
        tmp_path,
        [*arguments, "--baseline", tmp_path / "a" / "report.json"],
        r"its subject's input is \"slab\.xml\", here it is \"gaussian",
    )


def test_smoke_that_is_cut_at_a_wall_is_said_to_be_less_precise() -> None:
    """Half a step at the wall counts wholly or not at all, so that the error is of the first order of the step."""
    activate()
    side = side_of("left", "emission_absorption")
    cut = smoke_renderer(SmokeScene(np.ones((4, 5, 3), np.float32), ((30.0, 10.0),)), 0.4, side, 1e-3)
    assert cut.remark.startswith("emission_absorption at γ 0.4 more precisely than 0.0")
    inside = np.pad(np.ones((4, 5, 3), np.float32), 2)
    assert smoke_renderer(SmokeScene(inside, ((30.0, 10.0),)), 0.4, side, 1e-3).remark == ""


def test_a_derivative_that_no_path_carries_is_certain_only_where_paths_are_found() -> None:
    """With a tight majorant it is 0 whatever the paths; in thin haze 8 batches may well have missed all that count."""
    zero, answer = Batches(np.zeros(8)), Batches(np.array([-1e-6]))
    varying, missed = Batches(np.random.default_rng(1).normal(-0.2, 0.05, 8)), Batches(np.eye(8)[0])
    assert comparable(certain_beside(zero, varying), answer)
    assert not comparable(certain_beside(zero, missed), answer)
    assert not comparable(certain_beside(missed, varying), answer), "a few batches have found some"
