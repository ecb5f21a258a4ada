"""`tnst-mi info`: what it says of frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from command_line import Run, run, smoke

from tnst_mi.io.grids.vdb import DenseGrid, write_vdb

__all__ = ["run", "smoke"]


def test_info_takes_a_part_of_a_sequence(run: Run, smoke: Path) -> None:
    ran = run("info", smoke, "--frames", "8:9")
    assert ran.code == 0 and "f_08" in ran.out and "f_09" in ran.out and "f_07" not in ran.out


def test_info_describes_frames(run: Run, tmp_path: Path) -> None:
    density = np.zeros((2, 2, 2))
    density[0, 0] = 1.5, 0.5
    velocity = np.full((2, 2, 2, 3), [3.0, 4.0, 0.0])
    velocity[density == 0.0] *= 7.0  # what moves without smoke is not of it
    np.savez(tmp_path / "a.npz", density=density, velocity=velocity)
    ran = run("info", tmp_path / "a.npz")
    assert ran.code == 0 and ran.errors == []
    assert "array 'velocity': float64, shape (2, 2, 2, 3)" in ran.out
    lines = ran.out.splitlines()
    assert (lines[0], lines[1][:12], lines[2][:20]) == (str(tmp_path / "a.npz"), "  read as: y", "  reference density:")
    assert lines[3] == (
        "  a.npz: shape (z, y, x) (2, 2, 2), density 0 to 1.5, mass 2, 75.0% of cells empty, "
        "velocity at most 5 cells per frame"
    )
    np.savez(tmp_path / "v.npz", velocity=np.full((2, 2, 2, 3), [0.0, 3.0, 4.0], np.float32))
    ran = run("info", tmp_path / "v.npz")
    assert (ran.code, ran.errors) == (0, [])
    assert ran.out.splitlines()[1:] == [
        "  read as: y up, velocity at centres in cells-per-frame; no density, velocity from velocity, no obstacle",
        "  v.npz: no frame, no array 'density' (or 'x'), the arrays found are: velocity, "
        "velocity at most 5 cells per frame",
        "    array 'velocity': float32, shape (2, 2, 2, 3), 0 to 4",
    ]


def test_info_says_once_what_is_true_of_all_frames(run: Run, tmp_path: Path) -> None:
    folder = tmp_path / "smoke"
    folder.mkdir()
    for number in range(5):
        density = np.full((2, 3, 4), 0.1 * (number + 1), np.float32)
        density[0, 0, 0] = -1e-9
        other = {"heat": density} if number in (2, 3) else {}
        np.savez(folder / f"f_{number}.npz", density=density, **other)
    lines = run("info", folder).out.splitlines()
    assert lines[0] == f"{folder}: 5 frames, 0 to 4"
    assert [line.partition(":")[0] for line in lines[1:5]] == [
        "  read as",
        "  read as",
        "  note",
        "  reference density",
    ]
    assert lines[1].endswith(" (f_0, f_1, f_4)") and lines[2].endswith("; other grids: heat (f_2, f_3)")
    assert "f_0 (1 cell down to -1e-09), f_1 (1 cell" in lines[3] and lines[3].endswith("and 2 more")
    # A line for each frame, and the arrays only where they are others than before.
    assert [line.split(":")[0] for line in lines[5:]] == [
        *("  f_0.npz", "    array 'density'", "  f_1.npz"),
        *("  f_2.npz", "    array 'density'", "    array 'heat'", "  f_3.npz"),
        *("  f_4.npz", "    array 'density'"),
    ]


def test_info_keeps_the_box_of_every_frame(run: Run, tmp_path: Path) -> None:
    for number in (1, 2):
        grid = DenseGrid("density", np.ones((2, 3, 4), np.float32), (number, 0, 0), 0.5)
        write_vdb(tmp_path / f"s_{number}.vdb", [grid], {})
    lines = run("info", tmp_path).out.splitlines()
    assert [line.split(":")[0] for line in lines if "grid" in line] == ["    grid 'density'"]
    assert "s_1.vdb: shape (z, y, x) (2, 3, 5), active from (1, 0, 0) to (4, 2, 1)" in lines[3]
    assert "s_2.vdb: shape (z, y, x) (2, 3, 5), active from (2, 0, 0) to (5, 2, 1)" in lines[5]
