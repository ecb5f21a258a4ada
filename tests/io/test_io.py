"""Frames on disk: round trips, the authors' layout, and files that must be refused; pictures read back."""

from __future__ import annotations

import errno
import io
import struct
import zipfile
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.lib import format as npy
from PIL import Image

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import load_frames, open_frames, save_frames
from tnst_mi.io.atomic import written_whole
from tnst_mi.io.grids.npz import read_arrays, write_arrays
from tnst_mi.io.grids.vol import write_vol
from tnst_mi.io.interpretation.staggered import centred_velocity
from tnst_mi.io.pictures.exr import write_exr
from tnst_mi.io.pictures.png import write_png

SHAPE = (3, 5, 4)


def random_frame(seed: int = 0, name: str = "frame_0007", number: int | None = 7) -> Frame:
    rng = np.random.default_rng(seed)
    return Frame(rng.random(SHAPE), rng.normal(size=(*SHAPE, 3)), rng.random(SHAPE) < 0.2, name, number)


def test_a_file_round_trips_exactly(tmp_path: Path) -> None:
    frame = random_frame()
    save_frames(tmp_path / "frame_0007.npz", frame)
    (loaded,) = load_frames(tmp_path / "frame_0007.npz")
    for key in ("density", "velocity", "obstacle"):
        expected = getattr(frame, key)
        assert getattr(loaded, key).dtype == expected.dtype
        np.testing.assert_array_equal(getattr(loaded, key), expected)
    assert (loaded.name, loaded.number) == ("frame_0007", 7)
    assert [path.name for path in tmp_path.iterdir()] == ["frame_0007.npz"]


def test_a_folder_is_read_in_the_order_of_its_numbers(tmp_path: Path) -> None:
    frames = [random_frame(i, f"frame_{i}", i) for i in (9, 10, 8)]
    save_frames(tmp_path / "sequence", frames)
    write_arrays(tmp_path / "sequence" / "no_frame.npz", {"other": np.ones(3)})
    (tmp_path / "sequence" / "meta.json").write_text("{}")
    loaded = load_frames(tmp_path / "sequence")
    assert [frame.number for frame in loaded] == [8, 9, 10]
    np.testing.assert_array_equal(loaded[2].density, frames[1].density)
    assert [frame.number for frame in open_frames(tmp_path / "sequence", (9, 10))] == [9, 10]
    with pytest.raises(InputError, match="8 to 10"):
        open_frames(tmp_path / "sequence", (9, 11))


def test_only_the_selected_frames_must_be_without_gaps(tmp_path: Path) -> None:
    save_frames(tmp_path, [random_frame(i, f"f_{i}", i) for i in (1, 4, 5, 9)])
    assert [frame.number for frame in open_frames(tmp_path, (4, 5))] == [4, 5]
    with pytest.raises(InputError, match="missing between 1 and 5: 2, 3"):
        open_frames(tmp_path, (1, 5))
    with pytest.raises(InputError, match="missing between 1 and 9"):
        open_frames(tmp_path)


def test_a_file_without_a_number_cannot_be_selected(tmp_path: Path) -> None:
    save_frames(tmp_path / "smoke.npz", random_frame())
    for path in (tmp_path / "smoke.npz", tmp_path):
        with pytest.raises(InputError, match=r"frames = '3:4': the name of .*smoke.npz has no frame number"):
            open_frames(path, (3, 4))
    save_frames(tmp_path / "f_3.npz", random_frame())
    assert len(open_frames(tmp_path / "f_3.npz", (3, 3))) == 1
    with pytest.raises(InputError, match="frames = '3:4': the input has the frame 3"):
        open_frames(tmp_path / "f_3.npz", (3, 4))


def test_a_folder_may_have_a_dot_in_its_name(tmp_path: Path) -> None:
    save_frames(tmp_path / "run.v2", [random_frame()])
    assert (tmp_path / "run.v2" / "frame_0007.npz").is_file()
    (tmp_path / "run.v3").mkdir()
    save_frames(tmp_path / "run.v3", random_frame())
    assert (tmp_path / "run.v3" / "frame_0007.npz").is_file()


def test_only_frames_are_saved(tmp_path: Path) -> None:
    for values in (np.ones(SHAPE), [np.ones(SHAPE)], 5):
        with pytest.raises(InputError, match="expected one or more frames"):
            save_frames(tmp_path / "a.npz", values)
    assert list(tmp_path.iterdir()) == []


def test_the_velocity_of_a_mac_grid_is_averaged_per_axis() -> None:
    # On faces x = i (the lower face of cell i) this velocity is (x, 10 y, 100 z): at centres i + 1/2.
    depth, height, width = SHAPE
    z, y, x = np.meshgrid(np.arange(depth), np.arange(height), np.arange(width), indexing="ij")
    centres = centred_velocity(np.stack([x, 10 * y, 100 * z], axis=-1).astype(np.float32))
    expected = np.stack([x + 0.5, 10 * (y + 0.5), 100 * (z + 0.5)], axis=-1)
    expected[:, :, -1, 0], expected[:, -1, :, 1], expected[-1, :, :, 2] = (
        width - 1,
        10 * (height - 1),
        100 * (depth - 1),
    )
    np.testing.assert_allclose(centres, expected)


def test_the_authors_layout_gives_cells_per_frame(tmp_path: Path) -> None:
    density = np.random.default_rng(0).random(SHAPE).astype(np.float32)
    for number in (70, 71):
        (tmp_path / "d").mkdir(exist_ok=True)
        write_arrays(tmp_path / "d" / f"{number:03d}.npz", {"x": density})
    # A uniform 3 cells per time unit, at 0.5 time units per frame; the last frame has no velocity.
    write_arrays(tmp_path / "v" / "070.npz", {"x": np.full((*SHAPE, 3), 3.0, np.float32)})
    first, last = load_frames(tmp_path)
    assert (first.number, last.number) == (70, 71)
    np.testing.assert_array_equal(first.velocity, np.full((*SHAPE, 3), 1.5, np.float32))
    assert last.velocity is None


def test_every_number_type_and_memory_order_is_read_right(tmp_path: Path) -> None:
    values = np.arange(60).reshape(SHAPE)
    for dtype in ("<f2", ">f4", "<f8", ">i2", "<i4"):
        np.savez(tmp_path / "a.npz", density=np.asfortranarray(values.astype(dtype)))
        np.testing.assert_array_equal(load_frames(tmp_path / "a.npz")[0].density, values.astype(np.float32))


def npz_with(path: Path, member: bytes, name: str = "density.npy", method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr(name, member)
    return path


def npy_bytes(shape: tuple[int, ...], descr: str = "<f4", data: bytes = b"") -> bytes:
    stream = io.BytesIO()
    npy.write_array_header_1_0(stream, {"shape": shape, "fortran_order": False, "descr": descr})
    return stream.getvalue() + data


def test_a_claimed_size_is_not_believed(tmp_path: Path) -> None:
    """4 GiB claimed by 100 bytes: refused before anything of that size is allocated."""
    bomb = npz_with(tmp_path / "bomb.npz", npy_bytes((1024, 1024, 1024), data=b"\0" * 100))
    with pytest.raises(InputError, match="claims 4294967296 bytes"):
        load_frames(bomb)
    overflow = npz_with(tmp_path / "overflow.npz", npy_bytes((2**32, 2**32, 4)))
    with pytest.raises(InputError, match="bytes, expected at most"):
        load_frames(overflow)


@pytest.mark.parametrize(
    ("member", "message"),
    [
        (npy_bytes((2, 2, 2), data=b"\0" * 31), "claims|truncated"),
        (npy_bytes((2, 2, 2), data=b"\0" * 40), "more data than"),
        (npy_bytes((-1, 2, 2), data=b"\0" * 8), "claims the shape"),
        (npy_bytes((2, 2, 2), "|O", b"cos\nsystem\n(S'false'\ntR."), "pickled objects"),
        (npy_bytes((2, 2, 2), "<U8", b"\0" * 256), "expected numbers"),
        (npy_bytes((2, 2, 2), "<c8", b"\0" * 64), "expected numbers"),
        (b"\x93NUMPY\x09\x00" + struct.pack("<H", 4) + b"{}  ", "version|truncated"),
        (b"\x93NUMPY\x01\x00" + struct.pack("<H", 18) + b"__import__('os')  ", "damaged"),
        (npy_bytes((2, 2, 2)).replace(b"}", b"("), "damaged"),
        (b"not an array", "damaged"),
        (b"", "damaged"),
    ],
)
def test_a_damaged_array_is_refused(tmp_path: Path, member: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        load_frames(npz_with(tmp_path / "bad.npz", member))
    assert "\n" not in str(error.value)


def test_no_pickle_is_ever_loaded(tmp_path: Path) -> None:
    class Harmful:
        def __reduce__(self) -> tuple[object, tuple[object, ...]]:
            return (Path.touch, (tmp_path / "executed",))

    array = np.empty((1, 1, 1), object)
    array[0, 0, 0] = Harmful()
    np.savez(tmp_path / "pickled.npz", density=array)
    with pytest.raises(InputError, match="never unpickled"):
        load_frames(tmp_path / "pickled.npz")
    assert not (tmp_path / "executed").exists()


@pytest.fixture(scope="module")
def valid_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("valid") / "frame_0001.npz"
    save_frames(path, random_frame())
    return path.read_bytes()


@settings(max_examples=60)
@given(cut=st.floats(0.0, 1.0, exclude_max=True))
def test_every_truncation_is_an_input_error(
    valid_bytes: bytes, tmp_path_factory: pytest.TempPathFactory, cut: float
) -> None:
    path = tmp_path_factory.getbasetemp() / "truncated.npz"
    path.write_bytes(valid_bytes[: int(cut * len(valid_bytes))])
    with pytest.raises(InputError):
        load_frames(path)


@settings(max_examples=200)
@given(position=st.floats(0.0, 1.0, exclude_max=True), value=st.integers(0, 255))
def test_a_flipped_byte_is_harmless_or_an_input_error(
    valid_bytes: bytes, tmp_path_factory: pytest.TempPathFactory, position: float, value: int
) -> None:
    damaged = bytearray(valid_bytes)
    damaged[int(position * len(damaged))] = value
    path = tmp_path_factory.getbasetemp() / "flipped.npz"
    path.write_bytes(damaged)
    try:
        (frame,) = load_frames(path)
    except InputError:
        return
    # Whatever is accepted passed its checksum: the density is the one that was written.
    np.testing.assert_array_equal(frame.density, random_frame().density)


def test_missing_keys_are_listed(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", temp=np.ones(SHAPE), heat=np.ones(SHAPE))
    with pytest.raises(InputError, match=r"no array 'density' \(or 'x'\).*temp, heat"):
        load_frames(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        (["f_1", "f_2", "f_5", "f_7"], "missing between 1 and 7: 3, 4, 6"),
        (["f_1", "f_01"], "frame 1 is there more than once: f_01.npz, f_1.npz"),
        (["a", "b"], "no file name has a frame number"),
        ([], "no frames"),
    ],
)
def test_a_folder_must_have_each_number_once(tmp_path: Path, numbers: list[str], message: str) -> None:
    for name in numbers:
        write_arrays(tmp_path / f"{name}.npz", {"density": np.ones(SHAPE)})
    with pytest.raises(InputError, match=message):
        load_frames(tmp_path)


def test_frames_of_a_sequence_have_one_shape(tmp_path: Path) -> None:
    save_frames(tmp_path, [Frame(np.ones((2, 3, 4)), name="f_1"), Frame(np.ones((2, 3, 5)), name="f_2")])
    with pytest.raises(InputError, match=r"f_2: density has shape \(2, 3, 5\), expected \(2, 3, 4\)"):
        load_frames(tmp_path)


def test_unknown_formats_name_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a.abc: no such file or folder"):
        load_frames(tmp_path / "a.abc")
    with pytest.raises(InputError, match=r"unknown format '.abc', expected one of .npz, .vol, .uni, .vdb"):
        save_frames(tmp_path / "a.abc", random_frame())
    with pytest.raises(InputError, match="holds one frame and there are 2"):
        save_frames(tmp_path / "a.npz", [random_frame(), random_frame()])
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "a.abc").touch()
    with pytest.raises(InputError, match=r"unknown format '.abc', expected one of .npz, .vol, .uni, .vdb"):
        load_frames(tmp_path / "a.abc")


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt), written_whole(path) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_exr_is_exact_and_says_how_it_was_made(tmp_path: Path) -> None:
    image = np.random.default_rng(0).normal(size=(6, 4)).astype(np.float32) * 1e3
    attributes = {"view": (-8.0, 2.5), "gamma": 0.1, "exposure": 0.25, "quadrature": "paper"}
    write_exr(tmp_path / "a.exr", image, attributes)
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        np.testing.assert_array_equal(file.channels()["Y"].pixels, image)
        header = file.header()
        np.testing.assert_array_equal(header["view"], [-8.0, 2.5])
        assert header["gamma"] == pytest.approx(0.1)
        assert (header["exposure"], header["quadrature"]) == (0.25, "paper")


def test_png_is_linear_and_clipped(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.array([[-1.0, 0.0, 0.5, 1.0, 7.0]]))
    assert np.asarray(Image.open(tmp_path / "a.png")).tolist() == [[0, 0, 128, 255, 255]]


def test_real_frames_are_read(asset: object) -> None:
    frame = load_frames(asset("data/suzanne/frame_0010.npz"))[0]
    assert frame.density.shape == (64, 96, 64)
    assert frame.velocity.dtype == np.float32
    assert frame.number == 10
    assert "exact_step" not in {f.stem for f in open_frames(asset("data/smokejet")).files}


def test_read_arrays_leaves_other_arrays_alone(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", density=np.ones(SHAPE), notes=np.array([{}], object))
    assert list(read_arrays(tmp_path / "a.npz", ("density", "velocity"))) == ["density"]


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"density": np.ones((3, 4))}, r"shape \(3, 4\), expected \(D, H, W\)"),
        ({"density": np.ones((3, 0, 4))}, "at least one cell"),
        ({"density": np.array([[[1.0, np.nan]]])}, "1 NaN or infinite"),
        ({"density": np.array([[[1.0, 1e300]]])}, "1 NaN or infinite"),
        ({"density": np.array([[[1.0, -0.5]]])}, "1 negative values"),
        ({"density": np.array([[["a"]]])}, "expected numbers"),
        ({"density": np.ones(SHAPE), "velocity": np.ones(SHAPE)}, "velocity has shape"),
        ({"density": np.ones(SHAPE), "velocity": np.full((*SHAPE, 3), np.inf)}, "velocity has 180 NaN"),
        ({"density": np.ones(SHAPE), "obstacle": np.full(SHAPE, 0.5)}, "besides 0 and 1"),
        ({"density": np.ones(SHAPE), "obstacle": np.ones((1, 1, 1))}, "obstacle has shape"),
    ],
)
def test_a_frame_checks_its_arrays(arrays: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Frame(**arrays)


@pytest.mark.parametrize("format", ["vol", "uni"])
def test_a_frame_replaces_all_files_of_an_earlier_one(tmp_path: Path, format: str) -> None:
    path = tmp_path / f"frame_0007.{format}"
    save_frames(path, random_frame())
    velocity = tmp_path / f"frame_velocity_0007.{format}"
    (tmp_path / f"frame_vel_0007.{format}").write_bytes(velocity.read_bytes())
    plain = random_frame(1)
    save_frames(path, Frame(plain.density))
    (loaded,) = load_frames(path)
    np.testing.assert_array_equal(loaded.density, plain.density)
    assert (loaded.velocity, loaded.obstacle) == (None, None)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("earlier", [False, True])
def test_a_frame_in_several_files_is_there_once_it_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, earlier: bool
) -> None:
    path, left = tmp_path / "frame_0007.vol", [2]
    if earlier:
        save_frames(path, Frame(random_frame(1).density))

    def fails_at_last(file: Path, values: np.ndarray) -> None:
        if not left[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        left[0] -= 1
        write_vol(file, values)

    monkeypatch.setattr("tnst_mi.io.formats.write_vol", fails_at_last)
    with pytest.raises(OSError, match="No space left"):
        save_frames(path, random_frame())
    with pytest.raises(InputError, match="no such file"):
        load_frames(path)


@pytest.mark.parametrize("format", ["vol", "uni"])
@pytest.mark.parametrize("name", ["obstacle", "vel", "flags_density", "f_velocity"])
def test_sequences_named_by_the_words_of_companions_come_back(tmp_path: Path, format: str, name: str) -> None:
    frames = [random_frame(number, f"{name}_{number:03d}", number) for number in (1, 2)]
    save_frames(tmp_path / "frames", frames, format)
    for loaded, frame in zip(load_frames(tmp_path / "frames"), frames, strict=True):
        assert loaded.name == frame.name
        for key in ("density", "velocity", "obstacle"):
            np.testing.assert_array_equal(getattr(loaded, key), getattr(frame, key))


def test_a_companion_without_its_density_is_no_frame(tmp_path: Path) -> None:
    save_frames(tmp_path, [random_frame(number, f"f_{number}", number) for number in (1, 2, 3)], "vol")
    (tmp_path / "f_3.vol").unlink()
    assert [frame.number for frame in load_frames(tmp_path)] == [1, 2]


@pytest.mark.parametrize(
    ("density", "velocity"),
    [("D_001.VOL", "D_velocity_001.vol"), ("d_001.vol", "d_VEL_001.VOL"), ("Density_001.vol", "Velocity_001.vol")],
)
def test_companions_in_capitals_belong_to_their_density(tmp_path: Path, density: str, velocity: str) -> None:
    frame = random_frame()
    write_vol(tmp_path / density, frame.density)
    write_vol(tmp_path / velocity, frame.velocity)
    for path in (tmp_path, tmp_path / density):
        np.testing.assert_array_equal(load_frames(path)[0].velocity, frame.velocity)
