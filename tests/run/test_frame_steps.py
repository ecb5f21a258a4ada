"""Frames that are not one apart: every second one, and sub-frames."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, run
from jobs import SHAPE, FakeOptimiser, optimiser

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import load_frames, save_frames
from tnst_mi.io.files.frame_numbers import frame_step
from tnst_mi.optimisation.plan import plan_of
from tnst_mi.recipe.recipe import Recipe

__all__ = ["optimiser", "run"]

RECIPE = Recipe(style=("spirals",), octaves=1, iterations=1, window=3)


def moving(number: int | float, name: str = "") -> Frame:
    """A frame whose velocity is (1, 2, 3) cells per frame."""
    velocity = np.broadcast_to(np.float32([1, 2, 3]), (*SHAPE, 3))
    return Frame(np.full(SHAPE, 0.5), velocity, name=name or f"s_{number}", number=number)


@pytest.mark.parametrize(("numbers", "step"), [([10, 12, 14], 2), ([1, 1.5, 2], 0.5), ([-3, -2], 1), ([-6, -3, 0], 3)])
def test_velocities_lead_to_the_next_frame_that_is_there(
    optimiser: FakeOptimiser, capsys: pytest.CaptureFixture[str], numbers: list[int | float], step: int | float
) -> None:
    given = [moving(number) for number in numbers]
    result = tnst_mi.stylize(given, RECIPE)
    for frame, source in zip(optimiser.frames, given, strict=True):
        np.testing.assert_allclose(frame.velocity, step * source.velocity)
        np.testing.assert_array_equal(frame.density, source.density)
    assert list(result.frames) == given, "the input as it is"
    said = f"frames are {step} apart, so their velocities, in cells per frame, are taken times that"
    assert (said in capsys.readouterr().err) == (step != 1)


def test_every_second_file_of_a_folder(run: Run, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    save_frames(tmp_path / "smoke", [moving(number, f"s_{number:04d}") for number in (10, 12, 14, 16)])
    flags = ("--tag", "x", "--octaves", "1", "--iterations", "1")
    assert run("stylize", tmp_path / "smoke", "--out", tmp_path / "1", *flags).code == 0
    ran = run("stylize", tmp_path / "smoke", "--out", tmp_path / "3", *flags, "--window", "3", "--frames", "10:14")
    assert ran.code == 0, ran.errors
    assert optimiser.names[4:] == ["s_0010", "s_0012", "s_0014"]
    np.testing.assert_allclose(optimiser.frames[0].velocity[0, 0, 0], [2, 4, 6])


def test_the_step_of_numbers() -> None:
    assert frame_step([7]) == frame_step([]) == frame_step([None, None]) == frame_step([3, 1]) == 1
    assert frame_step([1, 3, 7]) == 2


def test_unequal_steps_are_refused_with_a_window(optimiser: FakeOptimiser) -> None:
    with pytest.raises(InputError, match="14 comes after 10, expected 12 there, which window = 3 needs"):
        tnst_mi.stylize([moving(number) for number in (10, 14, 16)], RECIPE, progress=False)
    assert tnst_mi.stylize([moving(n) for n in (10, 14, 16)], Recipe(style=("net",), octaves=1), progress=False)


def test_every_frame_has_views_of_its_own() -> None:
    numbers = [-2, -1.5, -1, 0, 0.5, 1, 2, 10**9 - 1, None]
    plan = plan_of(Recipe(tag=("a",)), [str(n) for n in numbers], numbers, [1.0] * 9, [1.0] * 9, (4, 4, 4))
    seeds = [frame.seed(0, 0) for frame in plan.frames]
    assert len({seed[1] for seed in seeds[:-1]}) == 8
    assert [seed[1] for seed in seeds[3::2][:3]] == [0, 1, 10**9 - 1], "whole frames seed by their numbers"
    assert all(np.random.default_rng(seed).random() < 1 for seed in seeds)


def test_names_that_are_not_utf_8(run: Run, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    """They are replaced in the names of results, and nothing else happens."""
    folder = tmp_path / os.fsdecode(b"gr\xf6\xdfe")
    folder.mkdir()
    for number in (1, 2):
        save_frames(tmp_path / "s.npz", moving(number))
        (tmp_path / "s.npz").rename(folder / os.fsdecode(b"r\xe9sum_%d.npz" % number))
    out = tmp_path / "out"
    ran = run("stylize", folder, "--out", out, "--tag", "x", "--octaves", "1", "--iterations", "1")
    assert ran.code == 0, ran.errors
    assert sorted(path.name for path in (out / "density").iterdir()) == ["r\ufffdsum_1.npz", "r\ufffdsum_2.npz"]
    assert run("stylize", "--out", out, "--resume").code == 0
    assert len(load_frames(out)) == 2
    ran = run("stylize", folder, "--out", folder / "out", "--tag", "x")
    assert ran.code == 2 and "the path is not UTF-8, expected one that is; give another folder" in ran.errors[-1]
