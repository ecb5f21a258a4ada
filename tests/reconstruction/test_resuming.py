"""What a reconstruction goes on from: the same files only, by what is in them."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from render_views import write_views

import tnst_mi
from tnst_mi.cli import main
from tnst_mi.io.pictures.exr import write_exr
from tnst_mi.io.pictures.png import write_png
from tnst_mi.machine.backend import activate
from tnst_mi.reconstruction.preparation import prepare
from tnst_mi.reconstruction.reconstruct import reconstruct

KEYS = {"iterations": 2, "levels": 1, "batch": 3, "gamma": 0.3}


@pytest.fixture
def masked(views, tmp_path) -> Path:
    """The views of the cloud with a mask each, and a background."""
    copy = tmp_path / "views"
    shutil.copytree(views.parent, copy)
    for file in copy.glob("*.exr"):
        write_png(file.with_suffix(".png"), np.ones((20, 20), np.float32))
    write_exr(copy / "empty.exr", np.zeros((20, 20), np.float32), {})
    told = re.sub(
        r'image = "(.*).exr"', r'image = "\1.exr"\nmask = "\1.png"\nbackground = "empty.exr"', views.read_text()
    )
    (copy / "cameras.toml").write_text(told)
    return copy / "cameras.toml"


def damaged(path: Path) -> None:
    """Change a byte of a file, and neither its size nor its times."""
    times, held = path.stat(), bytearray(path.read_bytes())
    held[-1] ^= 1
    path.write_bytes(held)
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


@pytest.mark.parametrize("name", ["view_03.exr", "held_out_01.exr", "view_05.png", "empty.exr"])
def test_other_contents_are_noticed(masked, tmp_path, name, capsys):
    out, file = tmp_path / "out", masked.with_name(name)
    reconstruct(masked, out, KEYS, progress=False)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    kept = file.read_bytes()
    if name == "empty.exr":
        file.unlink()
    elif name.endswith(".png"):
        write_png(file, np.zeros((20, 20), np.float32))
    else:
        damaged(file)
    flags = [f"--{key}={value}" for key, value in KEYS.items()]
    assert main(["reconstruct", str(masked), "--out", str(out), *flags, "--resume"]) == 2
    told = capsys.readouterr().err
    what = "is gone" if name == "empty.exr" else "was changed since"
    assert f"{file}: {what}" in told and "put the earlier file back" in told and told.count("\n") == 1
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    file.write_bytes(kept)
    assert main(["reconstruct", str(masked), "--out", str(out), *flags, "--resume"]) == 0


def test_it_goes_on_from_another_folder(masked, tmp_path, monkeypatch):
    """The same files by other names of their paths are the same."""
    monkeypatch.chdir(tmp_path)
    reconstruct("views/cameras.toml", "out", KEYS, progress=False)
    monkeypatch.chdir(masked.parent)
    assert not reconstruct("cameras.toml", "../out", KEYS, progress=False, resume=True).interrupted


def test_velocities_count_as_soon_as_they_were_used(cloud, renderer, tmp_path):
    velocity = np.zeros((*cloud.shape, 3), np.float32)
    frames = [tnst_mi.Frame(cloud, velocity, name=f"f_{n:04d}", number=n) for n in (7, 8)]
    views = write_views(tmp_path / "views", frames, renderer, (4, 0), 0.0, 0.3)
    tnst_mi.save_frames(tmp_path / "simulation", frames)
    given = {"frames": "7:8", "velocities": tmp_path / "simulation", "progress": False}
    reconstruct(views, tmp_path / "out", KEYS, **given)
    used, unused = (next((tmp_path / "simulation").glob(f"*{number}.npz")) for number in (7, 8))
    unused.unlink()  # the velocity of the last frame moves nothing
    used.write_bytes(used.read_bytes() + b"\0")
    with pytest.raises(tnst_mi.InputError, match="was changed since"):
        reconstruct(views, tmp_path / "out", KEYS, **given, resume=True)


@pytest.fixture(scope="module")
def two_frames(cloud, renderer, tmp_path_factory) -> Path:
    """A folder with the pictures of two frames from four views, and two simulations of the same smoke."""
    folder = tmp_path_factory.mktemp("two")
    for name, speed in (("slow", 0), ("fast", 3)):
        velocity = np.full((*cloud.shape, 3), speed, np.float32)
        frames = [tnst_mi.Frame(cloud, velocity, name=f"f_{n:04d}", number=n) for n in (7, 8)]
        tnst_mi.save_frames(folder / name, frames)
    return write_views(folder / "views", frames, renderer, (4, 0), 0.0, 0.3).parent.parent


def test_other_velocities_and_formats_are_of_another_reconstruction(two_frames, tmp_path, monkeypatch):
    monkeypatch.chdir(two_frames)
    given = {"frames": "7:8", "velocities": "slow", "progress": False}
    reconstruct("views/cameras.toml", tmp_path / "out", KEYS, **given)
    for other in ({"velocities": "fast"}, {"format": "vol"}):
        with pytest.raises(tnst_mi.InputError, match="other velocities or another format"):
            reconstruct("views/cameras.toml", tmp_path / "out", KEYS, **given | other, resume=True)
    assert not list(tmp_path.rglob("*.vol"))


def test_overwriting_leaves_nothing_of_the_earlier_reconstruction(two_frames, tmp_path):
    """Whoever reads density/ as a sequence gets the frames of the last one alone, and their own files stay."""
    given = {"velocities": "none", "progress": False, "overwrite": True}
    cameras = two_frames / "views" / "cameras.toml"
    reconstruct(cameras, tmp_path, KEYS, frames="7:7", format="vol", **given)
    (tmp_path / "density" / "notes.txt").write_text("mine")
    reconstruct(cameras, tmp_path, KEYS, frames="8:8", **given)
    assert sorted(file.name for file in (tmp_path / "density").iterdir()) == ["notes.txt", "smoke_0008.npz"]
    assert [file.name for file in (tmp_path / "images").iterdir()] == ["smoke_0008_sides.png"]


def test_nothing_is_removed_where_there_was_no_reconstruction(two_frames, tmp_path):
    (tmp_path / "density").mkdir()
    (tmp_path / "density" / "smoke_0001.npz").write_bytes(b"of a simulation")
    cameras = two_frames / "views" / "cameras.toml"
    given = {"frames": "8:8", "velocities": "none", "progress": False, "overwrite": True}
    reconstruct(cameras, tmp_path, KEYS, **given)
    assert (tmp_path / "density" / "smoke_0001.npz").read_bytes() == b"of a simulation"


@pytest.mark.parametrize("name", ["view_02_0008.exr", "mask_0008.png"])
def test_files_of_later_frames_are_missed_before_the_first(two_frames, tmp_path, name, capsys):
    copy = tmp_path / "views"
    shutil.copytree(two_frames / "views", copy)
    for number in (7, 8):
        write_png(copy / f"mask_{number:04d}.png", np.ones((20, 20), np.float32))
    cameras = copy / "cameras.toml"
    cameras.write_text(re.sub(r"(image = .*view_03.*)", r'\1\nmask = "mask_####.png"', cameras.read_text()))
    (copy / name).unlink()
    assert main(["reconstruct", str(cameras), "--out", str(tmp_path / "out"), "--frames", "7:8"]) == 2
    told = capsys.readouterr().err
    assert f"{copy / name}: no such file, expected for view view_0" in told and "in frame 8; put it there" in told
    assert told.count("\n") == 1 and not (tmp_path / "out").exists()


def test_a_light_is_beside_the_file_that_names_it(views, tmp_path, monkeypatch):
    """So it is the same from wherever it is resumed; one that a flag names is where the flag is given."""
    scattering = 'gamma = 0.3\nintegrator = "prbvolpath"\nspp = 1\nlight = "lamp.xml"'
    lit = tmp_path / "lit" / "cameras.toml"
    shutil.copytree(views.parent, lit.parent)
    lit.write_text(re.sub("gamma = .*", scattering, views.read_text()))
    lamp = lit.with_name("lamp.xml")
    write_exr(lit.with_name("sky.exr"), np.ones((4, 8, 3), np.float32), {})
    sky = '<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>'
    lit.with_name("sky.xml").write_text(f'<scene version="3.0.0">{sky}</scene>')
    lamp.write_text('<scene version="3.0.0"><include filename="sky.xml"/></scene>')
    monkeypatch.chdir(tmp_path)
    activate()
    read = {file.name for file in prepare(lit, {}, None, None).sources(0)}
    assert {"lamp.xml", "sky.xml", "sky.exr"} <= read  # other contents of any of them are another light
    assert prepare(Path("lit/cameras.toml"), {}, None, None).settings.light == str(lamp)
    identity = prepare(lit, {}, None, None).identity
    monkeypatch.chdir(lit.parent)
    assert prepare(Path("cameras.toml"), {"light": "lamp.xml"}, None, None).identity == identity
    monkeypatch.setenv("HOME", str(lit.parent))
    lit.write_text(lit.read_text().replace("lamp.xml", "~/lamp.xml"))
    assert prepare(lit, {}, None, None).identity == identity
    with pytest.raises(tnst_mi.InputError, match=r"light = 'gone\.xml': no such file"):
        prepare(lit, {"light": "gone.xml"}, None, None)
