"""Mitsuba's .vol files: held against Mitsuba's own reader and writer; other encodings; damage."""

from __future__ import annotations

import struct
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import load_frames, save_frames
from tnst_mi.io.grids.vol import read_vol, read_vol_shape, write_vol

SHAPE = (3, 5, 4)


@pytest.mark.parametrize("channels", [(), (3,)])
def test_mitsuba_reads_and_writes_the_same(tmp_path: Path, channels: tuple[int, ...]) -> None:
    values = np.random.default_rng(0).random((*SHAPE, *channels)).astype(np.float32)
    write_vol(tmp_path / "ours.vol", values)
    theirs = mi.VolumeGrid(str(tmp_path / "ours.vol"))
    np.testing.assert_array_equal(np.array(theirs).reshape(values.shape), values)
    mi.VolumeGrid(values).write(str(tmp_path / "theirs.vol"))
    np.testing.assert_array_equal(read_vol(tmp_path / "theirs.vol"), values)
    assert (tmp_path / "ours.vol").read_bytes() == (tmp_path / "theirs.vol").read_bytes()


def test_half_and_bytes(tmp_path: Path) -> None:
    header = struct.pack("<3sB5i6f", b"VOL", 3, 2, 4, 5, 3, 1, *(0.0,) * 6)
    values = np.random.default_rng(0).random(SHAPE).astype(np.float16)
    (tmp_path / "half.vol").write_bytes(header + values.tobytes())
    np.testing.assert_array_equal(read_vol(tmp_path / "half.vol"), values.astype(np.float32))
    values = np.random.default_rng(0).integers(0, 256, SHAPE, dtype=np.uint8)
    (tmp_path / "bytes.vol").write_bytes(header[:4] + struct.pack("<i", 3) + header[8:] + values.tobytes())
    np.testing.assert_allclose(read_vol(tmp_path / "bytes.vol"), values / 255.0, rtol=1e-6)


def test_frames_round_trip(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    frame = Frame(rng.random(SHAPE), rng.normal(size=(*SHAPE, 3)), rng.random(SHAPE) < 0.2, "f_07", 7)
    save_frames(tmp_path / "f_07.vol", frame)
    assert {path.name for path in tmp_path.iterdir()} == {"f_07.vol", "f_velocity_07.vol", "f_obstacle_07.vol"}
    (loaded,) = load_frames(tmp_path)
    for key in ("density", "velocity", "obstacle"):
        np.testing.assert_array_equal(getattr(loaded, key), getattr(frame, key))


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.vol"
    write_vol(path, np.ones(SHAPE, np.float32))
    whole = path.read_bytes()
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"a\.vol: "):
            read_vol_shape(path)
    for damage, message in (
        (b"LOV" + whole[3:], "expected a Mitsuba volume"),
        (whole[:4] + struct.pack("<i", 4) + whole[8:], "encoding 4"),
        (
            whole[:8] + struct.pack("<3i", 10_000, 10_000, 10_000) + whole[20:],
            "holds 240 bytes of values, expected 4",
        ),
        (whole[:8] + struct.pack("<i", -4) + whole[12:], "claims -4 x 5 x 3 cells"),
        (whole + b"\0", "holds 241 bytes"),
    ):
        path.write_bytes(damage)
        with pytest.raises(InputError, match=message):
            read_vol(path)
    with pytest.raises(InputError, match="no such file"):
        read_vol(tmp_path / "b.vol")
    with pytest.raises(InputError, match="is a folder"):
        read_vol(tmp_path)
