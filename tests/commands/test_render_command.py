"""`tnst-mi render` with looks, path tracers and turntables."""

from __future__ import annotations

from pathlib import Path

import imageio_ffmpeg
import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from command_line import Run, refused, run, smoke
from PIL import Image

import tnst_mi
from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.io.pictures import video
from tnst_mi.machine import optix
from tnst_mi.rendering.looks import gamma
from tnst_mi.rendering.pictures import shots_of_turn

__all__ = ["run", "smoke"]

STUDIO = ("--spp", 2, "--resolution", "24x32")


def exr(path: Path) -> tuple[dict[str, np.ndarray], dict[str, object]]:
    with OpenEXR.File(str(path)) as file:
        return {name: np.array(channel.pixels) for name, channel in file.channels().items()}, dict(file.header())


def test_a_look_gives_linear_exr_and_srgb_png(run: Run, smoke: Path, tmp_path: Path) -> None:
    file, out = smoke / "f_07.npz", tmp_path / "out"
    ran = run("render", file, "--out", out, "--look", "thick", "--views", "0,0", "40,10", "--seed", 3, *STUDIO)
    assert ran.code == 0, ran.errors
    names = {f"f_07_view_{view}.{ending}" for view in ("0_0", "40_10") for ending in ("png", "exr")}
    assert {path.name for path in out.iterdir()} == names
    channels, header = exr(out / "f_07_view_40_10.exr")
    linear = channels["RGB"]
    assert linear.shape == (32, 24, 3) and linear.dtype == np.float32 and np.isfinite(linear).all()
    assert (header["look"], header["integrator"], header["seed"]) == ("thick", "volpath", "3")
    assert tuple(header["view"]) == (40.0, 10.0) and header["samples_per_pixel"] == 2
    shown = np.asarray(Image.open(out / "f_07_view_40_10.png")) / 255
    # The inverse of the sRGB curve.
    undone = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(undone, np.clip(linear, 0, 1), atol=0.005)

    again = tmp_path / "again"
    run("render", file, "--out", again, "--look", "thick", "--views", "0,0", "40,10", "--seed", 3, *STUDIO)
    assert (again / "f_07_view_40_10.exr").read_bytes() == (out / "f_07_view_40_10.exr").read_bytes()


def test_the_integrated_transmittance_is_a_quadrature_of_the_flag(run: Run, smoke: Path, tmp_path: Path) -> None:
    file, out = smoke / "f_07.npz", tmp_path / "out"
    ran = run("render", file, "--out", out, "--views", "0,0", "--quadrature", "integrated_transmittance")
    assert ran.code == 0, ran.errors
    (picture,) = out.glob("*.exr")
    channels, header = exr(picture)
    density = tnst_mi.load_frames(file)[0].density
    image = tnst_mi.render(density, quadrature="integrated_transmittance", gamma=float(header["gamma"]))
    assert header["quadrature"] == "integrated_transmittance"
    np.testing.assert_allclose(channels["Y"], float(header["exposure"]) * image, rtol=1e-5)


def test_a_turntable_of_a_sequence_is_a_video(run: Run, smoke: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ("--integrator", "prbvolpath", "--turntable", 4, "--views", "10,5", "--fps", 12, "--denoise")
    ran = run("render", smoke, "--out", out, *arguments, *STUDIO)
    assert ran.code == 0, ran.errors
    # A computer without OptiX says so once, and goes on.
    assert sum("--denoise" in line for line in ran.errors) <= 1
    reader = imageio_ffmpeg.read_frames(str(out / "smoke_turntable.mp4"))
    about, pictures = next(reader), list(reader)
    assert about["size"] == (24, 32) and about["fps"] == 12.0 and len(pictures) == 4
    headers = {path.name: exr(path)[1] for path in sorted(out.glob("*.exr"))}
    assert [(name, *header["view"]) for name, header in headers.items()] == [
        ("f_07_turntable_0.exr", 10.0, 5.0),
        ("f_07_turntable_1.exr", 100.0, 5.0),
        ("f_08_turntable_2.exr", 190.0, 5.0),
        ("f_09_turntable_3.exr", 280.0, 5.0),
    ]
    assert {header["look"] for header in headers.values()} == {"medium"}


def test_emission_absorption_takes_gamma_from_the_look(run: Run, smoke: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ("--integrator", "emission_absorption", "--look", "thick", "--turntable", 3)
    ran = run("render", smoke / "f_08.npz", "--out", out, *arguments)
    assert ran.code == 0, ran.errors
    channels, header = exr(out / "f_08_turntable_1.exr")
    # By default, turntables of small grids are enlarged: f_08 is 6 cells high.
    assert channels["Y"].shape == (384, 320)
    about = next(imageio_ffmpeg.read_frames(str(out / "f_08_turntable.mp4")))
    assert about["size"] == (320, 384)
    # With three pixels a cell, the middle one of each cell is that of one pixel a cell.
    assert run("render", smoke / "f_08.npz", "--out", out, *arguments, "--resolution", "15x18", "--overwrite").code == 0
    channels, header = exr(out / "f_08_turntable_1.exr")
    density = tnst_mi.load_frames(smoke / "f_08.npz")[0].density
    assert header["gamma"] == pytest.approx(gamma("thick", density.shape))
    expected = tnst_mi.render(density, (120.0, 0.0), gamma("thick", density.shape)) * header["exposure"]
    np.testing.assert_allclose(channels["Y"][1::3, 1::3], expected, rtol=1e-5, atol=1e-6)


def test_a_sequence_plays_once_during_the_turn() -> None:
    for frames, count in ((1, 5), (3, 3), (3, 8), (9, 4)):
        shots = shots_of_turn(frames, (30.0, -2.0), count)
        played = [shot.frame for shot in shots]
        assert len(shots) == count and played == sorted(played) and played[0] == 0 and played[-1] < frames
        seen = np.bincount(played, minlength=frames)
        assert np.ptp(seen) <= 1
        np.testing.assert_allclose(np.diff([shot.viewpoint[0] for shot in shots]), 360 / count)
        assert {shot.viewpoint[1] for shot in shots} == {-2.0} and shots[0].viewpoint[0] == 30.0


@pytest.mark.parametrize(
    "arguments, message",
    [
        ("--look medium --gamma 0.5", "--gamma: is of emission_absorption; for a path tracer use --look"),
        ("--integrator volpath --quadrature exact", "--quadrature: is of emission_absorption"),
        ("--spp 4", "--spp: is of the path tracers.* add --look"),
        ("--resolution 4x18", "--resolution 4x18: expected at least 5x6, one pixel for each cell"),
        ("--fire none", "--fire: is of the path tracers.* add --look"),
        ("--look thin --fire smoke", "--fire smoke: no frame has such a grid; there is none beside the density"),
        ("--colour none", "--colour: is of the path tracers.* add --look"),
        ("--look thin --colour Cd", "--colour Cd: no frame has such a grid; expected the name of a grid of colours"),
        ("--denoise", "--denoise: is of the path tracers"),
        ("--integrator emission_absorption --look thin --gamma 1", "--look thin and --gamma 1: both say how dense"),
        ("--look thin --spp 0", "--spp 0: expected an integer from 1 to 1000000"),
        ("--look thin --seed -1", "--seed -1: expected an integer from 0"),
        ("--look thin --resolution 12", "--resolution 12: expected WIDTHxHEIGHT"),
        ("--look thin --resolution 12x99999", "--resolution 12x99999: expected WIDTHxHEIGHT"),
        ("--look sooty", "invalid choice|sooty"),
        ("--turntable 0", "--turntable 0: expected"),
        ("--gamma auto", "--gamma auto: is of stylize, where it follows from its look; give --look"),
        ("--turntable 4 --fps nan", "--fps nan: expected"),
        ("--turntable 4 --views 0,0 5,0", "--turntable: starts from one view"),
        ("--look thin --views 0,-60", "view 0,-60: the camera would be below the ground"),
    ],
)
def test_what_cannot_be_rendered(run: Run, smoke: Path, tmp_path: Path, arguments: str, message: str) -> None:
    refused(run, tmp_path, ["render", smoke, "--out", tmp_path / "out", *arguments.split()], message)


@pytest.mark.parametrize(
    "arguments", [("render", "--look", "thin"), ("render", "--integrator", "volpath"), ("compare",)]
)
def test_paths_are_not_traced_on_a_gpu_without_optix(
    run: Run, smoke: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    monkeypatch.setattr(mi, "variant", lambda: "cuda_ad_rgb")
    monkeypatch.setattr(optix, "LIBRARY", "libnowhere.so.1")
    command, *flags = arguments
    message = (
        rf"^tnst-mi: {command}.*: traces paths, which on a GPU needs OptiX, and libnowhere.* CUDA_VISIBLE_DEVICES=-1"
    )
    refused(run, tmp_path, [command, smoke, "--out", tmp_path / "out", *flags], message)


def test_videos_need_their_package(run: Run, smoke: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "_ffmpeg", None)
    arguments = ["render", smoke, "--out", tmp_path / "out", "--turntable", 4]
    refused(run, tmp_path, arguments, r"smoke_turntable\.mp4: videos need the package imageio-ffmpeg")


def test_the_unit_of_density_can_be_chosen(run: Run, tmp_path: Path) -> None:
    """Thin smoke, scaled, is rendered as if it had been stored so; left as it is, its unit is mentioned."""
    density = np.random.default_rng(0).random((6, 8, 7)).astype(np.float32)
    for name, factor in (("thick", 1.0), ("thin", 2.0**-7)):
        save_frames(tmp_path / f"{name}.npz", Frame(density * np.float32(factor), name=name))

    def rendered(name: str, *flags: str) -> tuple[np.ndarray, list[str]]:
        arguments = ("render", tmp_path / f"{name}.npz", "--gamma", "0.5", "--overwrite", "--out", tmp_path / "out")
        ran = run(*arguments, *flags)
        assert ran.code == 0, ran.errors
        image = exr(tmp_path / "out" / f"{name}_view_0_0.exr")[0]["Y"]
        return image, [line for line in ran.errors if line.startswith("note")]

    expected, notes = rendered("thick")
    assert notes == []
    as_it_is, notes = rendered("thin")
    assert len(notes) == 1 and "the density of thick smoke is 0.0077" in notes[0] and "--density-scale auto" in notes[0]
    assert np.abs(as_it_is - expected).max() > 0.05
    by_hand, notes = rendered("thin", "--density-scale", "128")
    np.testing.assert_array_equal(by_hand, expected)
    assert notes == ["note: densities are taken times 128 (--density-scale)"]
    units = [rendered(name, "--density-scale", "auto")[0] for name in ("thick", "thin")]
    np.testing.assert_array_equal(*units)
    ran = run("render", tmp_path / "thin.npz", "--density-scale", "0", "--out", tmp_path / "other")
    assert (ran.code, ran.errors) == (2, ["tnst-mi: --density-scale 0: expected a number above 0 or auto"])


def test_smoke_is_lit_in_its_colour_unless_that_is_put_off(run: Run, tmp_path: Path) -> None:
    density = np.full((5, 6, 7), 0.5, np.float32)
    colour = np.broadcast_to(np.float32([1, 0.2, 0]), (*density.shape, 3))
    save_frames(tmp_path / "f.npz", Frame(density, name="f", grids={"Cd": colour}))
    images = {}
    for choice in ((), ("--colour", "none")):
        out = tmp_path / f"out{len(choice)}"
        ran = run("render", tmp_path / "f.npz", "--out", out, "--look", "thick", *STUDIO, *choice)
        assert ran.code == 0, ran.errors
        channels, header = exr(out / "f_view_0_0.exr")
        images[header["colour"]] = channels["RGB"]
        said = [line for line in ran.errors if line.startswith("colour:")]
        assert said == ([] if choice else ["colour: grid Cd times the albedo of the smoke (--colour GRID|none)"])
    grey = run("render", tmp_path / "f.npz", "--out", tmp_path / "grey")
    assert "colour: grid 'Cd' is not seen in grey pictures; --look shows it" in grey.errors
    lost = images["none"] - images["Cd"]
    assert lost[..., 2].sum() > 2 * abs(lost[..., 0].sum()) and lost[..., 2].max() > 0.1


def test_fire_is_taken_from_the_grids_unless_it_is_put_out(run: Run, tmp_path: Path) -> None:
    """Which grid burns is said and in the header; the time that pictures will take is said before them."""
    density = np.full((5, 6, 7), 0.5, np.float32)
    flame = np.zeros_like(density)
    flame[2, 1, 3] = 1.0
    save_frames(tmp_path / "f.npz", Frame(density, name="f", grids={"flame": flame}))
    images = {}
    for choice in ((), ("--fire", "none")):
        out = tmp_path / f"out{len(choice)}"
        ran = run("render", tmp_path / "f.npz", "--out", out, "--look", "thin", *STUDIO, *choice)
        assert ran.code == 0, ran.errors
        channels, header = exr(out / "f_view_0_0.exr")
        images[header["fire"]] = channels["RGB"]
        said = [line for line in ran.errors if line.startswith("fire:")]
        assert said == ([] if choice else ["fire: grid flame as a flame, up to 1"])
        (time,) = (line for line in ran.errors if line.startswith("1 picture in about "))
        assert time.endswith(f" s, written to {out}")
    assert set(images) == {"flame", "none"}
    added = images["flame"] - images["none"]
    # The light of the fire is added to the same picture, and is red rather than blue.
    assert added.min() >= 0.0 and added[..., 0].sum() > 3 * added[..., 2].sum() > 0.0
