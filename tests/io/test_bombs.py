"""Small files that would unfold to far more than they hold are refused; honest ones of the same kind are read."""

from __future__ import annotations

import itertools
import struct
import subprocess
import sys
import time
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tnst_mi import Recipe, load_frames
from tnst_mi.errors import InputError
from tnst_mi.geometry.boxes import extents
from tnst_mi.io.grids.npy import read_npy
from tnst_mi.io.grids.uni import REAL, read_uni, write_uni
from tnst_mi.io.grids.vdb import DenseGrid, read_vdb, write_vdb
from tnst_mi.io.grids.vdb.clumps import clumps_of, stray
from tnst_mi.io.grids.vdb.file_format.tree import LEAF_VOXELS, Tree
from tnst_mi.io.grids.vdb.frames import run_grid_of
from tnst_mi.io.interpretation.conventions import Boxing
from tnst_mi.losses.pictures import read_image
from tnst_mi.network.readers import read_weights


def png(path: Path, edge: int) -> Path:
    """A black picture, compressed as well as PNG can."""
    packed = zlib.compress((b"\0" + b"\0" * edge) * edge, 9)
    parts = ((b"IHDR", struct.pack(">IIBBBBB", edge, edge, 8, 0, 0, 0, 0)), (b"IDAT", packed), (b"IEND", b""))
    chunks = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))
    return path


def test_pictures_that_unfold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="the picture has more than 16777216 pixels; make it smaller"):
        read_image(png(tmp_path / "bomb.png", 6000))
    monkeypatch.setattr("tnst_mi.losses.pictures._PIXELS", (1 << 16, 64))
    with pytest.raises(InputError, match="the picture has more than 65536 pixels"):
        read_image(png(tmp_path / "bomb.png", 300))
    # A file with more bytes may have more pixels.
    with (tmp_path / "bomb.png").open("ab") as file:
        file.truncate(300 * 300 // 64 + 1)
    assert read_image(tmp_path / "bomb.png").grey.shape == (300, 300)


def test_pictures_of_high_dynamic_range_that_unfold(tmp_path: Path) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"Y": np.zeros((3000, 3000), np.float16)}) as file:
        file.write(str(tmp_path / "bomb.exr"))
    with pytest.raises(InputError, match=r"bomb.exr: the picture has more than 8388608 pixels"):
        read_image(tmp_path / "bomb.exr")


def test_pictures_of_many_layers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of which the library would read every one, though one is used."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    layers = {f"layer{number:02}.Y": np.full((30, 30), 0.5, np.float16) for number in range(40)}
    with OpenEXR.File(header, layers) as file:
        file.write(str(tmp_path / "layers.exr"))
    parts = [OpenEXR.Part(header | {"name": f"part{number}"}, layers) for number in range(3)]
    with OpenEXR.File(parts) as file:
        file.write(str(tmp_path / "parts.exr"))
    read = [read_image(tmp_path / name).grey for name in ("layers.exr", "parts.exr")]
    np.testing.assert_array_equal(*read)
    for bound, refused in ((9000, {}), (8999, {"layers": 36000}), (3000, {"layers": 36000, "parts": 108000})):
        monkeypatch.setattr("tnst_mi.losses.pictures._LINEAR_PIXELS", (bound, 0))
        for name, values in refused.items():
            expected = f"its layers have {values} values, expected at most {4 * bound}; save it without layers"
            with monkeypatch.context() as patch, pytest.raises(InputError, match=expected):
                patch.setattr(OpenEXR, "File", _headers_only)
                read_image(tmp_path / f"{name}.exr")
        if not refused:
            np.testing.assert_array_equal(read_image(tmp_path / "layers.exr").grey, read[0])


def _headers_only(path: str, separate_channels: bool = False, header_only: bool = False) -> Any:
    """OpenEXR's reader of a file, where its pixels must not be read."""
    assert header_only
    return _READ_EXR(path, header_only=True)


_READ_EXR = OpenEXR.File


def test_libraries_print_nothing_about_damaged_pictures(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": np.random.default_rng(0).random((20, 20, 3)).astype(np.float32)}) as file:
        file.write(str(tmp_path / "a.exr"))
    content = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "a.exr").write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match=r"a.exr: unreadable picture"):
        read_image(tmp_path / "a.exr")
    assert capfd.readouterr() == ("", "")


def test_archives_of_weights_that_unfold(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("tensorflow_inception_graph.pb", b"\x08\x01" * (2 << 20))
    with pytest.raises(InputError, match=r"an archive of .* bytes that claims to hold 4194304"):
        read_weights(tmp_path / "bomb.zip")


def test_protocol_buffers_of_countless_fields(tmp_path: Path) -> None:
    (tmp_path / "bomb.caffemodel").write_bytes(b"\x08\x01" * ((1 << 20) + 1))
    with pytest.raises(InputError, match="more than 1048576 fields in a message"):
        read_weights(tmp_path / "bomb.caffemodel")


def test_arrays_that_exceed_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.ones((10, 10, 10), np.float32)
    np.save(tmp_path / "a.npy", values)
    write_uni(tmp_path / "a.uni", values, REAL)
    monkeypatch.setattr("tnst_mi.io.untrusted.free_memory", lambda: 12_001)
    assert read_npy(tmp_path / "a.npy").shape == read_uni(tmp_path / "a.uni")[1].shape == (10, 10, 10)
    monkeypatch.setattr("tnst_mi.io.untrusted.free_memory", lambda: 11_999)
    for read in (read_npy, read_uni):
        with pytest.raises(InputError, match=r"takes 0\.012 MB, and 0\.012 MB of memory are free"):
            read(tmp_path / ("a.npy" if read is read_npy else "a.uni"))


def block(edge: int) -> np.ndarray:
    return np.ones((edge,) * 3, np.float32)


def test_boxes_of_grids_are_in_proportion_to_what_the_file_stores(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    smoke = rng.random((8, 8, 8)).astype(np.float32) + 0.5
    far = [DenseGrid("density", smoke), DenseGrid("density", smoke, (256, 256, 256))]
    write_vdb(tmp_path / "far.vdb", far, {})
    with pytest.raises(InputError, match=r"spans 264 × 264 × 264 cells in a file of \d+ bytes"):
        load_frames(tmp_path / "far.vdb")
    near = [DenseGrid("density", smoke), DenseGrid("density", smoke, (128, 128, 128))]
    write_vdb(tmp_path / "near.vdb", near, {})
    assert load_frames(tmp_path / "near.vdb")[0].density.shape == (136, 136, 136)


def test_tiles_count_as_what_they_take_in_the_file(tmp_path: Path) -> None:
    """Two tiles of 128³ voxels, far apart: 4 million active voxels in a file of a few kilobytes."""
    grids = [DenseGrid("density", block(128)), DenseGrid("density", block(128), (256, 256, 256))]
    write_vdb(tmp_path / "a.vdb", grids, {})
    assert (tmp_path / "a.vdb").stat().st_size < 40_000
    with pytest.raises(InputError, match=r"spans 384 × 384 × 384 cells in a file of \d+ bytes"):
        load_frames(tmp_path / "a.vdb")


def thin_plume(path: Path, edge: int, radius: float) -> None:
    """Smoke along the diagonal of a cube, in slabs that are grids of one name."""
    rng = np.random.default_rng(0)
    grids, slab, reach = [], 16, int(2 * radius)
    for start in range(0, edge, slab):
        across, along = np.arange(start - reach, start + slab + reach), np.arange(start, start + slab)
        places = np.stack(np.meshgrid(across, across, along, indexing="ij"), axis=-1)
        distance = np.linalg.norm(places - places.mean(axis=-1, keepdims=True), axis=-1)
        inside = (distance <= radius) & ((places >= 0) & (places < edge)).all(axis=-1)
        values = np.where(inside, rng.random(inside.shape) + 0.1, 0.0).astype(np.float32)
        grids.append(DenseGrid("density", values, (start, start - reach, start - reach), half=True))
    write_vdb(path, grids, {})


@pytest.mark.parametrize(("edge", "radius"), [(512, 8.0), (512, 4.0), (256, 4.0)])
def test_a_thin_plume_through_a_large_box_is_in_proportion(edge: int, radius: float, tmp_path: Path) -> None:
    """Of the largest box that is read, it fills 0.03 to 0.15%."""
    thin_plume(tmp_path / "a.vdb", edge, radius)
    run = run_grid_of([tmp_path / "a.vdb"], boxing=Boxing(crop=True))
    assert run is not None and extents(run.box).tolist() == [edge] * 3


def test_memory_is_in_proportion_to_the_file_whatever_its_tiles_say(tmp_path: Path) -> None:
    """Tiles of 8³ voxels count as many voxels in few bytes: together, less than a thousandth of their box."""
    grids = [DenseGrid("density", block(64), (place, 0, 0)) for place in (0, 128, 256)]
    write_vdb(tmp_path / "a.vdb", [*grids, DenseGrid("density", block(8), (512, 300, 500))], {})
    with pytest.raises(InputError, match=r"spans 520 × 308 × 508 cells in a file of \d+ bytes"):
        load_frames(tmp_path / "a.vdb")


def test_small_boxes_with_many_quantities_have_a_bound_in_bytes(tmp_path: Path) -> None:
    """16 million cells are harmless for a density, not for all that a frame may hold."""
    ends = [DenseGrid("density", block(8), (place, 0, 0)) for place in (0, 260_000)]
    write_vdb(tmp_path / "a.vdb", ends, {})
    assert load_frames(tmp_path / "a.vdb")[0].density.shape == (8, 8, 260_008)
    moving = [DenseGrid("velocity", np.ones((8, 8, 8, 3), np.float32))]
    write_vdb(tmp_path / "b.vdb", [*ends, *moving, DenseGrid("obstacle", block(8))], {})
    with pytest.raises(InputError, match="spans 260008 × 8 × 8 cells in a file"):
        load_frames(tmp_path / "b.vdb")


def test_grids_with_finer_voxels_have_a_bound_too(tmp_path: Path) -> None:
    """The velocity's voxels at the density's cells: a box of the density does not bound theirs."""
    fine = [DenseGrid("velocity", np.ones((8, 8, 8, 3), np.float32), (p, p, p), voxel_size=0.05) for p in (0, 312)]
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", block(16)), *fine], {})
    with pytest.raises(InputError, match=r"grid 'velocity' spans .* voxels in a file of \d+ bytes, expected a number"):
        load_frames(tmp_path / "a.vdb")


def tiles_tree(origins: np.ndarray, edges: np.ndarray) -> Tree:
    values = np.ones(len(origins), np.float32)
    return Tree(
        background=np.zeros((), np.float32),
        leaf_origins=np.zeros((0, 3), np.int64),
        leaf_active=np.zeros((0, LEAF_VOXELS), bool),
        leaf_values=np.zeros((0, LEAF_VOXELS), np.float32),
        tile_origins=origins,
        tile_edges=edges,
        tile_active=values > 0,
        tile_values=values,
    )


@pytest.mark.parametrize("step", [128, 256])
def test_clumps_of_all_tiles_of_a_node_are_found_in_no_time(step: int) -> None:
    """A node of a few kilobytes can have 32³ tiles of 128³ voxels."""
    origins = step * np.stack(np.meshgrid(*[np.arange(32)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    started = time.process_time()
    clumps = clumps_of([tiles_tree(origins, np.full(len(origins), 128))])
    assert len(clumps) == (1 if step == 128 else 32**3)
    assert time.process_time() - started < 2.0


def test_values_that_are_not_finite_have_no_mass() -> None:
    origins = np.array([[0, 0, 0], [256, 0, 0], [512, 0, 0]])
    tree = tiles_tree(origins, np.full(3, 8))
    tree.tile_values[1:] = np.nan, np.inf
    assert [clump.mass for clump in clumps_of([tree])] == [8.0**3, 0.0, 0.0]


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_smoke_in_neighbouring_bins_is_of_one_clump(seed: int) -> None:
    """Tiles of both sizes at random, against all pairs of them."""
    rng = np.random.default_rng(seed)
    edges = rng.choice([8, 128], 24, p=[0.8, 0.2])
    # Near and far from the origin, where places are negative.
    origins = rng.integers(-6, 6, (24, 3)) * 64 // edges[:, None] * edges[:, None]
    low, high = origins // 32, (origins + edges[:, None] - 1) // 32
    groups = [{number} for number in range(24)]
    for one, other in itertools.combinations(range(24), 2):
        if max(*(low[one] - high[other]), *(low[other] - high[one])) <= 1:
            joined = groups[one] | groups[other]
            for number in joined:
                groups[number] = joined
    expected = sorted({tuple(sorted(group)) for group in groups})
    boxes = sorted(
        [*origins[[*group]].min(axis=0), *(origins + edges[:, None] - 1)[[*group]].max(axis=0)] for group in expected
    )
    clumps = clumps_of([tiles_tree(origins, edges)])
    assert sorted([*clump.box[0], *clump.box[1]] for clump in clumps) == boxes


def test_a_wide_box_is_described_in_little_memory(tmp_path: Path) -> None:
    """One bit of a leaf's place is flipped; a process of its own, so that its peak of memory is that of the command."""
    if sys.platform != "linux":
        pytest.skip("reads the peak of memory from /proc")
    smoke = np.random.default_rng(0).random((8, 8, 8)).astype(np.float32) + 0.5
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", smoke), DenseGrid("density", smoke, (4096, 0, 0))], {})
    content, node = (tmp_path / "a.vdb").read_bytes(), np.array([4096, 0, 0], "<i4").tobytes()
    assert content.count(node) == 1
    (tmp_path / "a.vdb").write_bytes(content.replace(node, np.array([0, 1 << 20, 0], "<i4").tobytes()))
    program = (
        "import sys; from pathlib import Path; from tnst_mi.cli import main; code = main(['info', sys.argv[1]]); "
        "status = Path('/proc/self/status').read_text(); print(code, status.split('VmHWM:')[1].split()[0])"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "a.vdb")]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    code, peak = map(int, ran.stdout.split())
    assert code == 2 and "its grid spans 8 × 1048584 × 8 cells in a file of" in ran.stderr
    assert peak < 300_000  # kilobytes


def test_nodes_at_impossible_places_are_taken_where_openvdb_takes_them(tmp_path: Path) -> None:
    smoke = np.random.default_rng(0).random((8, 8, 8)).astype(np.float32)
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", smoke, (4096, 0, 0))], {})
    content, node = (tmp_path / "a.vdb").read_bytes(), np.array([4096, 0, 0], "<i4").tobytes()
    assert content.count(node) == 1
    (tmp_path / "b.vdb").write_bytes(content.replace(node, np.array([4099, 1, 5], "<i4").tobytes()))
    assert read_vdb(tmp_path / "b.vdb").grids[0].tree.leaf_origins.tolist() == [[4096, 0, 0]]


def test_grids_that_overlap_in_the_file(tmp_path: Path) -> None:
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", block(9)), DenseGrid("other", block(9))], {})
    content = bytearray((tmp_path / "a.vdb").read_bytes())
    first, second = read_vdb(tmp_path / "a.vdb").grids
    place = content.index(struct.pack("<2q", second.span[1], second.span[2])) - 8
    own = content.index(struct.pack("<2q", first.span[1], first.span[2])) - 8
    content[place : place + 8] = content[own : own + 8]
    (tmp_path / "b.vdb").write_bytes(content)
    with pytest.raises(InputError, match="grid 'other' begins before its description ends"):
        read_vdb(tmp_path / "b.vdb")


def test_stray_clumps_are_the_lightest_that_together_have_next_to_none() -> None:
    """Many clumps, against the definition written out."""
    rng = np.random.default_rng(0)
    count = 400
    values = np.zeros((count, LEAF_VOXELS), np.float32)
    values[:, 0] = 10.0 ** rng.uniform(-6, 1, count)
    none = np.zeros(0, np.float32)
    tree = Tree(
        background=np.float32(0.0).reshape(()),
        leaf_origins=np.stack([np.arange(count) * 128, np.zeros(count, int), np.zeros(count, int)], axis=1),
        leaf_active=values > 0,
        leaf_values=values,
        tile_origins=np.zeros((0, 3), np.int64),
        tile_edges=np.zeros(0, np.int64),
        tile_active=none > 0,
        tile_values=none,
    )
    clumps = clumps_of([tree])
    masses = np.sort(values[:, 0].astype(float))
    np.testing.assert_allclose([clump.mass for clump in clumps], masses[::-1], rtol=1e-6)
    chosen, whole = 0, masses.sum()
    while masses[: chosen + 1].sum() < 1e-3 * whole:
        chosen += 1
    assert chosen > 50
    assert [clump.mass for clump in stray(clumps)] == [clump.mass for clump in clumps[: count - chosen - 1 : -1]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f'style = ["{"d/" * 3000}a.png"]', "style = .*: File name too long"),
        (f'light = "{"n" * 5000}"', "light = .*: File name too long"),
        (f"seed = {'9' * 5000}", "not a recipe file, truncated, or damaged .*4300 digits"),
    ],
)
def test_recipes_with_endless_values(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "r.toml").write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        Recipe.from_toml(tmp_path / "r.toml")
    assert len(str(caught.value)) <= 300


def test_names_in_damaged_files_do_not_flood_messages(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("n\x1b[31m" * 1000 + ".npy", b"")
    write_vdb(tmp_path / "a.vdb", [DenseGrid("n\x07" * 2000, block(3))], {})
    content = (tmp_path / "a.vdb").read_bytes()
    (tmp_path / "a.vdb").write_bytes(content[:-5])
    for name in ("a.npz", "a.vdb"):
        with pytest.raises(InputError) as caught:
            load_frames(tmp_path / name)
        message = str(caught.value)
        assert len(message) <= 300 and message.isprintable() and name in message
