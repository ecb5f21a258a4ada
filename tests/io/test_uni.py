"""Mantaflow's .uni files: every kind of header, faces to centres, z up to y up, and damage."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import load_frames, save_frames
from tnst_mi.io.grids.uni import MAC, REAL, VECTOR, read_uni, read_uni_header, write_uni
from tnst_mi.io.interpretation.orientation import from_z_up, mirrored, to_z_up
from tnst_mi.io.interpretation.staggered import centred_velocity

SHAPE = (3, 5, 4)


def uni_bytes(magic: bytes, values: np.ndarray, grid_type: int, element: int, size: int) -> bytes:
    """A file as Mantaflow writes it, built from the layout of its headers."""
    extents = values.shape[2::-1]
    tail = {b"MNT1": b"", b"MNT2": b"made by hand".ljust(256, b"\0") + b"\0" * 8}
    tail[b"MNT3"] = b"made by hand".ljust(252, b"\0") + struct.pack("<iQ", 0, 12345)
    return gzip.compress(
        magic + struct.pack("<6i", *extents, grid_type, element, size) + tail[magic] + values.tobytes()
    )


@pytest.mark.parametrize("magic", [b"MNT1", b"MNT2", b"MNT3"])
def test_headers_of_all_ages(tmp_path: Path, magic: bytes) -> None:
    values = np.random.default_rng(0).random(SHAPE).astype(np.float32)
    (tmp_path / "a.uni").write_bytes(uni_bytes(magic, values, REAL, 1, 4))
    header, read = read_uni(tmp_path / "a.uni")
    np.testing.assert_array_equal(read, values)
    assert (header.shape, header.staggered) == (SHAPE, False)
    vectors = np.random.default_rng(1).random((*SHAPE, 3))
    (tmp_path / "v.uni").write_bytes(uni_bytes(magic, vectors, VECTOR | MAC, 2, 24))
    header, read = read_uni(tmp_path / "v.uni")
    np.testing.assert_array_equal(read, vectors)
    assert header.staggered and header.dtype == np.float64


def test_what_is_written_is_what_mantaflow_writes(tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((*SHAPE, 3)).astype(np.float32)
    write_uni(tmp_path / "a.uni", values, VECTOR | MAC, "made by hand")
    expected = uni_bytes(b"MNT3", values, VECTOR | MAC, 2, 12)
    written, by_hand = gzip.decompress((tmp_path / "a.uni").read_bytes()), gzip.decompress(expected)
    assert written == by_hand.replace(struct.pack("<Q", 12345), struct.pack("<Q", 0))  # but for the time stamp


def test_z_up_turns_to_y_up_and_back() -> None:
    # A cell and its velocity in a right-handed z-up grid of 2 × 3 × 4 cells (X, Y, Z).
    density, velocity = np.zeros((4, 3, 2)), np.zeros((4, 3, 2, 3))
    density[3, 0, 1] = 1.0
    velocity[3, 0, 1] = 1.0, 2.0, 3.0
    turned = from_z_up(density)
    assert turned.shape == (3, 4, 2)
    assert turned[2, 3, 1] == 1.0  # z = −Y: the nearest along Y is the farthest along z
    assert from_z_up(velocity)[2, 3, 1].tolist() == [1.0, 3.0, -2.0]
    for array in (density, velocity):
        np.testing.assert_array_equal(to_z_up(from_z_up(array)), array)
    flipped = mirrored(from_z_up(velocity), "xz")
    assert flipped[0, 3, 0].tolist() == [-1.0, 3.0, 2.0]


def test_velocities_at_the_edge_of_what_is_known() -> None:
    faces = np.array([5.0, 7.0, 9.0, 4.0], np.float32)[None, None, :, None] * np.array([1.0, 0.0, 0.0], np.float32)
    known = np.array([False, True, True, False])[None, None]
    assert centred_velocity(faces)[0, 0, :, 0].tolist() == [6.0, 8.0, 6.5, 4.0]
    # Cell 0 has its upper face only, cell 2 its lower one, cell 3 none.
    assert centred_velocity(faces, known)[0, 0, :, 0].tolist() == [7.0, 8.0, 9.0, 0.0]


def test_blenders_files_make_a_frame(tmp_path: Path) -> None:
    density = np.random.default_rng(0).random((6, 3, 5)).astype(np.float32)
    x, y, z = np.meshgrid(np.arange(5.0), np.arange(3.0), np.arange(6.0), indexing="ij")
    faces = np.stack([x, 10 * y, 100 * z], axis=-1).transpose(2, 1, 0, 3).astype(np.float32)
    flags = (density > 0.5).astype(np.int32) * 2 + 1
    (tmp_path / "density_0012.uni").write_bytes(uni_bytes(b"MNT3", density, REAL, 1, 4))
    (tmp_path / "vel_0012.uni").write_bytes(uni_bytes(b"MNT3", faces, VECTOR | MAC, 2, 12))
    (tmp_path / "flags_0012.uni").write_bytes(uni_bytes(b"MNT3", flags, 34, 0, 4))
    (tmp_path / "heat_0012.uni").write_bytes(b"is left alone")
    (frame,) = load_frames(tmp_path)
    assert (frame.name, frame.number, frame.placement) == ("density_0012", 12, None)
    np.testing.assert_array_equal(frame.density, from_z_up(density))
    np.testing.assert_array_equal(frame.obstacle, from_z_up(density) > 0.5)
    # Away from the last cells, centres of linear fields are half a cell on; 0.1 time units are a frame.
    centres = np.stack([x + 0.5, 10 * y + 5, 100 * z + 50], axis=-1).transpose(2, 1, 0, 3)[:-1, :-1, :-1]
    np.testing.assert_allclose(to_z_up(frame.velocity)[:-1, :-1, :-1], 0.1 * centres, rtol=1e-6)


@pytest.mark.parametrize("name", ["frame_0012", "density_0012", "0012", "smoke"])
def test_frames_round_trip(tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng(0)
    frame = Frame(rng.random(SHAPE), rng.normal(size=(*SHAPE, 3)), rng.random(SHAPE) < 0.2, name)
    save_frames(tmp_path / "frames", [frame], format="uni")
    assert len(list((tmp_path / "frames").iterdir())) == 3
    (loaded,) = load_frames(tmp_path / "frames")
    for key in ("density", "velocity", "obstacle"):
        np.testing.assert_array_equal(getattr(loaded, key), getattr(frame, key))
    assert loaded.name == name


def test_real_files_hold_the_reference(asset: Callable[[str], Path]) -> None:
    folder = asset("data/formats")
    reference = np.load(folder / "tiny_reference_0040.npz")
    for name, key in (("density", "uni_density"), ("vel", "uni_velocity_mac")):
        header, values = read_uni(folder / f"tiny_{name}_0040.uni")
        np.testing.assert_array_equal(values.swapaxes(0, 2), reference[key])
        assert header.staggered == (name == "vel")
    (frame,) = load_frames(folder / "tiny_density_0040.uni")
    faces = reference["uni_velocity_mac"]
    up = 0.05 * (faces[:, :, :-1, 2] + faces[:, :, 1:, 2])
    np.testing.assert_allclose(frame.velocity[::-1, :-1, :, 1], up.transpose(1, 2, 0), rtol=1e-5, atol=1e-7)


@pytest.mark.filterwarnings("error")
def test_velocities_that_are_no_numbers_are_one_error(tmp_path: Path) -> None:
    write_uni(tmp_path / "a.uni", np.ones(SHAPE, np.float32), REAL)
    for values in ((np.inf, -np.inf), (1e300, 1e300)):
        faces = np.zeros((*SHAPE, 3))
        faces[:2, 0, 0, 2] = values
        (tmp_path / "a_vel.uni").write_bytes(uni_bytes(b"MNT3", faces, VECTOR | MAC, 2, 24))
        with pytest.raises(InputError, match=r"a\.uni: velocity has \d+ NaN or infinite values"):
            load_frames(tmp_path / "a.uni")


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.uni"
    write_uni(path, np.random.default_rng(0).random(SHAPE).astype(np.float32), REAL)
    whole = path.read_bytes()
    for length in range(0, len(whole), 5):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"a\.uni: "):
            read_uni(path)
    content = gzip.decompress(whole)
    for damage, message in (
        (b"DDF2" + content[4:], "expected a Mantaflow grid"),
        (content[:4] + struct.pack("<3i", 1000, 1000, 1000) + content[16:], "more than it holds"),
        (content[:4] + struct.pack("<i", -4) + content[8:], "claims -4 x 5 x 3 cells"),
        (content[:20] + struct.pack("<i", 7) + content[24:], "elements of type 7"),
        (content + b"\0", "more data than"),
        (content[:-1], "truncated: 239 of the 240 bytes"),
        (content[:100], "truncated in its header"),
    ):
        path.write_bytes(gzip.compress(damage))
        with pytest.raises(InputError, match=message):
            read_uni(path)
    with pytest.raises(InputError, match="no such file"):
        read_uni_header(tmp_path / "b.uni")
    write_uni(tmp_path / "v.uni", np.ones((*SHAPE, 3), np.float32), VECTOR)
    with pytest.raises(InputError, match=r"v\.uni: holds vectors, expected a density"):
        load_frames(tmp_path / "v.uni")
