"""scripts/simulate.py: what it refuses, how it reads what Blender leaves, how it goes on; obstacle and fire."""

from __future__ import annotations

import ast
import gzip
import itertools
import json
import math
import shutil
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
import simulate

from tnst_mi import Recipe, load_frames
from tnst_mi.io import open_frames

SCRIPTS = Path(simulate.__file__).parent
X, Y, Z = 3, 4, 5

# Stands in for Blender: takes frames 1 to 3 from a folder, as far as it is told to.
FAKE = """#!{python}
import json, pathlib, shutil, sys
arguments = sys.argv[sys.argv.index("--") + 1 :]
scene, cache = arguments[0], pathlib.Path(arguments[1])
options = dict(zip(arguments[2::2], arguments[3::2]))
with open({calls!r}, "a") as calls:
    calls.write(options["--begin"] + " ")
print("Blender 0.0")
{refusal}
print("bake: scene " + json.dumps({facts!r}))
for frame in range(int(options["--begin"]), {last} + 1):
    for folder in ("data", "config"):
        (cache / folder).mkdir(parents=True, exist_ok=True)
        for file in pathlib.Path({stock!r}, folder).glob(f"*_{{frame:04d}}.uni"):
            shutil.copy(file, cache / folder)
    print("bake: frame", frame, flush=True)
"""
FACTS = {
    "blender_version": "0.0",
    "source": "a ball",
    "simulation_parameters": {"vorticity": 0.5},
    "domain_height_m": 3.0,
    "domain": {"turn_degrees": 30.0},
    "frames_per_second": 25,
}


def write_uni(path: Path, values: np.ndarray, kind: int) -> None:
    """Oracle: what Mantaflow writes, x fastest."""
    vectors = values.shape[-1] == 3 and values.ndim == 4
    depth, height, width = values.shape[:3]
    header = struct.pack("<6i", width, height, depth, kind, 2 if vectors else 1, 12 if vectors else 4)
    path.parent.mkdir(parents=True, exist_ok=True)
    with gzip.open(path, "wb") as file:
        file.write(b"MNT3" + header + b"a build".ljust(252, b"\0") + struct.pack("<iQ", 0, 0))
        file.write(values.astype("<f4").tobytes())


def cache_frame(folder: Path, frame: int, solid: bool = True) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One frame as Blender leaves it: density (Z, Y, X), velocity on faces (Z, Y, X, 3), distance from solids."""
    rng = np.random.default_rng(frame)
    density = np.float32(rng.random((Z, Y, X)))
    density[0, 1, 2], density[3, 2, 1], density[4, 0, 0] = 5e-7, -1e-8, 2e-6
    velocity = np.float32(rng.normal(scale=20.0, size=(Z, Y, X, 3)))
    distance = np.float32(rng.normal(size=(Z, Y, X)))
    for name, values, kind in (("density", density, 1), ("vel", velocity, 12), ("phiObsIn", distance, 17))[: 2 + solid]:
        write_uni(folder / "data" / f"{name}_{frame:04d}.uni", values, kind)
    write_uni(folder / "config" / f"config_{frame:04d}.uni", density[:1], 1)
    return density, velocity, distance


@pytest.fixture
def blender(tmp_path: Path):
    """A function that makes a program which stands in for Blender, and ends after a frame or refuses."""

    def make(last: int = 3, refusal: str = "") -> str:
        stock = tmp_path / "stock"
        for frame in (1, 2, 3):
            cache_frame(stock, frame)
        program = tmp_path / "blender"
        text = FAKE.format(
            python=sys.executable,
            calls=str(tmp_path / "calls"),
            facts=FACTS,
            last=last,
            stock=str(stock),
            refusal=f"print('bake: refused {refusal}', flush=True); sys.exit(2)" if refusal else "",
        )
        program.write_text(text, encoding="utf-8")
        program.chmod(0o755)
        return str(program)

    return make


def run(blender: str, out: Path, *more: str) -> int:
    return simulate.main(
        ["smokejet", "--resolution", "24", "--frames", "3", "--out", str(out), "--blender", blender, *more]
    )


def test_a_cached_frame_becomes_ours_cell_by_cell(tmp_path: Path):
    density, faces, distance = cache_frame(tmp_path, 7)
    arrays, build = simulate.read_cached_frame(tmp_path, 7)
    assert build == "a build"
    assert {name: array.dtype for name, array in arrays.items()} == {
        "density": np.float32,
        "velocity": np.float16,
        "obstacle": bool,
    }
    assert arrays["density"].shape == (Y, Z, X) and arrays["velocity"].shape == (Y, Z, X, 3)

    def centre(z: int, y: int, x: int, axis: int, step: tuple[int, int, int]) -> float:
        upper = (z + step[0], y + step[1], x + step[2])
        inside = all(i < n for i, n in zip(upper, (Z, Y, X), strict=True))
        low = float(faces[z, y, x, axis])
        return 0.5 * (low + float(faces[(*upper, axis)])) if inside else low

    for z, y, x in np.ndindex(Y, Z, X):
        # Ours (z, y, x) is Blender's (Z, Y, X) = (y, last - z, x).
        there = (y, Y - 1 - z, x)
        value = float(density[there])
        assert arrays["density"][z, y, x] == (value if value >= 1e-6 else 0.0)
        assert arrays["obstacle"][z, y, x] == (distance[there] < 0.0)
        across, back, up = (
            0.1 * centre(*there, axis, step) for axis, step in enumerate(((0, 0, 1), (0, 1, 0), (1, 0, 0)))
        )
        # Half of a step, and half of float16's spacing.
        np.testing.assert_allclose(arrays["velocity"][z, y, x], (across, up, -back), rtol=2**-11, atol=2**-10)


def test_without_solids_there_is_no_obstacle(tmp_path: Path):
    cache_frame(tmp_path, 1, solid=False)
    assert set(simulate.read_cached_frame(tmp_path, 1)[0]) == {"density", "velocity"}


def test_a_simulation_leaves_frames_and_what_they_are(blender, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "smoke"
    assert run(blender(), out) == 0
    assert sorted(path.name for path in out.iterdir()) == [f"frame_000{n}.npz" for n in (1, 2, 3)] + ["meta.json"]
    assert [frame.number for frame in load_frames(out)] == [1, 2, 3]
    meta = json.loads((out / "meta.json").read_text(encoding="utf-8"))
    assert meta["frames"] == [1, 2, 3] and meta["shape_dhw"] == [Y, Z, X]
    np.testing.assert_allclose(meta["domain_size_m_xyz"], [3.0 * X / Z, 3.0, 3.0 * Y / Z], atol=1e-6)
    assert meta["simulation_parameters"] == FACTS["simulation_parameters"]
    assert "3 frames" in capsys.readouterr().out
    # Frames that nobody is at work on are not written over.
    before = (out / "frame_0001.npz").read_bytes()
    assert run(blender(), out) == 2
    assert (out / "frame_0001.npz").read_bytes() == before


def test_a_simulation_that_ended_early_is_gone_on_with(blender, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    whole, out = tmp_path / "whole", tmp_path / "smoke"
    assert run(blender(), whole) == 0
    assert run(blender(last=2), out) == 1
    assert "after frame 2 of 3" in capsys.readouterr().err
    kept = {path.name for path in (out / ".work" / "cache" / "data").iterdir()}
    assert kept == {f"{name}_0002.uni" for name in ("density", "vel", "phiObsIn")}, "what the next frame needs"
    assert run(blender(), out, "--resolution", "48") == 2, "another simulation"
    # What a killed run was writing.
    (out / ".tnst_mi-frame_0003.123.npz").touch()
    assert run(blender(), out) == 0
    assert (tmp_path / "calls").read_text().split() == ["1", "1", "3"]
    assert {path.name: path.read_bytes() for path in out.iterdir()} == {
        path.name: path.read_bytes() for path in whole.iterdir()
    }


def test_without_the_solver_s_state_it_begins_anew(blender, tmp_path: Path):
    out = tmp_path / "smoke"
    assert run(blender(last=2), out) == 1
    (out / ".work" / "cache" / "stale").touch()
    for file in (out / ".work" / "cache").rglob("*_0002.uni"):
        file.unlink()
    assert run(blender(last=1), out) == 1
    assert (tmp_path / "calls").read_text().split() == ["1", "1"]
    assert not (out / ".work" / "cache" / "stale").exists()


def test_a_scene_whose_cache_is_the_result(blender, tmp_path: Path, monkeypatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.chdir(tmp_path)
    program = Path(blender(last=2))
    fire = ["fire", "--resolution", "24", "--frames", "3", "--out", "fire", "--blender", f"./{program.name}"]
    assert simulate.main(fire) == 1
    assert not (tmp_path / "fire" / "cache").exists(), "what is there is whole"
    blender()
    assert simulate.main(fire) == 0
    assert (tmp_path / "calls").read_text().split() == ["1", "1"]
    out = tmp_path / "fire"
    assert sorted(path.name for path in out.iterdir()) == ["cache", "meta.json"]
    stock = {path.name: path.read_bytes() for path in (tmp_path / "stock").rglob("*.uni")}
    assert {path.name: path.read_bytes() for path in (out / "cache").rglob("*.uni")} == stock
    meta = json.loads((out / "meta.json").read_text(encoding="utf-8"))
    assert meta["frames"] == [1, 2, 3] and meta["domain"] == {"turn_degrees": 30.0}
    # It is not written over.
    capsys.readouterr()
    assert simulate.main(fire) == 2
    assert "fire: has a cache already" in capsys.readouterr().err


def test_what_blender_refuses_is_bad_input(blender, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    mesh = tmp_path / "empty.obj"
    mesh.write_text("# nothing\n", encoding="utf-8")
    out = tmp_path / "smoke"
    program = blender(refusal="the mesh has no faces")
    assert simulate.main(["mesh", "--mesh", str(mesh), "--out", str(out), "--blender", program]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == f"simulate.py: {mesh}: the mesh has no faces"
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["smoke"], "invalid choice: 'smoke'"),
        (["smokejet", "--resolution", "many"], "--resolution: invalid int value: 'many'"),
        (["smokejet", "--resolution", "8"], "--resolution 8: expected 24 to 2048"),
        (["smokejet", "--frames", "0"], "--frames 0: expected 1 to 9999"),
        (["smokejet", "--mesh", "bunny.obj"], "the scene mesh needs --mesh FILE.obj"),
        (["mesh"], "the scene mesh needs --mesh FILE.obj"),
        (["mesh", "--mesh", "missing.obj"], "missing.obj: expected a Wavefront OBJ file"),
        (["smokejet", "--blender", "no-such-program"], "apt-get install blender"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    arguments: list[str], message: str, tmp_path: Path, monkeypatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    assert simulate.main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and message in err
    assert list(tmp_path.iterdir()) == []


def test_blender_s_script_needs_nothing_that_blender_lacks_and_knows_the_scenes():
    tree = ast.parse((SCRIPTS / "blender_bake.py").read_text(encoding="utf-8"))
    imported = {name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names}
    imported |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert {name.partition(".")[0] for name in imported} - set(sys.stdlib_module_names) == {"bpy"}
    scenes = next(node.value for node in tree.body if isinstance(node, ast.Assign) and node.targets[0].id == "SCENES")
    assert tuple(key.value for key in scenes.keys) == simulate.SCENES


def sphere(shape: tuple[int, int, int]) -> np.ndarray:
    """Oracle: the cells of the domain, 3 m high, whose centres are in the solid sphere."""
    z, y, x = (np.indices(shape) + 0.5) * 3.0 / shape[1]
    return np.sqrt((x - 1.4) ** 2 + (y - 1.5) ** 2 + (z - 1.0) ** 2) < 0.3


def test_the_bundled_smoke_flows_around_the_sphere():
    scene = SCRIPTS.parent / "scenes" / "obstacle"
    (frame,) = load_frames(scene)
    assert json.loads((scene / "meta.json").read_text(encoding="utf-8"))["frames"] == [frame.number]
    assert frame.density.shape == (64, 96, 64)
    solid = sphere(frame.density.shape)
    np.testing.assert_array_equal(frame.obstacle, solid)
    assert frame.density[solid].max() == 0.0 and np.abs(frame.velocity[solid]).max() == 0.0
    # Smoke below, above and on both sides, within three cells of the sphere.
    near = frame.density.copy()
    z, y, x = (np.indices(near.shape) + 0.5) * 3.0 / 96
    near[np.sqrt((x - 1.4) ** 2 + (y - 1.5) ** 2 + (z - 1.0) ** 2) > 0.3 + 3 * 3 / 96] = 0.0
    for part in (y < 1.35, y > 1.6, z < 0.85, z > 1.15):
        assert near[part].sum() > 10.0
    assert Recipe.from_toml(scene / "recipe.toml").style


@pytest.mark.skipif(shutil.which("blender") is None, reason="Blender is not installed")
def test_blender_simulates_the_jet_and_the_sphere_in_its_way(tmp_path: Path):
    out = tmp_path / "smoke"
    assert simulate.main(["obstacle", "--resolution", "24", "--frames", "2", "--out", str(out)]) == 0
    first, second = load_frames(out)
    assert first.density.shape == (16, 24, 16)
    z, y, x = (np.indices(first.density.shape) + 0.5) / 8.0
    np.testing.assert_array_equal(first.obstacle, sphere(first.density.shape))
    # The source is where it is meant to be, and blows along +x.
    mass = second.density.sum()
    centre = [(second.density * axis).sum() / mass for axis in (x, y, z)]
    assert math.dist(centre, (0.28, 0.36, 1.0)) < 1 / 8
    assert 0.1 < np.average(second.velocity[..., 0], weights=second.density) < 3.0


@pytest.mark.skipif(shutil.which("blender") is None, reason="Blender is not installed")
def test_blender_simulates_fire_in_an_adaptive_turned_domain_with_noise(tmp_path: Path):
    out = tmp_path / "fire"
    assert simulate.main(["fire", "--resolution", "24", "--frames", "3", "--out", str(out)]) == 0
    # The middle of the ring, seen from the lowest corner of the domain, whose object is turned around (1, 1).
    turn = math.radians(json.loads((out / "meta.json").read_text(encoding="utf-8"))["domain"]["turn_degrees"])
    right, back = 0.8 - 1.0, 0.9 - 1.0
    middle = (
        1.0 + right * math.cos(turn) + back * math.sin(turn),
        1.0 - right * math.sin(turn) + back * math.cos(turn),
        0.4,
    )
    noise, data = open_frames(out / "cache"), open_frames(out / "cache" / "data")
    for frames, cell, files in ((data, 3 / 24, "data"), (noise, 3 / 48, "noise")):
        assert [file.name for file in frames.files] == [f"fluid_{files}_000{n}.vdb" for n in (1, 2, 3)]
        first = frames[0]
        assert math.isclose(first.placement.voxel_size, cell, rel_tol=1e-5)
        z, y, x = (np.indices(first.density.shape) + 0.5) * cell
        mass = first.density.sum(dtype=float)
        placed = [(first.density * axis).sum(dtype=float) / mass for axis in (x, first.density.shape[0] * cell - z, y)]
        assert math.dist(np.add(placed, first.placement.corner), middle) < 3 / 48
    # The noise has no velocity of its own: it moves as the simulation below it.
    # Both are in cells per frame, and eight cells of the noise are one of the simulation.
    coarse, fine = data[2].velocity, noise[2].velocity
    z, y, x, _ = coarse.shape
    means = fine.reshape(z, 2, y, 2, x, 2, 3).mean(axis=(1, 3, 5)) / 2
    shares = {
        shift: (means * np.roll(coarse, shift, axis=(0, 1, 2))).sum() / (coarse * coarse).sum()
        for shift in itertools.product((-1, 0, 1), repeat=3)
    }
    assert max(shares, key=shares.__getitem__) == (0, 0, 0), "in its place"
    assert 0.75 < shares[0, 0, 0] < 1.0, "as fast, but for what is lost between samples"
    # The ring keeps its place and its mass, while the part that is simulated grows.
    assert len({frame.density.shape for frame in data}) == 1
    assert 1.0 <= data[1].mass / data[0].mass < 1.1
