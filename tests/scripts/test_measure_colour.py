"""How near the colours of runs are to their pictures, by the script that tells it of runs of every kind."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
from moving_smoke import SHAPE, moving_smoke
from networks import random_googlenet
from PIL import Image

import tnst_mi
from tnst_mi.io import save_frames
from tnst_mi.recipe.recipe import Recipe

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "measure_colour.py"


def measure(*runs: Path) -> subprocess.CompletedProcess:
    command = [sys.executable, str(SCRIPT), *map(str, runs)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_every_picture_of_every_frame_with_smoke_is_judged_from_where_it_began(tmp_path: Path) -> None:
    random_googlenet(tmp_path / "random.safetensors", narrow=8)
    for name, colours in (("red.png", ((255, 0, 0), (80, 0, 0))), ("blue.png", ((0, 0, 255), (0, 60, 90)))):
        pixels = np.broadcast_to(np.array(colours, np.uint8).repeat(12, 0)[:, None], (24, 24, 3))
        Image.fromarray(np.ascontiguousarray(pixels)).save(tmp_path / name)
    first, second, third = moving_smoke(3)
    blue = np.broadcast_to(np.float32([0.0, 0.0, 1.0]), (*SHAPE, 3)).copy()
    frames = [
        dataclasses.replace(first, grids={"Cd": blue}),
        dataclasses.replace(second, density=np.zeros(SHAPE, np.float32)),
        third,
    ]
    save_frames(tmp_path / "in", frames, "npz")
    keys = {"octaves": 1, "iterations": 2, "views": 1, "weights": str(tmp_path / "random.safetensors")}
    goal = {"style_layers": {"conv2/3x3": 1.0}, "colour": "style", **keys}
    pictures = [str(tmp_path / name) for name in ("red.png", "blue.png")]
    tnst_mi.stylize(tmp_path / "in", Recipe.from_dict({"style": pictures, **goal}), tmp_path / "two", progress=False)
    ran = measure(tmp_path / "two")
    assert ran.returncode == 0 and "Warning" not in ran.stderr, ran.stderr
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in ran.stdout.splitlines()[2:] if "|" in line]
    assert [row[1:3] for row in rows] == [
        *([frames[0].name, name] for name in ("red.png", "blue.png")),
        [frames[1].name, "no smoke"],
        *([frames[2].name, name] for name in ("red.png", "blue.png")),
    ]
    numbers = {(row[1], row[2]): [float(cell) for cell in row[3:]] for row in rows if row[3]}
    assert all(np.isfinite(values).all() for values in numbers.values())
    # The first frame began in blue, the last one in the mean of both pictures.
    near, far = (numbers[frames[0].name, name][1] for name in ("blue.png", "red.png"))
    assert near < 0.6 * far
    between = [numbers[frames[2].name, name][1] for name in ("blue.png", "red.png")]
    assert abs(between[0] - between[1]) < 0.3 * max(between)

    of_targets = Recipe.from_dict({"target": [{"style": pictures[0]}], **goal})
    tnst_mi.stylize(tmp_path / "in", of_targets, tmp_path / "targets", progress=False)
    ran = measure(tmp_path / "targets")
    assert ran.returncode == 2 and len(ran.stderr.splitlines()) == 1
    assert "targets: its pictures are those of [[target]]" in ran.stderr
