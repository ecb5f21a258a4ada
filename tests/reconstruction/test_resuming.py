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
