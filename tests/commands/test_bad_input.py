"""Bad input of every kind ends the command with code 2 and one line, and leaves nothing behind."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
from command_line import Run, refused, run, smoke, tiny_weights
from jobs import frames
from networks import random_googlenet
from PIL import Image

from tnst_mi.io import save_frames

__all__ = ["run", "smoke", "tiny_weights"]


def npz(**arrays: object) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


GRID = np.full((4, 6, 5), 0.5, np.float32)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"no zip", "frame.npz: not an npz file"),
        (npz(density=GRID)[:300], "frame.npz: not an npz file, truncated"),
        (npz(density=np.array([{}], object)), "array 'density' holds pickled objects"),
        (npz(heat=GRID), "no array 'density'.*: heat"),
        (npz(density=GRID[0, 0]), r"frame.npz: density has shape \(5,\), expected \(D, H, W\)"),
        (npz(density=np.stack([GRID, GRID])), r"frame.npz: density has shape \(2, 4, 6, 5\), expected \(D, H, W\)"),
        (npz(density=GRID[:0]), r"density has shape \(0, 6, 5\), expected at least one cell"),
        (npz(density=GRID * np.nan), "density has 120 NaN"),
        (npz(density=GRID + np.inf), "density has 120 NaN or infinite"),
        (npz(density=-GRID), "density has 120 negative values"),
        (npz(density=GRID, velocity=GRID), r"velocity has shape \(4, 6, 5\), expected \(4, 6, 5, 3\)"),
        (npz(x=np.zeros((4, 6, 5, 3))), "holds vectors, expected a density"),
    ],
)
def test_bad_frames(run: Run, tmp_path: Path, tiny_weights: Path, content: bytes, message: str) -> None:
    path = tmp_path / "frame.npz"
    path.write_bytes(content)
    goal = ["--style", "spirals", "--weights", tiny_weights]
    refused(run, tmp_path, ["stylize", path, "--out", tmp_path / "out", *goal], message)
    refused(run, tmp_path, ["render", path, "--out", tmp_path / "out"], message)
    if "heat" not in message and "vectors" not in message:  # info tells what else is there
        refused(run, tmp_path, ["info", path], message)


@pytest.mark.parametrize(
    ("recipe", "message"),
    [
        ("lamda = 1", "r.toml: unknown key 'lamda'; did you mean 'lam'"),
        ('octaves = "3"', "r.toml: octaves = '3': expected an integer"),
        ("eta = -1", "r.toml: eta = -1: expected a number above 0"),
        ('style = ["nowhere.png"]', "r.toml: style = 'nowhere.png': no such picture"),
        ("eta", "r.toml: not valid TOML"),
        ('weights = "nowhere"', "nowhere: no such file"),
    ],
)
def test_bad_recipes(run: Run, smoke: Path, tmp_path: Path, recipe: str, message: str) -> None:
    (tmp_path / "r.toml").write_text(recipe + "\n")
    arguments = [
        "stylize",
        smoke,
        "--recipe",
        tmp_path / "r.toml",
        "--out",
        tmp_path / "out",
        "--tag",
        "volcano",
    ]
    refused(run, tmp_path, arguments, message)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (
            ["--style", "spirals", "--style-layers", "conv2/3x4"],
            "layer 'conv2/3x4': unknown; the nearest are conv2/3x3",
        ),
        (["--semantic", "inception_4z/output:1"], "layer 'inception_4z/output': unknown"),
        (["--semantic", "conv2/3x3:9999"], "channel 9999 of layer 'conv2/3x3': expected 0 to"),
        (["--tag", "vulcano"], "vulcano.*(volcano.*,.*,)"),
        (["--style", "unreadable.png"], "unreadable.png"),
        (["--style", "pixel.png"], "pixel.png: the picture has 1 x 1 pixels"),
        (["--content", "pixel.png"], "pixel.png: the picture has 1 x 1 pixels"),
    ],
)
def test_bad_goals(
    run: Run,
    smoke: Path,
    tmp_path: Path,
    tiny_weights: Path,
    monkeypatch: pytest.MonkeyPatch,
    flags: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "unreadable.png").write_bytes(b"\x89PNG\r\n\x1a\n nothing more")
    Image.new("L", (1, 1)).save(tmp_path / "pixel.png")
    refused(run, tmp_path, ["stylize", smoke, "--out", "out", "--weights", tiny_weights, *flags], message)
    # Nor do empty frames, which need no goal, hide it.
    save_frames(tmp_path / "empty", frames(0.0, 0.3))
    refused(run, tmp_path, ["stylize", "empty", "--out", "out", "--weights", tiny_weights, *flags], message)


def other_network(path: Path) -> None:
    safetensors.numpy.save_file({"layer.weight": np.zeros((3, 3), np.float32)}, path)


@pytest.mark.parametrize(
    ("name", "make", "message"),
    [
        ("other.safetensors", other_network, "other.safetensors"),
        (
            "cut.safetensors",
            lambda path: path.write_bytes(random_googlenet(path, narrow=8).read_bytes()[:5000]),
            "cut",
        ),
        ("googlenet_bvlc.safetensors", lambda path: random_googlenet(path, narrow=8), "wrong hash"),
        ("no.pth", lambda path: path.write_bytes(b"nothing"), "no.pth"),
    ],
)
def test_bad_weights(
    run: Run, smoke: Path, tmp_path: Path, name: str, make: Callable[[Path], object], message: str
) -> None:
    make(tmp_path / name)
    arguments = [
        "stylize",
        smoke,
        "--out",
        tmp_path / "out",
        "--tag",
        "volcano",
        "--weights",
        tmp_path / name,
    ]
    refused(run, tmp_path, arguments, message)


@pytest.mark.parametrize("out", ["file", "file/below", "full", "/proc/nowhere"])
def test_bad_output_folders(run: Run, smoke: Path, tmp_path: Path, out: str) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes").touch()
    message = {"file": "is a file", "full": "is not empty"}.get(out, "cannot be written to")
    refused(run, tmp_path, ["stylize", smoke, "--out", tmp_path / out, "--style", "spirals"], message)
    refused(run, tmp_path, ["render", smoke, "--out", tmp_path / out], rf"{message}(?!.*--resume)")


def test_an_empty_frame_is_left_unchanged(run: Run, tmp_path: Path, tiny_weights: Path) -> None:
    save_frames(tmp_path / "empty.npz", frames(0.0))
    out = tmp_path / "out"
    ran = run("stylize", tmp_path / "empty.npz", "--out", out, "--style", "spirals", "--weights", tiny_weights)
    assert ran.code == 0, ran.errors
    assert "empty" in ran.out
    with np.load(out / "density" / "empty.npz") as file:
        assert not file["density"].any()
    assert "NaN" not in (out / "run.json").read_text()


@pytest.mark.parametrize("command", ["stylize", "render", "info", "convert"])
def test_the_folder_above_runs_names_them(run: Run, tmp_path: Path, command: str) -> None:
    """As the Blender add-on leaves them: one for each quality, and one for each marker's shot, with masks beside."""
    above = tmp_path / "Smoke_stylized"
    for name in ("draft", "markers_final/01_close/smoke"):
        save_frames(above / name / "density", frames(0.2))
        for file in ("run.json", "recipe.toml"):
            (above / name / file).write_text("")
    save_frames(above / "draft_inputs" / "recipe" / "region_1", frames(0.5))
    (above / "final" / "density").mkdir(parents=True)
    arguments = {"stylize": ["--style", "spirals", "--out", tmp_path / "out"], "render": ["--out", tmp_path / "out"]}
    arguments |= {"info": [], "convert": [tmp_path / "out.usda"]}
    expected = (
        "no frames in this folder, .*; those below it that have some are draft, markers_final/01_close/smoke: give"
    )
    refused(run, tmp_path, [command, above, *arguments[command]], expected)
