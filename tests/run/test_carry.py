"""Whole runs with grids beside the density: which move, how they come back, and what is said and recorded."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from jobs import FakeOptimiser, frames, optimiser
from moving_smoke import SHAPE, moving_smoke
from networks import random_googlenet

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.fields.advection import advect
from tnst_mi.frame import Frame
from tnst_mi.io import load_frames, open_frames, save_frames
from tnst_mi.io.grids.npz import read_arrays
from tnst_mi.io.grids.uni import REAL, write_uni
from tnst_mi.io.grids.vdb import DenseGrid, read_vdb, write_vdb
from tnst_mi.io.grids.vol import write_vol
from tnst_mi.io.single_grids import OURS, Y_UP
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.folder import RunFolder
from tnst_mi.run.inputs import conventions_of
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare

__all__ = ["optimiser"]

GOAL = {"semantic": ("inception_3a/3x3:2",), "octaves": 1, "iterations": 2, "views": 2, "eta": 0.02}


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("weights") / "random.safetensors"
    random_googlenet(path, narrow=8)
    return str(path)


def burning(count: int) -> list[Frame]:
    """Smoke with a copy of its density, a temperature below 0 too, colours, and numbers."""
    made = []
    for frame in moving_smoke(count):
        d = frame.density
        grids = {
            "copy": d,
            "half": d.astype(np.float16),
            "temperature": 20 * d - 5,
            "Cd": np.stack([d, 1 - d, 0.5 * d], axis=-1),
            "ids": (100 * d).astype(np.int32),
            "whole": (100 * d).astype(np.int32).astype(np.float32),
        }
        made.append(dataclasses.replace(frame, grids=grids))
    return made


@pytest.mark.parametrize("format", ["npz", "vdb"])
@pytest.mark.parametrize("transport", [{}, {"lam": 1.0}, {"transport": "flow", "lam": 0.5}])
@pytest.mark.parametrize("window", [1, 3])
def test_a_copy_of_the_density_comes_back_as_the_result_bit_for_bit(
    window: int, transport: dict[str, object], format: str, weights: str, tmp_path: Path
) -> None:
    before = burning(3 if window > 1 else 2)
    save_frames(tmp_path / "in", before, format)
    recipe = Recipe(**GOAL, **transport, window=window, weights=weights)
    result = tnst_mi.stylize(tmp_path / "in", recipe, tmp_path / "out", progress=False)
    again = load_frames(tmp_path / "out" / "density")
    for index, frame in enumerate(before):
        density, grids = result.densities[index], result.grids[index]
        assert (density != frame.density).mean() > 0.3
        for found in (grids, again[index].grids):
            np.testing.assert_array_equal(found["copy"], density)
            np.testing.assert_array_equal(found["Cd"][..., 0], density)
            np.testing.assert_array_equal(found["Cd"][..., 2], 0.5 * density)
            assert {found[name].dtype.name for name in ("copy", "temperature", "Cd")} == {"float32"}
            assert found["ids"].dtype == np.int32
        np.testing.assert_array_equal(grids["ids"], np.rint(grids["whole"]))
        assert grids["temperature"].min() < 0
        assert (grids["velocity"] != frame.velocity).any()
        velocity = again[index].velocity
        assert velocity is not None
        np.testing.assert_allclose(velocity, grids["velocity"], atol=1e-6)
    assert result.run["carried"] == ["copy", "half", "temperature", "Cd", "ids", "whole", "velocity"]
    assert result.run["frames"][0]["carried"] == result.run["carried"]
    if format == "npz":
        assert read_arrays(tmp_path / "out" / "density" / "s_005.npz", ["half"])["half"].dtype == np.float16
    else:
        types = {grid.name: grid.tree_type for grid in read_vdb(tmp_path / "out" / "density" / "s_005.vdb").grids}
        assert types["half"] == "Tree_float_5_4_3_HalfFloat"
        assert types["ids"] == "Tree_int32_5_4_3"
        assert types["Cd"] == "Tree_vec3s_5_4_3"


def test_in_memory_and_from_files_they_are_the_same(weights: str, tmp_path: Path) -> None:
    recipe = Recipe(**GOAL, weights=weights)
    save_frames(tmp_path / "in", burning(2))
    stored = tnst_mi.stylize(tmp_path / "in", recipe, tmp_path / "out", progress=False)
    given = tnst_mi.stylize(burning(2), recipe, progress=False)
    assert given.run["carried"] == stored.run["carried"]
    for one, other in zip(given.grids, stored.grids, strict=True):
        assert set(one) == set(other)
        for name in one:
            np.testing.assert_array_equal(one[name], other[name])


@pytest.mark.parametrize(
    ("carry", "kept"),
    [("none", []), ("ids", ["ids"]), ("velocity, Cd", ["Cd", "velocity"]), (["half"], ["half"])],
)
def test_names_choose(carry: str | list[str], kept: list[str], optimiser: FakeOptimiser, tmp_path: Path) -> None:
    save_frames(tmp_path / "in", burning(2))
    recipe = {"style": ["spirals"], "carry": carry}
    result = tnst_mi.stylize(tmp_path / "in", recipe, tmp_path / "out", progress=False)
    assert list(result.grids[1]) == result.run["carried"] == kept
    (first, _) = load_frames(tmp_path / "out" / "density")
    assert list(first.grids) == [name for name in kept if name != "velocity"]
    assert (first.velocity is None) == ("velocity" not in kept)


def test_a_name_that_no_frame_has_is_refused(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    save_frames(tmp_path / "in", burning(1))
    message = "carry = 'flame': no grid 'flame' beside the density, those found are: 'copy', 'half', 'temperature', "
    with pytest.raises(InputError, match=message):
        tnst_mi.stylize(tmp_path / "in", {"style": ["spirals"], "carry": "flame"}, tmp_path / "out", progress=False)
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match="those found are: none"):
        tnst_mi.stylize(frames(0.3), {"style": ["spirals"], "carry": "flame"}, progress=False)


def test_a_grid_that_cannot_be_carried_is_found_before_the_work(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    heat = np.ones(SHAPE, np.float32)
    heat[1, 2, 3] = np.nan
    np.savez(tmp_path / "a.npz", density=np.ones(SHAPE), heat=heat, flame=np.ones(SHAPE))
    recipe = {"style": ["spirals"]}
    message = r"a.*: grid 'heat' has 1 NaN or infinite values, expected finite numbers; .* leave it out with --carry"
    with pytest.raises(InputError, match=message):
        tnst_mi.stylize(tmp_path / "a.npz", recipe, tmp_path / "out", progress=False)
    assert optimiser.calls == []
    result = tnst_mi.stylize(tmp_path / "a.npz", recipe | {"carry": "flame"}, tmp_path / "out", progress=False)
    assert list(result.grids[0]) == ["flame"]


def test_what_moves_is_said(optimiser: FakeOptimiser, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def said(**keys: object) -> list[str]:
        capsys.readouterr()
        for _ in Run(prepare(burning(1), Recipe(style=("spirals",), **keys), tmp_path / str(len(keys)))):
            pass
        lines = capsys.readouterr().err.splitlines()
        return [line for line in lines if line.startswith(("carried", "note: densities", "note: .uni"))]

    all_of_them = "copy, half, temperature, Cd, ids, whole and 1 more"
    assert said() == [f"carried with the smoke: {all_of_them} (--carry all|NAMES|none)"]
    assert said(carry="none", seed=1, gamma=0.2) == []
    assert said(carry="half,Cd", format="uni") == [
        "carried with the smoke: Cd (--carry all|NAMES|none)",
        "note: .uni files do not hold other grids of such names: half",
    ]
    assert said(parameterisation="density", carry="Cd", seed=2, gamma=0.3) == [
        "note: densities change in place, so other grids come back as they are: Cd"
    ]


def test_a_resumed_run_carries_the_same_bits(weights: str, tmp_path: Path) -> None:
    save_frames(tmp_path / "in", burning(3), "vdb")
    recipe, out = Recipe(**GOAL, window=3, weights=weights), tmp_path / "out"
    whole = tnst_mi.stylize(tmp_path / "in", recipe, tmp_path / "whole", progress=False)
    run = Run(prepare(tmp_path / "in", recipe, out), progress=False)
    next(run)
    run._frames.close()  # pyright: ignore[reportAttributeAccessIssue]
    list(Run(prepare(tmp_path / "in", recipe, out, resume=True), progress=False))
    assert json.loads((out / "run.json").read_text())["carried"] == whole.run["carried"]
    for number in (5, 6, 7):
        files = [read_vdb(folder / "density" / f"s_00{number}.vdb") for folder in (out, tmp_path / "whole")]
        for one, other in zip(*(file.grids for file in files), strict=True):
            assert one.name == other.name
            np.testing.assert_array_equal(one.tree.leaf_values, other.tree.leaf_values)


def test_another_grid_is_another_input(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    save_frames(tmp_path / "in", burning(2))
    recipe = Recipe(style=("spirals",))
    optimiser.interrupt_at = "s_006"
    list(Run(prepare(tmp_path / "in", recipe, tmp_path / "out"), progress=False))
    hotter = [dataclasses.replace(f, grids=dict(f.grids) | {"half": f.grids["half"] * 2}) for f in burning(2)]
    save_frames(tmp_path / "in", hotter)
    with pytest.raises(InputError, match="its run had another s_005 than the input has now"):
        prepare(tmp_path / "in", recipe, tmp_path / "out", resume=True)


@pytest.mark.parametrize("format", ["npz", "vdb", "uni"])
def test_a_grid_that_changes_while_a_run_goes_on_is_refused(
    format: str, optimiser: FakeOptimiser, tmp_path: Path
) -> None:
    """Its density is what it was; one that is not carried may change."""
    recipe, out = Recipe(style=("spirals",), carry="Cd"), tmp_path / "out"

    def save(**grids: np.ndarray) -> None:
        for frame in burning(2):
            changed = {"Cd": frame.grids["Cd"], "temperature": frame.grids["temperature"]} | grids
            save_frames(tmp_path / "in" / f"{frame.name}.{format}", dataclasses.replace(frame, grids=changed))

    save()
    job = Run(prepare(tmp_path / "in", recipe, out), progress=False)
    next(job)
    save(temperature=np.ones(SHAPE, np.float32), Cd=np.ones((*SHAPE, 3), np.float32))
    with pytest.raises(InputError, match="s_006: grid 'Cd': has changed since the run began; restore it and go on"):
        next(job)
    assert not list((out / "density").glob("s_006*"))
    save(temperature=np.ones(SHAPE, np.float32))
    list(Run(prepare(tmp_path / "in", recipe, out, resume=True), progress=False))
    np.testing.assert_array_equal(load_frames(out / "density")[1].grids["Cd"], burning(2)[1].grids["Cd"])


@pytest.mark.parametrize("format", ["vdb", "npz"])
def test_vectors_in_a_box_that_follows_its_smoke_stay_those_of_their_file(
    format: str, optimiser: FakeOptimiser, tmp_path: Path
) -> None:
    """A velocity is taken relative to the moving box, a force is not; files in the scene have both as they were."""
    smoke = moving_smoke(1)[0].density + np.float32(0.1)
    force = np.random.default_rng(0).normal(size=(*SHAPE, 3)).astype(np.float32)
    velocity = force + np.float32([30, 0, 0])
    room = {"tnst_mi_box_min": ("vec3i", (-9, -9, -9)), "tnst_mi_box_max": ("vec3i", (119, 29, 29))}
    arrays = {"density": smoke, "vel": velocity, "force": force, "flame": 3 * smoke}
    (tmp_path / "in").mkdir()
    for number in range(3):
        grids = [DenseGrid(name, array, (31 * number, 0, 0)) for name, array in arrays.items()]
        write_vdb(tmp_path / "in" / f"s_{number:04d}.vdb", grids, room)
    recipe = Recipe(style=("spirals",), crop=True, units="cells-per-frame", format=format)
    result = tnst_mi.stylize(tmp_path / "in", recipe, tmp_path / "out", progress=False)
    frames_of = open_frames(tmp_path / "in", given=conventions_of(recipe))
    for number, frame in enumerate(frames_of):
        inside = frame.density > 0
        assert frame.placement.drift == (31, 0, 0) and frame.velocity is not None and inside.sum() == smoke.size
        np.testing.assert_allclose(frame.velocity[inside], (velocity - [31, 0, 0]).reshape(-1, 3), atol=1e-5)
        np.testing.assert_array_equal(frame.grids["force"][inside], force.reshape(-1, 3))
        assert set(result.run["carried"]) == {"force", "flame", "velocity"}
        np.testing.assert_array_equal(result.grids[number]["force"], frame.grids["force"])
        path = tmp_path / "out" / "density" / f"s_{number:04d}.{format}"
        if format == "npz":
            np.testing.assert_array_equal(read_arrays(path, ["force"])["force"], frame.grids["force"])
            continue
        box = np.array([31 * number, 0, 0]), np.array([31 * number, 0, 0]) + SHAPE[::-1] - 1
        written = {grid.name: grid.tree.values_in(box) for grid in read_vdb(path).grids}
        assert set(written) == set(arrays)
        for name, array in (arrays | {"density": 2 * smoke}).items():
            np.testing.assert_array_equal(written[name], array)
    # Other grids of frames that are converted are no velocities either.
    save_frames(tmp_path / "converted", list(frames_of), "vdb")
    for converted, frame in zip(open_frames(tmp_path / "converted"), frames_of, strict=True):
        inside = converted.density > 0
        np.testing.assert_array_equal(converted.grids["force"][inside], force.reshape(-1, 3))
        assert converted.velocity is not None and frame.velocity is not None
        np.testing.assert_allclose(converted.velocity[inside], velocity.reshape(-1, 3), atol=1e-5)


def test_changes_in_place_move_nothing(weights: str) -> None:
    recipe = Recipe(**GOAL, weights=weights, parameterisation="density")
    result = tnst_mi.stylize(burning(1), recipe, progress=False)
    (frame,) = burning(1)
    assert (result.densities[0] != frame.density).any()
    np.testing.assert_array_equal(result.grids[0]["copy"], frame.density)


@pytest.mark.parametrize("format", ["uni", "vol"])
def test_files_of_one_grid_each_have_those_with_words_for_names(
    format: str, optimiser: FakeOptimiser, tmp_path: Path
) -> None:
    """Beside `density_0005` any; beside `s_005`, which says nothing, those of usual names, so that they are found."""
    for name, found in (
        ("density_{:04d}", {"copy", "temperature", "Cd", "ids", "whole"}),
        ("s_{:03d}", {"temperature", "Cd"}),
    ):
        given = [dataclasses.replace(f, name=name.format(f.number)) for f in burning(2)]
        for frame in given:
            grids = {key: value for key, value in frame.grids.items() if key != "half"}
            save_frames(tmp_path / name / f"{frame.name}.{format}", dataclasses.replace(frame, grids=grids))
        out = tmp_path / f"out {name}"
        result = tnst_mi.stylize(tmp_path / name, Recipe(style=("spirals",)), out, progress=False)
        assert set(result.run["frames"][0]["carried"]) == found | {"velocity"}
        again = load_frames(out / "density")
        assert [frame.number for frame in again] == [5, 6]
        assert set(again[0].grids) == found
        for key in found:
            np.testing.assert_array_equal(again[0].grids[key], given[0].grids[key])
        # All of it is removed again with the run.
        RunFolder(out, Recipe(style=("spirals",)), overwrite=True)
        assert not (out / "density").exists()


@pytest.mark.parametrize("format", ["uni", "vol"])
@pytest.mark.parametrize("components", [("vel_x", "vel_y", "vel_z"), ("u", "v", "w")])
def test_a_velocity_in_three_files_is_none_of_the_other_grids(
    components: tuple[str, str, str], format: str, optimiser: FakeOptimiser, tmp_path: Path
) -> None:
    """The file of another grid beside them moves, and so does the velocity, which comes back in one file."""
    (frame,) = burning(1)
    assert frame.velocity is not None
    parts = dict(zip(components, np.moveaxis(frame.velocity, -1, 0), strict=True))
    (tmp_path / "in").mkdir()
    for name, array in ({"density": frame.density, "temperature": frame.grids["temperature"]} | parts).items():
        path = tmp_path / "in" / f"{name}_0005.{format}"
        if format == "uni":
            write_uni(path, np.ascontiguousarray(array), REAL, OURS + Y_UP)
        else:
            write_vol(path, np.ascontiguousarray(array))
    recipe = Recipe(style=("spirals",), units="cells-per-frame")
    (read,) = open_frames(tmp_path / "in", given=conventions_of(recipe))
    assert read.velocity is not None and list(read.grids) == ["temperature"]
    assert "other grids: temperature" in read.reading and "not read" not in read.reading
    result = tnst_mi.stylize(tmp_path / "in", recipe, tmp_path / "out", progress=False)
    assert result.run["carried"] == ["temperature", "velocity"]
    names = {path.name for path in (tmp_path / "out" / "density").iterdir()}
    assert names == {f"{name}_0005.{format}" for name in ("density", "velocity", "temperature")}
    (again,) = load_frames(tmp_path / "out" / "density")
    np.testing.assert_array_equal(again.grids["temperature"], read.grids["temperature"])
    np.testing.assert_array_equal(again.velocity, read.velocity)


def noise_cache(folder: Path) -> None:
    smoke = moving_smoke(1)[0].density.transpose(1, 0, 2)
    blender = {"file_base_resolution": ("vec3i", smoke.shape[::-1])}
    (folder / "data").mkdir(parents=True)
    (folder / "noise").mkdir()
    vectors = np.stack([smoke] * 3, axis=-1)
    grids = {"density": smoke, "flame": smoke, "velocity": vectors}
    write_vdb(
        folder / "data" / "fluid_data_0001.vdb",
        [DenseGrid(name, values, metadata=blender) for name, values in grids.items()],
        {},
    )
    write_vdb(
        folder / "noise" / "fluid_noise_0001.vdb",
        [DenseGrid(name, smoke, metadata=blender) for name in ("density_noise", "flame_noise")],
        {},
    )


def test_the_noise_of_a_cache_carries_what_its_file_has(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    noise_cache(tmp_path / "cache")
    result = tnst_mi.stylize(tmp_path / "cache", Recipe(style=("spirals",)), tmp_path / "out", progress=False)
    names = [grid.name for grid in read_vdb(tmp_path / "out" / "density" / "fluid_noise_0001.vdb").grids]
    assert names == ["density_noise", "flame_noise"]
    assert result.run["frames"][0]["carried"] == ["flame_noise"]


def test_the_case_with_other_grids(asset: Callable[[str], Path], weights: str, tmp_path: Path) -> None:
    """All grids come back, moved by the same v*: flame is three times the density there, colours are equal to it."""
    file = asset("cases/41-other-grids/fire_0001.vdb")
    recipe = Recipe(**GOAL | {"lam": 0.5, "transport": "flow"}, weights=weights)
    result = tnst_mi.stylize(file, recipe, tmp_path / "out", progress=False)
    before, after = read_vdb(file), read_vdb(tmp_path / "out" / "density" / "fire_0001.vdb")
    described = [
        {grid.name: (grid.tree_type, grid.metadata.get("class", "unknown"), grid.voxel_size) for grid in found.grids}
        for found in (before, after)
    ]
    assert described[0] == described[1]
    density, grids = result.densities[0], result.grids[0]
    assert (density != load_frames(file)[0].density).mean() > 0.3
    np.testing.assert_array_equal(grids["Cd"], np.stack([density] * 3, axis=-1))
    np.testing.assert_allclose(grids["flame"], 3 * density, atol=1e-5)
    np.testing.assert_allclose(grids["temperature"], 1500 * density, rtol=1e-5, atol=5e-3)


def test_colours_that_the_smoke_is_shown_in_come_in_from_the_border(
    asset: Callable[[str], Path], weights: str, tmp_path: Path
) -> None:
    """Where they are grids like others, nothing comes in, as nothing of the density does."""
    file = asset("cases/41-other-grids/fire_0001.vdb")
    before = load_frames(file)[0]
    for colour, outside in (("off", "zero"), ("keep", "edge")):
        recipe = Recipe(**GOAL | {"lam": 0.5, "transport": "flow", "colour": colour}, weights=weights)
        result = tnst_mi.stylize(file, recipe, tmp_path / colour, progress=False)
        moved = advect(before.grids["Cd"], result.velocities[0], outside=outside, trace="flow")
        np.testing.assert_allclose(result.grids[0]["Cd"], moved, atol=1e-5)
