"""Files as Houdini writes them: what is read of them, and what comes back from a whole run on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from houdini_files import METADATA, houdini_grid, velocity_in_parts, write_houdini
from moving_smoke import moving_smoke
from networks import random_googlenet

import tnst_mi
from tnst_mi import cli
from tnst_mi.io import open_frames
from tnst_mi.io.grids.vdb import DenseGrid, read_vdb
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.inputs import conventions_of

EDGE, FPS = 0.05, 25.0

#: In metres per second, that of one cell a frame.
SPEED = EDGE * FPS


def velocity_grids(kind: str, velocity: np.ndarray, half: bool) -> list[DenseGrid]:
    """A velocity (D, H, W, 3) in metres per second, as simulations have it, or as SOPs make of it."""
    if kind == "parts":
        return velocity_in_parts(velocity, EDGE, half)
    return [
        houdini_grid("vel", velocity, EDGE, half=half, grid_class="staggered" if kind == "staggered" else "unknown")
    ]


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("weights") / "random.safetensors"
    random_googlenet(path, narrow=8)
    return str(path)


@pytest.mark.parametrize(
    ("kind", "compression", "half"),
    [("parts", "blosc", True), ("staggered", "zip", False), ("centres", "blosc", False)],
)
def test_a_run_gives_back_what_houdini_wrote_moved(
    kind: str, compression: str, half: bool, weights: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same grids by the same names and types, at the same place; a copy of the density moves as it does."""
    (tmp_path / "in").mkdir()
    for number, frame in enumerate(moving_smoke(2), start=1001):
        density = frame.density
        smoky = (density > 0)[..., None]
        velocity = np.where(smoky, np.array([0.5, 1.0, -0.25]) * SPEED, 0.0).astype(np.float32)
        colour = np.stack([density, 1 - density, 0.5 * density], axis=-1).astype(np.float32) * smoky
        grids = [
            houdini_grid("density", density, EDGE, half=half),
            houdini_grid("burn", density, EDGE, half=half),
            houdini_grid("temperature", 300 + 20 * density, EDGE, background=300.0),
            *velocity_grids(kind, velocity, half),
            houdini_grid("Cd", colour, EDGE),
        ]
        write_houdini(tmp_path / "in" / f"smoke.{number}.vdb", grids, compression)

    pattern = str(tmp_path / "in" / "smoke.$F4.vdb")
    assert cli.main(["info", pattern, "--fps", "25"]) == 0
    shown = capsys.readouterr().out
    assert "y up (as Houdini's metadata say" in shown and "length-per-time, 0.04 time units per frame" in shown
    assert f"velocity {'at centres' if kind == 'centres' else 'on faces'}" in shown and "voxel size 0.05" in shown

    recipe = Recipe(
        semantic=("inception_3a/3x3:2",), octaves=1, iterations=1, views=1, eta=0.05, weights=weights, fps=FPS, window=3
    )
    tnst_mi.stylize(pattern, recipe, tmp_path / "out", progress=False)
    read = open_frames(pattern, given=conventions_of(recipe))[0]
    assert read.velocity is not None
    inside = tuple(np.argwhere(read.density == read.density.max())[0])
    np.testing.assert_allclose(read.velocity[inside], [0.5, 1.0, -0.25], rtol=2e-3)

    for number in (1001, 1002):
        before, after = (read_vdb(tmp_path / name / f"smoke.{number}.vdb") for name in ("in", "out/density"))
        assert sorted(grid.name for grid in after.grids) == sorted(grid.name for grid in before.grids)
        by_name = {grid.name: grid for grid in after.grids}
        for grid in before.grids:
            result = by_name[grid.name]
            assert result.tree_type == grid.tree_type and result.metadata["class"] == grid.metadata["class"]
            np.testing.assert_array_equal(result.affine.matrix, grid.affine.matrix)
            np.testing.assert_array_equal(result.affine.offset, grid.affine.offset)
            np.testing.assert_array_equal(result.tree.background, grid.tree.background)
            assert {*METADATA} - {"is_local_space"} <= {*result.metadata}
        box = by_name["density"].topology.active_box()
        assert box is not None
        moved, copy = (by_name[name].tree.values_in(box) for name in ("density", "burn"))
        np.testing.assert_array_equal(copy, moved)
        source = next(grid for grid in before.grids if grid.name == "density")
        assert (source.tree.values_in(box) != moved).mean() > 0.1
        if kind == "centres":
            # The velocity is carried in metres per second: it is of the size that it was.
            fastest = np.linalg.norm(by_name["vel"].tree.values_in(box), axis=-1).max()
            assert fastest == pytest.approx(SPEED * np.linalg.norm([0.5, 1.0, -0.25]), rel=0.05)
