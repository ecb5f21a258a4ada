"""Hold our OpenVDB reader and writer against the official module, grid by grid, voxel by voxel.

    python scripts/check_vdb.py [FILE.vdb…] [--python PROGRAM] [--keep FOLDER]

The official module makes files with everything that trees can have (tiles, several inactive values, half precision,
shared trees, a level set…) and says what is in them, and in the given files; our reader must find the same. Our
writer's files, in each of its compressions, must hold for the official module what went in. One line for every grid:
the largest difference of a value, and whether active voxels, class and transform agree. Exit code 1 if any differs.

Then results are held against their sources: the official module makes smoke in voxels of every kind (turned, mirrored,
rotated, sheared, of unequal edges, of sizes and places that change from frame to frame, far from the origin, in half
precision, in tiles, with another background, of a Blender domain that is adaptive, where the files' transforms are
untrue), our reader reads them as a run does, our writer writes what it read, and the official module samples both files
at 1000 points of the scene: where nothing was moved, they must agree to 1e-5. Of the adaptive domain, results on its
true lattice are held against the smoke in its true place too.

Without the module it says so and checks nothing: it is not on PyPI. Debian has it for its own Python (`apt-get install
python3-openvdb`), which is run for it; give another one with --python. --keep leaves the official files, compressed,
with the values in them as npz: the files of tests/data/vdb were made so.
"""

from __future__ import annotations

import argparse
import gzip
import json
import struct
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

PYTHON = "/usr/bin/python3"

# The trees that the official module knows in Python and that we read.
_KNOWN_THERE = ("Tree_float_", "Tree_vec3s_")

# Largest difference between densities of a source and its result at a point of the scene.
_AGREE = 1e-5

#: Matrices of the voxels of each frame, for row vectors as OpenVDB has them, translations, and what is particular.
PLACEMENTS: dict[str, tuple[list[list[list[float]]], list[list[float]], str]] = {
    "turned": ([[[0, 0.1, 0], [0, 0, 0.1], [0.1, 0, 0]]], [[1, 2, 3]], ""),
    "half_turned": ([[[-0.1, 0, 0], [0, -0.1, 0], [0, 0, 0.1]]], [[1, 2, 3]], ""),
    "mirrored": ([[[-0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]], [[1, 2, 3]], ""),
    "rotated": ([[[0.08, 0.06, 0], [-0.06, 0.08, 0], [0, 0, 0.1]]], [[1, 2, 3]], ""),
    "sheared": ([[[0.1, 0, 0.02], [0.04, 0.1, 0], [0, 0, 0.1]]], [[0, 0, 0]], ""),
    "unequal": ([[[0.1, 0, 0], [0, 0.15, 0], [0, 0, 0.08]]], [[0, 0, 0]], ""),
    "almost_cubes": ([[[0.1, 0, 0], [0, 0.1005, 0], [0, 0, 0.1]]], [[0, 0, 0]], ""),
    "adaptive": ([[[e, 0, 0], [0, e, 0], [0, 0, e]] for e in (0.2727, 0.3, 0.3)], [[0, 0, 0]] * 3, ""),
    "whole_voxels": ([[[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]] * 3, [[0.2 * n, 0, -0.1 * n] for n in range(3)], ""),
    "travelling": ([[[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]] * 3, [[40.0 * n, 0, 0] for n in range(3)], ""),
    "far_away": ([[[1e-3, 0, 0], [0, 1e-3, 0], [0, 0, 1e-3]]], [[1e6, 2e5, -3e6]], ""),
    "half": ([[[0.08, 0.06, 0], [-0.06, 0.08, 0], [0, 0, 0.1]]], [[0, 0, 0]], "half"),
    "tiles": ([[[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]], [[0, 0, 0]], "tiles"),
    "blender": ([[[e, 0, 0], [0, e, 0], [0, 0, e]] for e in (3.2 / 24, 3.2 / 27)], [[0, 0, 0]] * 2, "adaptive"),
    "background": ([[[0, 0.1, 0], [0, 0, 0.1], [0.1, 0, 0]]], [[0, 0, 0]], "background"),
}

#: Of Blender's adaptive domain, 3.2 high: the cells of the whole, those of the part in each frame, and its first cell.
WHOLE, PARTS, FIRST = (36, 30, 40), ((24, 20, 22), (27, 20, 22)), ((3, 5, 1), (2, 6, 4))

# Widens the box that is compared around the active voxels, so that inactive ones are too.
_MARGIN = 3


def main() -> int:
    """Run all comparisons and print their table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE.vdb", help="further files to be read")
    parser.add_argument("--python", default=PYTHON, metavar="PROGRAM", help=f"Python with openvdb (default: {PYTHON})")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="where to leave the official files")
    parser.add_argument("--official", nargs="+", help=argparse.SUPPRESS)  # what this script asks of that Python
    arguments = parser.parse_args()
    if arguments.official:
        return run_official(*arguments.official)
    there = subprocess.run([arguments.python, __file__, "--official", "find"], capture_output=True, check=False)
    if there.returncode:
        print(f"skipped: {arguments.python} has no openvdb module (Debian: apt-get install python3-openvdb)")
        return 0
    print(f"{'file':28} {'grid':12} {'voxels':>9} {'difference':>10}  active class transform")
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        ask(arguments.python, "make", folder)
        files = sorted(folder.glob("*.vdb")) + arguments.files
        good = [reader_agrees(file, dumped(arguments.python, file, folder)) for file in files]
        if arguments.keep:
            keep(files, folder, arguments.keep)
        good += [writer_agrees(arguments.python, compression, folder) for compression in ("blosc", "zip", "none")]
        good += [placement_agrees(arguments.python, kind, folder) for kind in PLACEMENTS]
    print("all agree" if all(good) else "DIFFERENCES")
    return 0 if all(good) else 1


def ask(python: str, *words: object) -> None:
    """Run this script's part for the official module in the Python that has it."""
    subprocess.run([python, __file__, "--official", *map(str, words)], check=True)


def dumped(python: str, file: Path, folder: Path) -> dict[str, np.ndarray]:
    """What the official module finds in a file: see `dump`."""
    from tnst_mi.io.grids.vdb import read_vdb

    known = [grid.name for grid in read_vdb(file).grids if grid.tree_type.startswith(_KNOWN_THERE)]
    ask(python, "dump", file, folder / f"{file.stem}.npz", *known)
    with np.load(folder / f"{file.stem}.npz") as arrays:
        return dict(arrays)


def reader_agrees(file: Path, expected: dict[str, np.ndarray]) -> bool:
    """Whether our reader finds in a file what the official module found; prints a line for each grid."""
    from tnst_mi.io.grids.vdb import read_vdb

    good = True
    grids = read_vdb(file).grids
    for number, description in enumerate(json.loads(str(expected["grids"]))):
        grid = [grid for grid in grids if grid.name == description["name"]][description["same_name"]]
        low = expected[f"first_{number}"].astype(np.int64)
        values, active = expected[f"values_{number}"], expected[f"active_{number}"]
        box = (low, low + active.shape[::-1] - 1)
        difference = np.abs(grid.tree.values_in(box).astype(np.float64) - values).max(initial=0.0)
        same_active = bool((grid.tree.active_in(box) == active).all())
        same_active &= grid.tree.active_voxels == description["active_voxels"]
        same_class = grid.metadata.get("class", "unknown") == description["class"]
        transform = [grid.voxel_size, *grid.translation]
        same_transform = np.allclose(transform, description["transform"], rtol=1e-6, atol=1e-9)
        line = (difference, same_active, same_class, same_transform)
        good &= report(file.name, grid.name, description["active_voxels"], *line)
    return good


def writer_agrees(python: str, compression: str, folder: Path) -> bool:
    """Whether the official module finds in a file of ours what we put there; prints a line for each grid."""
    from tnst_mi.io.grids.vdb import DenseGrid, write_vdb

    random = np.random.default_rng(0)
    density = np.where(random.random((37, 21, 300)) < 0.3, random.random((37, 21, 300)), 0.0).astype(np.float32)
    velocity = random.normal(size=(37, 21, 30, 3)).astype(np.float32)
    velocity[5:20] = 0.0
    grids = [
        DenseGrid("density", density, (-130, 5, 4090), 0.125),
        DenseGrid("velocity", velocity, (-13, 0, -8), 0.25, (1.0, -2.0, 3.5)),
        DenseGrid("empty", np.zeros_like(density)),
    ]
    file = folder / f"ours_{compression}.vdb"
    write_vdb(file, grids, {"creator": ("string", "check_vdb")}, compression)
    found = dumped(python, file, folder)
    descriptions = {entry["name"]: (number, entry) for number, entry in enumerate(json.loads(str(found["grids"])))}
    good = True
    for grid in grids:
        number, description = descriptions[grid.name]
        occupied = (grid.values != 0.0).reshape(*grid.values.shape[:3], -1).any(axis=3)
        # Both as lists of voxels, since the boxes differ.
        shift = np.array(grid.first) - found[f"first_{number}"]
        at = tuple((np.argwhere(occupied) + shift[::-1]).T)
        active, values = found[f"active_{number}"], found[f"values_{number}"]
        same_active = bool(active[at].all()) and int(active.sum()) == int(occupied.sum())
        difference = np.abs(values[at] - grid.values[occupied]).max(initial=0.0) + np.abs(values[~active]).max()
        same_class = description["class"] == ("unknown" if grid.values.ndim == 4 else "fog volume")
        same_transform = np.allclose([grid.voxel_size, *grid.translation], description["transform"])
        line = (difference, same_active, same_class, same_transform)
        good &= report(file.name, grid.name, int(occupied.sum()), *line)
    return good


def placement_agrees(python: str, kind: str, folder: Path) -> bool:
    """Whether results lie where their sources lay; prints a line for each frame of a kind."""
    from tnst_mi.io import open_frames, save_frames
    from tnst_mi.io.interpretation.conventions import Boxing, Conventions

    sources, results = folder / kind, folder / f"{kind}_results"
    sources.mkdir()
    ask(python, "place", kind, sources)
    frames = open_frames(sources, given=Conventions(box=Boxing(crop=True)))
    pairs = [(kind, frame, frames.files[0].parent) for frame in frames]
    if (sources / "true").is_dir():
        # A size of voxels that is given makes their true places the transforms of results.
        edge = frames[0].placement.voxel_size
        on_lattice = open_frames(sources, given=Conventions(voxel_size=edge, box=Boxing(crop=True)))
        pairs += [(f"{kind}_true", frame, sources / "true") for frame in on_lattice]
    good = True
    for title, frame, source in pairs:
        result, found = results / title / f"{frame.name}.vdb", results / f"{frame.name}.txt"
        save_frames(result, frame)
        ask(python, "sample", source / f"{frame.name}.vdb", result, found)
        difference = float(found.read_text())
        print(f"{title:28} {frame.name:12} {'1000 points':>9} {difference:10.3g}  {'; '.join(frames.grid_notes)}")
        good &= difference <= _AGREE
    return good


def report(file: str, grid: str, voxels: int, difference: float, *same: bool) -> bool:
    """Print a line of the table, and tell whether all is the same."""
    words = "  ".join("same" if agrees else "OTHER" for agrees in same)
    print(f"{file:28} {grid:12} {voxels:9d} {difference:10.3g}  {words}")
    return difference == 0.0 and all(same)


def keep(files: list[Path], folder: Path, target: Path) -> None:
    """Leave the official files and what is in them."""
    target.mkdir(parents=True, exist_ok=True)
    for file in files:
        (target / f"{file.name}.gz").write_bytes(gzip.compress(file.read_bytes(), 9, mtime=0))
        (target / f"{file.stem}.npz").write_bytes((folder / f"{file.stem}.npz").read_bytes())


# --- With the official module: nothing of ours is imported from here on ---------------------------------------


def run_official(task: str, *words: str) -> int:
    """Make the official files in a folder, or dump the named grids of a file as npz."""
    try:
        import pyopenvdb as openvdb
    except ImportError:
        import openvdb
    if task == "make":
        make(openvdb, Path(words[0]))
    elif task == "place":
        place(openvdb, words[0], Path(words[1]))
    elif task == "sample":
        Path(words[2]).write_text(repr(sampled_difference(openvdb, words[0], words[1])))
    elif task == "dump":
        dump(openvdb, Path(words[0]), Path(words[1]), words[2:])
    return 0


def make(openvdb: object, folder: Path) -> None:
    """Write files with what trees can have."""
    random = np.random.default_rng(1)
    sparse = np.where(random.random((12, 19, 10)) < 0.2, random.random((12, 19, 10)), 0.0).astype(np.float32)
    for half in (False, True):
        density = openvdb.FloatGrid()
        density.name, density.gridClass = "density", openvdb.GridClass.FOG_VOLUME
        density.copyFromArray(sparse, (-9, 4085, 3))
        density.transform = openvdb.createLinearTransform(0.1)
        velocity = openvdb.Vec3SGrid()
        velocity.name, velocity.gridClass = "velocity", openvdb.GridClass.STAGGERED
        velocity.copyFromArray(random.normal(size=(6, 5, 7, 3)).astype(np.float32), (-3, 4090, 5))
        velocity.transform = openvdb.createLinearTransform(
            [[0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 0.5, 0], [1, 2, 3, 1]]
        )
        for grid in (density, velocity):
            grid.saveFloatAsHalf = half
        openvdb.write(str(folder / f"sparse_{'half' if half else 'float'}.vdb"), [density, velocity])

    tiles = openvdb.FloatGrid()
    tiles.name = "tiles"
    tiles.fill((-16, 0, 0), (23, 15, 15), 2.5)
    tiles.fill((64, 0, 0), (79, 15, 7), -1.5, active=False)
    tiles.fill((3, 3, 3), (5, 20, 5), 0.25)
    tiles.prune()
    large = openvdb.FloatGrid(0.5)
    large.name = "large"
    large.fill((128, 0, -128), (255, 127, -1), 3.0)
    large.fill((250, 120, -4), (259, 130, 3), 0.75)
    large.prune()
    empty = openvdb.FloatGrid()
    empty.name = "empty"
    openvdb.write(str(folder / "tiles.vdb"), [tiles, large, empty])

    sphere = openvdb.createLevelSetSphere(radius=3.0, center=(2.0, 1.0, 0.0), voxelSize=0.5)
    sphere.name = "sphere"
    mixed = []
    for name, inactive in (("one", (7.0,)), ("one_mask", (7.0, 0.0)), ("two", (7.0, -3.0)), ("many", (7.0, -3.0, 2.0))):
        grid = openvdb.FloatGrid()
        grid.name = name
        for index, value in enumerate(inactive):
            grid.fill((0, 0, 2 * index), (7, 7, 7), value, active=False)
        grid.fill((1, 1, 0), (2, 2, 7), 0.5)
        mixed.append(grid)
    openvdb.write(str(folder / "inactive.vdb"), [sphere, *mixed])

    shared = tiles.copy()
    shared.name = "density"
    again = sphere.deepCopy()
    again.name = "density"
    openvdb.write(str(folder / "shared.vdb"), [tiles, shared, again])


def place(openvdb: object, kind: str, folder: Path) -> None:
    """Write the frames of one of PLACEMENTS."""
    matrices, translations, particular = PLACEMENTS[kind]
    x, y, z = np.indices((24, 20, 22)) - np.array([11.5, 9.5, 10.5]).reshape(3, 1, 1, 1)
    smoke = np.clip(1.2 - np.sqrt(x**2 + y**2 + z**2) / 8.0, 0, 1).astype(np.float32)
    for number, (matrix, translation) in enumerate(zip(matrices, translations)):  # noqa: B905
        grid = openvdb.FloatGrid(0.25 if particular == "background" else 0.0)
        grid.name, grid.gridClass = "density", openvdb.GridClass.FOG_VOLUME
        if particular == "tiles":
            grid.fill((0, 0, 0), (31, 15, 23), 0.5)
            grid.prune()
        else:
            grid.copyFromArray(smoke, (5, -3, 2))
        grid.saveFloatAsHalf = particular == "half"
        rows = [[*row, 0.0] for row in matrix]
        grid.transform = openvdb.createLinearTransform([*rows, [*translation, 1.0]])
        if particular == "adaptive":
            place_adaptive(openvdb, smoke, grid, number, folder)
        else:
            openvdb.write(str(folder / f"{kind}_{number:04d}.vdb"), [grid])


def place_adaptive(openvdb: object, smoke: np.ndarray, grid: object, number: int, folder: Path) -> None:
    """Write a frame of an adaptive domain as Blender does, with its configuration, and once more in its true place."""
    part, first, edge = PARTS[number], FIRST[number], 3.2 / max(WHOLE)
    grid.clear()
    grid.copyFromArray(np.pad(smoke, [(0, whole - cells) for whole, cells in zip(part, smoke.shape)]))  # noqa: B905
    grid["file_base_resolution"] = part
    data = folder / "data"
    for path in (data, folder / "config", folder / "true"):
        path.mkdir(exist_ok=True)
    name = f"fluid_data_{number:04d}.vdb"
    openvdb.write(str(data / name), [grid])
    grid.transform = openvdb.createLinearTransform(edge)
    grid.transform.translate([edge * cell for cell in first])
    openvdb.write(str(folder / "true" / name), [grid])
    values = struct.pack("<i3i2f", 11, *part, 1 / max(WHOLE), 0.1) + bytes(36 + 12 + 12 + 64)
    ends = [low + cells for low, cells in zip(first, part)]  # noqa: B905
    values += struct.pack("<9i", *WHOLE, *first, *ends) + bytes(20)
    with gzip.open(folder / "config" / f"config_{number:04d}.uni", "wb") as file:
        file.write(values)


def sampled_difference(openvdb: object, source: str, result: str) -> float:
    """The largest difference of two densities at 1000 points of the scene around the smoke of the first."""
    grids = [openvdb.readAll(path)[0][0] for path in (source, result)]
    low, high = grids[0].evalActiveVoxelBoundingBox()
    points = np.random.default_rng(0).uniform(low, high, (1000, 3))
    largest = 0.0
    for point in points:
        place = grids[0].transform.indexToWorld(tuple(point.tolist()))
        one, other = (_trilinear(grid, grid.transform.worldToIndex(place)) for grid in grids)
        largest = max(largest, abs(one - other))
    return largest


def _trilinear(grid: object, index: Sequence[float]) -> float:
    values = grid.getConstAccessor()
    base = np.floor(index).astype(int)
    part = np.array(index) - base
    total = 0.0
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(corner, part, 1 - part))
        total += weight * values.getValue(tuple(int(i) for i in base + corner))
    return float(total)


def dump(openvdb: object, source: Path, target: Path, names: Sequence[str]) -> None:
    """Write what is in a file as npz: for grid i `first_i`, `values_i` and `active_i` of a box, all described."""
    arrays, descriptions = {}, []
    try:
        grids = openvdb.readAll(str(source))[0]
    except TypeError:  # some grid is of a type that the module does not know
        grids = [openvdb.read(str(source), name) for name in names]
    for number, grid in enumerate(grids):
        low, high = grid.evalActiveVoxelBoundingBox()
        if not grid.activeVoxelCount():
            low, high = (0, 0, 0), (0, 0, 0)
        low, high = np.array(low) - _MARGIN, np.array(high) + _MARGIN
        vector = isinstance(grid, openvdb.Vec3SGrid)
        values = np.zeros((*(high - low + 1), *(3,) * vector), np.float32)
        grid.copyToArray(values, tuple(int(index) for index in low))
        active = np.zeros(high - low + 1, bool)
        for item in grid.citerOnValues():
            active[tuple(slice(a - o, b - o + 1) for a, b, o in zip(item.min, item.max, low))] = True  # noqa: B905
        transform = grid.transform
        descriptions.append(
            {
                "name": grid.name,
                "same_name": [entry["name"] for entry in descriptions].count(grid.name),
                "class": str(grid.gridClass),
                "active_voxels": int(grid.activeVoxelCount()),
                "transform": [transform.voxelSize()[0], *transform.indexToWorld((0, 0, 0))],
            }
        )
        arrays[f"first_{number}"] = low.astype(np.int32)
        arrays[f"values_{number}"] = np.ascontiguousarray(np.moveaxis(values, (0, 2), (2, 0)))
        arrays[f"active_{number}"] = np.ascontiguousarray(active.T)
    np.savez_compressed(target, grids=json.dumps(descriptions), **arrays)


if __name__ == "__main__":
    sys.exit(main())
